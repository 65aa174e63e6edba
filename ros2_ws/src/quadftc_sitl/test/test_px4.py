"""Flights of a stand-in for PX4's simulation, and what is refused. The real one is flown by hand."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from quadftc_bags.bag import read_bag
from quadftc_cli.main import guarded
from quadftc_flight.scenario import ScenarioError
from quadftc_model.vehicle import load_vehicle
from quadftc_sitl import pilot, px4_packets
from quadftc_sitl.plan import plan_of_text, read_parameters
from quadftc_sitl.px4 import rotor_parameters

HERE = Path(__file__).parent
SCENARIO = """
name: short
duration: 2 s
rate: 250 Hz
vehicle: x500
plant: {kind: free_flight}
sensors: {grade: ideal}
trajectories:
  - {kind: hover, position: [0, 0, 1]}
faults:
  - {kind: bias, channel: accelerometer, axes: x, value: 2, start: 0.5 s, stop: 1 s}
autopilot:
  faults:
    - {inject: magnetometer 1 off, start: 1 s, stop: 1.5 s}
"""
FLIES, REFUSES, STOPS = 0, 2, 4  # as in the peer


@pytest.fixture
def flown(tmp_path, monkeypatch):
    """Fly a scenario with the peer, by the command; return exit code and the flight's folder."""
    for name, value in {"SETTLING": 1.0, "AFTERWARDS": 0.1, "TO_BE_READY": 1.0, "TO_ARM": 1.0}.items():
        monkeypatch.setattr(pilot, name, value)
    monkeypatch.setattr(px4_packets, "UNANSWERED", 0.5)
    monkeypatch.setattr(px4_packets, "PATIENCE", 1.0)
    peer, script = tmp_path / "build" / "bin" / "px4", tmp_path / "build" / "etc" / "init.d-posix" / "rcS"
    for file in (peer, script):
        file.parent.mkdir(parents=True)
    script.touch()
    peer.write_text(f'#!/bin/sh\nexec {sys.executable} {HERE / "px4_peer.py"} "$@"\n')
    peer.chmod(0o755)
    scenario = tmp_path / "short.yaml"
    scenario.write_text(SCENARIO)

    def fly(way, binary=peer):
        arguments = ["sitl", str(scenario), "--autopilot", "px4", "--binary", str(binary)]
        arguments += ["--set", f"autopilot.parameters.PEER={way}"] if way else []
        return guarded([*arguments, "--out", str(tmp_path / "out")]), tmp_path / "out" / "short"

    return fly


def test_px4_gets_all_sensors_and_its_own_failure(flown):
    code, folder = flown(FLIES)
    assert code == 0
    found = json.loads((folder / "sitl.json").read_text())
    assert found["ended"] == "landed"
    assert found["autopilot"]["name"] == "PX4"
    assert found["autopilot"]["wrong_packets"] == {}
    assert found["metrics"]["position_max_m"] < 1.5
    ours, own = found["faults"]
    assert ours["observer"]["named"]
    assert (own["component"], own["kind"]) == ("magnetometer", "off")
    assert own["autopilot"]["words"] == "MAG #0 failed:  TIMEOUT!"
    assert own["autopilot"]["delay_s"] < 0.2
    assert read_parameters(folder / "parameters.parm")["CA_ROTOR0_PY"] == 0.174
    assert read_bag(folder / "bag").topics["/imu/data"].count > 1000


@pytest.mark.parametrize(
    ("way", "words"),
    [
        (REFUSES, "arming refused: Preflight Fail: Compass 0 fault"),
        (STOPS, "hangs: it has sent nothing more for 1 s"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_its_words(flown, capsys, way, words):
    assert flown(way)[0] == 2
    assert words in capsys.readouterr().err


def test_binary_without_its_start_script_is_refused(flown, tmp_path, capsys):
    alone = tmp_path / "px4"
    alone.touch()
    assert flown(FLIES, alone)[0] == 2
    assert "etc/init.d-posix/rcS beside it; expected a build of px4_sitl" in capsys.readouterr().err


def test_failure_by_command_is_only_for_who_takes_it():
    assert plan_of_text(SCENARIO, "", "short", "px4").section.faults[0].failure == ("magnetometer", 1, "off")
    with pytest.raises(ScenarioError, match="inject: ArduPilot has no such command"):
        plan_of_text(SCENARIO, "", "short")
    with pytest.raises(ScenarioError, match=r"autopilot\.faults\[0\]\.inject"):
        plan_of_text(SCENARIO.replace("1 off", "1 wet"), "", "short", "px4")


def test_rotors_are_told_in_px4s_axes():
    vehicle = load_vehicle("x500")
    found = rotor_parameters(vehicle)
    front_right = [found[f"CA_ROTOR0_{name}"] for name in ("PX", "PY", "KM")]
    assert front_right == pytest.approx([0.174, 0.174, 0.016], abs=1e-4)  # counter-clockwise from above
    assert np.sign([found[f"CA_ROTOR{number}_KM"] for number in range(4)]).tolist() == [1, 1, -1, -1]


def test_parameters_as_qgroundcontrol_saves_them(tmp_path):
    file = tmp_path / "my.params"
    file.write_text("# Vehicle-Id Component-Id Name Value Type\n1\t1\tMC_ROLL_P\t6.5\t9\n")
    assert read_parameters(file) == {"MC_ROLL_P": 6.5}
