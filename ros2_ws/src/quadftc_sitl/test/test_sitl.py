"""Flights of a stand-in for ArduPilot's simulation, and what is refused. The real one is flown by hand."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from quadftc_bags.bag import read_bag
from quadftc_cli.main import guarded
from quadftc_flight.scenario import ScenarioError
from quadftc_flight.scenario.document import parse_document
from quadftc_sitl import physics, pilot
from quadftc_sitl.catalogue import job_of, write_lost
from quadftc_sitl.journal import Event
from quadftc_sitl.plan import plan_of_text, plans_of_catalogue, read_parameters
from quadftc_sitl.scoring import describe_faults, is_it, noticed
from quadftc_sitl.sitl_report import confusion_rows, map_rows, table_rows

HERE = Path(__file__).parent
SCENARIO = """
name: short
duration: 3 s
rate: 400 Hz
vehicle: x500
plant: {kind: free_flight}
sensors: {grade: mems}
position_sensor: {grade: gps}
trajectories:
  - {kind: hover, position: [0, 0, 1]}
faults:
  - {kind: bias, channel: gyro, axes: x, value: 0.2 rad/s, start: 1 s, stop: 2 s}
autopilot:
  faults:
    - {set: {SIM_GYR1_BIAS_X: 0.3}, start: 1.5 s, stop: 2 s}
  checks:
    - {metric: survived, above: 0.5}
    - {metric: autopilot_delay_s, below: 0.001}
"""
ENDS, REFUSES, IS_A_PLANE, STOPS = range(1, 5)  # as in the peer


@pytest.fixture
def flown(tmp_path, monkeypatch):
    """Fly a scenario with the peer, by the command; return exit code and the flight's folder."""
    monkeypatch.setattr(pilot, "SETTLING", 1.0)
    monkeypatch.setattr(pilot, "AFTERWARDS", 0.1)
    monkeypatch.setattr(pilot, "TO_SPEAK", 1.0)
    monkeypatch.setattr(pilot, "TO_BE_READY", 1.0)
    monkeypatch.setattr(pilot, "TO_ARM", 1.0)
    monkeypatch.setattr(physics, "PATIENCE", 1.0)
    peer, scenario = tmp_path / "peer", tmp_path / "short.yaml"
    peer.write_text(f"#!{sys.executable}\n" + (HERE / "sitl_peer.py").read_text())
    peer.chmod(0o755)
    scenario.write_text(SCENARIO)

    def fly(*options, binary=peer, file=scenario):
        arguments = ["sitl", str(file), "--autopilot", "ardupilot", "--binary", str(binary)]
        return guarded([*arguments, "--out", str(tmp_path / "out"), *options]), tmp_path / "out" / "short"

    return fly


def test_flight_ends_with_one_summary_of_all_that_was_said(flown, capsys, tmp_path):
    code, folder = flown("--junit", str(tmp_path / "junit.xml"))
    assert 'tests="2" failures="1"' in (tmp_path / "junit.xml").read_text()
    found = json.loads((folder / "sitl.json").read_text())
    assert code == 1  # the autopilot is slower than the second check allows; the vehicle survives
    assert [check["passed"] for check in found["checks"]] == [True, False]
    assert found["survived"]
    assert found["ended"] == "landed"
    ours, own = found["faults"]
    assert ours["observer"]["named"]
    assert ours["observer"]["delay_s"] < 0.1
    assert own["observer"]["named"] is None  # it is not in our samples
    assert own["autopilot"]["words"] == "EKF3 lane switch 1"
    assert own["autopilot"]["delay_s"] < 0.2
    assert found["metrics"]["position_max_m"] < 1.5
    (port,) = found["autopilot"]["open_sockets"]
    assert port.startswith("udp 0.0.0.0:")
    assert port in capsys.readouterr().out
    bag = read_bag(folder / "bag")
    assert bag.topics["/imu/data"].count == bag.topics["/plant/odometry"].count - 1  # one is in the IMU
    gyro = bag.series("fault/injected/gyro")["vector"][:, 0]
    assert {round(value, 6) for value in gyro.tolist()} == {0.0, 0.2}


def test_guardian_lands_the_vehicle_and_its_decision_is_in_summary_and_bag(flown, capsys):
    code, folder = flown("--guard", "gyro=land", "--guard", "attitude=land", "--set", "autopilot.checks=[]")
    found = json.loads((folder / "sitl.json").read_text())
    assert code == 0
    (decision,) = [each for each in found["guardian"]["decisions"] if not each["refused"]]
    assert decision["time"] == pytest.approx(1.3, abs=0.15)  # the fault begins at 1 s
    assert (decision["action"], decision["answer"]) == ("land", "MAV_RESULT_ACCEPTED, mode LAND")
    assert found["metrics"]["guardian_actions"] == 1
    assert found["ended"] == "landed"
    assert not [each for each in found["autopilot_said"] if each["words"] == "disarmed" and each["serious"]]
    assert "offset: land, MAV_RESULT_ACCEPTED" in capsys.readouterr().out
    assert read_bag(folder / "bag").topics["/diagnostics"].count == len(found["guardian"]["decisions"])


def test_campaign_is_flown_once_and_its_report_says_what_was_drawn(flown, tmp_path, capsys):
    file = tmp_path / "campaign.yaml"
    file.write_text(
        "{scenario: short.yaml, source: sitl, flights: 1, set: ['autopilot={}', duration=1.5 s, "
        "faults.0.stop=1.2 s], vary: {faults.0.axes: {grid: [y, z]}, faults.0.value: {uniform: [0.1, 0.2]}}}"
    )
    assert flown("--set", "faults.0.start=0.5 s", file=file)[0] == 0
    report = (tmp_path / "out" / "catalogue.md").read_text()
    assert "| gyro_bias | 1 | 0 of 1 | 1 of 1, " in report
    assert "| faults.0.axes | y | 0 of 1 |" in report
    summary = tmp_path / "out" / "gyro_bias-0" / "sitl.json"
    before = summary.stat().st_mtime_ns
    assert flown("--set", "faults.0.start=0.5 s", "--resume", file=file)[0] == 0
    assert summary.stat().st_mtime_ns == before
    assert flown("--set", "faults.0.start=0.6 s", "--resume", file=file)[0] == 2
    assert "was flown with other inputs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("way", "words"),
    [
        (ENDS, "ended early, with code 1; it says:\nerror: panic: no such thing"),
        (REFUSES, "arming refused: Arm: Compass not calibrated"),
        (IS_A_PLANE, "another vehicle answers: MAV_TYPE 1, expected 4 rotors"),
        (STOPS, "hangs: it has sent nothing more for 1 s"),
    ],
)
def test_what_cannot_be_flown_is_refused_and_its_process_ends(flown, capsys, way, words):
    code, _ = flown("--set", f"autopilot.parameters.PEER={way}", "--set", "autopilot.checks=[]")
    assert code == 2
    assert words.partition("\n")[0] in capsys.readouterr().err


def test_binary_that_cannot_run_is_refused(flown, tmp_path, capsys):
    text = tmp_path / "no_binary"
    text.write_text("hello")
    assert flown(binary=text)[0] == 2
    assert "does not start: Permission denied" in capsys.readouterr().err
    assert flown(binary=tmp_path / "nowhere")[0] == 2


def test_firmware_ends_with_us_even_when_we_are_killed(tmp_path):
    script = (
        "from pathlib import Path; import sys, time; from quadftc_sitl.firmware import Firmware\n"
        "with Firmware(['sleep', '600'], Path(sys.argv[1])) as it: print(it.pid, flush=True); time.sleep(600)"
    )
    ours = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    with ours:
        pid = int(ours.stdout.readline())
        ours.send_signal(signal.SIGKILL)
    for _ in range(100):
        try:
            os.kill(pid, 0)
            state = Path(f"/proc/{pid}/stat").read_text().split()[2]
        except (ProcessLookupError, FileNotFoundError):
            return
        if state == "Z":  # dead; whoever adopted it has not looked yet
            return
        time.sleep(0.05)
    pytest.fail("it runs on")


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("kind: free_flight", "kind: test_stand", "expected 'plant: {kind: free_flight}'"),
        ("mode: guided", "mode: acro", "autopilot.mode: 'acro': expected one of guided, auto"),
        (
            "set: {SIM_GYR1_BIAS_X: 0.3}",
            "set: {}",
            "autopilot.faults[0]: expected 'set', parameters, or 'inject'",
        ),
        (
            "set: {SIM_GYR1_BIAS_X: 0.3}",
            "sets: {A: 1}",
            "autopilot.faults[0].sets: unknown key (did you mean 'set'?)",
        ),
        ("start: 1.5 s", "start: 1.5 m", "autopilot.faults[0].start"),
    ],
)
def test_plan_that_makes_no_sense_is_refused(before, after, words):
    text = SCENARIO.replace("autopilot:\n", "autopilot:\n  mode: guided\n").replace(before, after)
    with pytest.raises(ScenarioError) as caught:
        plan_of_text(text.replace("trajectories", "references") if "stand" in after else text, "", "short")
    assert words in str(caught.value)


CATALOGUE = """
  catalogue:
    - {name: healthy}
    - name: gyro
      flights: 3
      faults:
        - {kind: bias, channel: gyro, axes: {choice: [x, y]}, value: {uniform: [0.1, 0.2]}, start: 1 s}
    - {name: gps, flights: 2, own: [{set: {SIM_GPS1_GLTCH_X: {uniform: [1, 2], sign: random}}, start: 1 s}]}
"""


def plans_of(text, **options):
    return plans_of_catalogue(parse_document(SCENARIO + text, "short.yaml"), "", **options)


def test_catalogue_draws_the_same_faults_for_a_name_and_a_seed():
    plans = plans_of(CATALOGUE)
    assert [plan.name for plan in plans] == ["healthy-0", "gyro-0", "gyro-1", "gyro-2", "gps-0", "gps-1"]
    assert [plan.scenario.seed for plan in plans[1:4]] == [0, 1, 2]
    sizes = [describe_faults(plan)[0]["size"] for plan in plans[1:4]]
    assert len({*sizes}) == 3
    assert all(0.1 < size < 0.2 for size in sizes)
    (own,) = plans[4].section.faults
    assert own.failing == "gps"
    assert 1.0 < abs(own.set["SIM_GPS1_GLTCH_X"]) < 2.0
    assert not plans[4].scenario.faults
    more = plans_of(CATALOGUE, flights=4)
    assert len(more) == 12
    assert more[4].raw == plans[1].raw


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("uniform: [0.1, 0.2]", "uniform: [0.2, 0.1]", "autopilot.catalogue[1]: uniform: low 0.2, high 0.1"),
        ("flights: 3", "flights: 0", "autopilot.catalogue[1].flights"),
        ("name: gps", "name: gyro", "'gyro' comes twice"),
    ],
)
def test_catalogue_that_makes_no_sense_is_refused(before, after, words):
    with pytest.raises(ScenarioError) as caught:
        plans_of(CATALOGUE.replace(before, after))
    assert words in str(caught.value)


def test_lost_flight_leaves_a_file_that_flies_it_again(tmp_path):
    plans = plans_of(CATALOGUE)
    jobs = [job_of(plan, Path("bin"), {"WP_YAW": 1.0}, tmp_path, "c") for plan in plans]
    found = [{"survived": plan.name != "gyro-1"} for plan in plans]
    (file,) = write_lost(jobs, found, tmp_path)
    command, _, text = file.read_text().partition("\n")
    assert command.startswith("# quadftc sitl gyro-1.yaml --autopilot ardupilot --binary bin ")
    assert command.endswith(" --scheme beside --parameters gyro-1.parm")
    assert read_parameters(file.with_suffix(".parm")) == {"WP_YAW": 1.0}
    again = plan_of_text(text, "beside", "gyro-1")
    assert again.raw == plans[2].raw


@pytest.mark.parametrize("line", ["WP", "wp_speed 1", "WP_SPEED fast", "WP_SPEED nan"])
def test_parameter_file_says_which_line_is_wrong(tmp_path, line):
    file = tmp_path / "my.parm"
    file.write_text(f"# mine\nWP_YAW 1\n{line}\n")
    with pytest.raises(ScenarioError, match=r"my\.parm:3: "):
        read_parameters(file)
    file.write_text("# mine\nWP_YAW 1\nA,2 # two\n")
    assert read_parameters(file) == {"WP_YAW": 1.0, "A": 2.0}


def test_finding_is_the_fault_that_it_names_or_might_be():
    fault = {"component": "gyro", "elements": ["x"]}
    assert is_it(fault, "gyro", "x")
    assert is_it(fault, "gyro 2", "x")
    assert is_it(fault, "attitude", "roll", ["gyro/x"])
    assert not is_it(fault, "gyro", "y")
    assert not is_it(fault, "accelerometer", "x")
    assert is_it({"component": "attitude", "elements": ["roll"]}, "attitude", "roll")


def test_autopilot_has_noticed_what_it_says_from_the_fault_on():
    fault = {"start": 10.0, "stop": math.inf}
    events = [
        Event(9.9, "text", "EKF variance", True),
        Event(10.5, "text", "hello", False),
        Event(12.0, "lane", "EKF3 lane switch 1", True),
    ]
    found = noticed(fault, events)
    assert (found["noticed"], found["delay_s"], found["lane_delay_s"]) == (True, 2.0, 2.0)
    assert not noticed(fault, events[:2])["noticed"]


def flight(name, survived, delay, size=1.0, component="gyro"):
    told = {"named": delay is not None, "noticed": delay is not None, "delay_s": delay}
    truth = {"source": "sensor", "component": component, "start": 5.0, "size": size}
    fault = {**truth, "autopilot": told, "observer": {**told, "named": None}, "diagnose": told}
    said = {"component": "gyro 2", "time": 5.1, "onset": 5.1, "ambiguous_with": ["attitude/roll"]}
    return {
        "name": name,
        "survived": survived,
        "faults": [fault],
        "metrics": {},
        "autopilot_said": [{"time": 6.0, "serious": True, "kind": "lane"}] * (delay is not None),
        "observer_said": [said],
        "diagnose": {"findings": [] if delay is None else [said]},
    }


def test_table_counts_flights_by_fault():
    flights = [
        flight("gps_step-1", True, 0.5),
        flight("gps_step-2", False, None),
        {"name": "x-1", "error": "no"},
    ]
    assert list(table_rows(flights)) == [("gps_step", "2", "1 of 2, 0.5 s", "-", "1 of 2, 0.5 s", "1 of 2")]


def test_confusion_has_what_was_said_first_of_each_faulty_component():
    flights = [
        flight("a-1", True, 0.5),
        flight("a-2", True, None),
        flight("r-1", True, 0.5, component="rotor"),
    ]
    diagnose, autopilot = confusion_rows(flights, "diagnose"), confusion_rows(flights, "autopilot")
    assert diagnose[0] == ("faulty", "nothing", "attitude or gyro")
    assert diagnose[1:] == [("gyro", "1", "1"), ("rotor", "", "1")]
    assert autopilot == [("faulty", "nothing", "lane"), ("gyro", "1", "1"), ("rotor", "", "1")]


def test_map_counts_lost_flights_by_size():
    flights = [flight(f"a-{size}", size < 6, 0.5, size=-size) for size in range(1, 9)]
    rows = map_rows([*flights, flight("stuck-1", False, 0.5, size=None)])[1:]
    assert rows.pop() == ("stuck", "-", "1 of 1")
    assert [row[2] for row in rows] == ["0 of 2", "0 of 2", "1 of 2", "2 of 2"]
    assert rows[0][1] == "1 to 2.75"
