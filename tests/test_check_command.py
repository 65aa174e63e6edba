"""``quadftc check`` on recorded runs, and on what is none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from command_bench import Done, call_quadftc
from quadftc_flight.scenario import load_scenario

SHORT = """\
name: short
description: a second with a fault
duration: 1 s
rate: 250 Hz
seed: 3
vehicle: qball_x4
sensors: {grade: ideal}
disturbances:
  - {kind: constant, amplitude: [0.1 N m, 0 N m, 0 N m], start: 0.3 s}
faults:
  - {kind: bias, channel: attitude, axes: roll, value: 1 deg, start: 0.5 s}
schemes:
  proposed: {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory, fly_graph):
    path = tmp_path_factory.mktemp("scenario") / "short.yaml"
    path.write_text(SHORT, encoding="utf-8")
    return fly_graph(load_scenario(path, []), "proposed")[0]


def check(*arguments: str | Path) -> Done:
    return call_quadftc("check", *arguments)


def test_a_recorded_run_is_judged_along_its_way(run):
    done = check(run.parent, "--json")
    assert done.returncode in (0, 1), done.stderr
    report = json.loads(done.stdout)
    along = next(section for section in report["sections"] if section["title"] == "along the recorded run")
    assert [item["name"][:4] for item in along["conditions"]] == ["(35)", "(35)", "(47)"]
    assert report["bounds"]["disturbance"]["origin"].startswith("trace")
    assert report["bounds"]["disturbance"]["value"][0] == pytest.approx(0.1 / 0.03, rel=0.02)


def test_a_recorded_run_is_not_judged_with_other_parts(run):
    done = check(run, "--controller", "smc")
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {run}: a recorded run is judged as it was flown")


def test_isolability_shows_which_faults_look_the_same():
    done = check("paper_faults", "--isolability")
    assert done.returncode == 0, done.stderr
    assert "cannot be told apart: actuator roll / disturbance roll" in done.stdout
    assert "cannot be told apart: attitude roll / gyro roll" in done.stdout


def test_an_unknown_sensor_is_refused_with_those_there_are():
    done = check("paper_faults", "--sensors", "attitude,gyros")
    assert done.returncode == 2
    assert done.stderr.startswith("error: sensor_set: 'gyros' is none of attitude, gyro, ")
