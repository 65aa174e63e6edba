"""A recorder that is killed, out of disk or behind: little is lost, it is said, and the flight goes on.

The long form of the first two is `scripts/soak`; docs/reliability.md has its results.
"""

from __future__ import annotations

import dataclasses
import json
import random

import pytest

from node_bench import NodeBench
from quadftc_flight.graph.plan import GraphError
from quadftc_flight.runs import RunOptions, run
from quadftc_flight.scenario import find_scenario, load_scenario, with_duration
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.recorder_node import RecorderNode
from quadftc_tools.soak.recorder import (
    ALLOWED,
    COMPOSED,
    COMPOSED_LOCKSTEP,
    DISK_FULL,
    KILLED,
    NODE,
    NODE_LOCKSTEP,
    try_recorder,
)


@pytest.mark.parametrize(
    ("form", "hit"),
    [
        (NODE, KILLED),
        (NODE_LOCKSTEP, KILLED),
        (COMPOSED, KILLED),
        # a shorter one: test_run_on_a_full_disk_flies_on_and_ends_with_what_is_there
        pytest.param(COMPOSED_LOCKSTEP, DISK_FULL, marks=pytest.mark.thorough),
    ],
)
def test_recorder_hit_at_a_random_time_loses_less_than_a_second(form, hit):
    trial = try_recorder(form, hit, random.Random(f"{form} {hit}"))
    assert trial.wrong == ""
    assert trial.lost_s <= ALLOWED
    assert trial.messages > 0


def test_messages_that_were_dropped_are_in_the_summary_and_end_the_run_badly(tmp_path, monkeypatch):
    finish = RecorderNode.finish
    behind = {"/clock": 3, "/imu/data": 1}
    monkeypatch.setattr(
        RecorderNode, "finish", lambda node: dataclasses.replace(finish(node), dropped=behind)
    )
    scenario = with_duration(load_scenario(find_scenario("paper_faults")), 0.5)
    with pytest.raises(GraphError, match=r"lost on the way to the bag, .*: /clock 3, /imu/data 1$"):
        run(scenario, scenario.scheme(None), tmp_path, RunOptions(), lambda _: True)
    (file,) = tmp_path.glob("*/summary.json")
    recorded = json.loads(file.read_text(encoding="utf-8"))["recorded"]
    assert recorded["dropped"] == behind
    assert recorded["messages"] > 1000


def test_recorder_says_in_its_diagnostics_what_is_wrong(tmp_path, monkeypatch):
    with NodeBench("realtime") as bench:
        recorder = bench.run(RecorderNode, directory=str(tmp_path / "bag"))
        status = recorder.status
        found = []
        monkeypatch.setattr(
            recorder.diagnostics, "report", lambda part, *row, **values: found.append((row, values))
        )
        for change in ({}, {"dropped": {"/clock": 2}}, {"error": "bag: disk full", "lost": 7}):
            changed = dataclasses.replace(status, **change)
            monkeypatch.setattr(type(recorder), "status", property(lambda _, now=changed: now))
            recorder._check()
    assert [row for row, _ in found] == [
        (OK, "recording"),
        (WARN, "messages were dropped"),
        (ERROR, "recording has stopped: bag: disk full"),
    ]
    assert [(values["dropped"], values["lost"]) for _, values in found] == [(0, 0), (2, 0), (0, 7)]
