"""``quadftc replay``: a recorded flight gives the recorded estimates again, bit for bit; and exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_bench import Done, call_quadftc
from quadftc_bags.bag import read_bag
from quadftc_flight.scenario import parse_scenario

REPEATED = ("imu/corrected", "fault/estimate", "fault/status", "torque/command")
TUNED = """
name: tuned
duration: 2 s
rate: 250 Hz
vehicle: qball_x4
sensors: {grade: mems}
schemes:
  proposed:
    observer: {kind: sliding_mode, delta: 0.005, epsilon_s: 20 deg}
    controller: smc
"""


def replay(*arguments: str | Path) -> Done:
    return call_quadftc("replay", *arguments)


def assert_same_messages(run: Path, replayed: Path, topic: str) -> None:
    recorded, again = read_bag(run).series(topic), read_bag(replayed).series(topic)
    assert len(recorded) > 300
    assert recorded.fields.keys() == again.fields.keys()
    for name in recorded.fields:
        np.testing.assert_array_equal(again[name], recorded[name], err_msg=f"{topic} {name}")


def untracked(metrics: Any) -> Any:
    """Metrics without those of tracking and of the true attitude, which a replay does not know."""
    if isinstance(metrics, list):
        return [untracked(value) for value in metrics]
    if not isinstance(metrics, dict):
        return metrics
    unknown = ("tracking_", "attitude_error_")
    return {name: untracked(value) for name, value in metrics.items() if not name.startswith(unknown)}


@pytest.mark.parametrize("scheme", ["proposed", pytest.param("conventional", marks=pytest.mark.thorough)])
def test_replay_of_a_run_repeats_its_estimates_bit_for_bit(fly_graph, busy_scenario, scheme, tmp_path):
    """Noise, a late sensor, every kind of fault, samples and single channels withheld."""
    run, summary = fly_graph(busy_scenario, scheme)
    done = replay(run, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    observer = busy_scenario.scheme(scheme).observer.kind
    replayed = tmp_path / f"busy-{scheme}-{observer}"
    for topic in REPEATED:
        assert_same_messages(run, replayed, topic)
    metrics = json.loads((replayed / "summary.json").read_text(encoding="utf-8"))["metrics"]
    for name, value in metrics.items():
        if name != "fault_windows":
            assert untracked(value) == untracked(summary["metrics"][name]), name
    starts = [window["start"] for window in metrics["fault_windows"]]
    assert starts == [window["start"] for window in summary["metrics"]["fault_windows"]]


def test_replay_keeps_the_parameters_and_the_namespace_that_were_flown(fly_graph, tmp_path):
    scenario = parse_scenario(TUNED, "tuned.yaml")
    run, _ = fly_graph(scenario, "proposed", namespace="uav")
    done = replay(run, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    for topic in REPEATED:
        assert_same_messages(run, tmp_path / "tuned-proposed-sliding_mode", f"/uav/{topic}")


def test_fault_is_overlaid_and_judged(fly_graph, busy_scenario, tmp_path):
    run, _ = fly_graph(busy_scenario, "proposed")
    done = replay(
        run, "--topic", "plant/imu", "--observer", "none", "--out", tmp_path,
        "--fault", "bias axis=roll value=3deg start=0.5s stop=1.5s",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "busy-proposed-none: 499 samples of /plant/imu" in done.stdout
    rows = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines() if line.strip()}
    assert rows["roll"][2:4] == ["3", "3"]  # RMSE and largest error inside the window, in deg
    summary = json.loads((tmp_path / "busy-proposed-none" / "summary.json").read_text(encoding="utf-8"))
    assert summary["metrics"]["fault_estimate_rmse_inside_deg"]["roll"] == pytest.approx(3.0)
    assert summary["metrics"]["fault_estimate_max_outside_deg"]["roll"] == 0.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "error: nowhere: No such file or directory"),
        (["RUN", "--topic", "torque/command"], "is of type geometry_msgs/msg/Vector3Stamped, expected"),
        (["RUN", "--fault", "bias axis=rol value=3deg"], "axes: 'rol' is no axis"),
        (
            ["RUN", "--fault", "bias axis=roll value=3deg start=9min"],
            "'bias axis=roll value=3deg start=9min': s",
        ),
        (["RUN", "--observer", "kalman"], "no fault observer 'kalman'"),
        (["RUN", "--faults", "nowhere.yaml"], "nowhere.yaml: No such file or directory"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(fly_graph, busy_scenario, tmp_path, arguments, words):
    run, _ = fly_graph(busy_scenario, "proposed")
    done = replay(*(run if word == "RUN" else word for word in arguments), "--out", tmp_path / "out")
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
