"""Reading a run back: whole it is what was flown; damaged, foreign or incomplete it says so in one line."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from mcap.writer import Writer
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from flight_messages import TYPES, VECTOR_TOPICS, messages_at
from quadftc_bags.bag import BagError, read_bag
from quadftc_bags.writer import BagWriter
from quadftc_flight.closed_loop import fly
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import VECTORS, Flight
from quadftc_flight.live_run import (
    PARTS,
    VEHICLE,
    events_of,
    flight_times,
    is_live,
    live_run,
    rotor_events_of,
    with_kinds,
)
from quadftc_flight.run_directory import MissingPartError, find_runs, read_run
from quadftc_flight.scenario import Scenario, node_parameters, parse_scenario
from quadftc_flight.summary import summary

TEXT = """
name: short
duration: 1 s
rate: 100 Hz
vehicle: qball_x4
references: [{kind: step, angles: [5 deg, 0, 0], start: 0.1, stop: 0.6}]
faults: [{kind: bias, axes: roll, value: 1 deg, start: 0.3, stop: 0.7}]
schemes:
  first:
    {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc,
     checks: [{metric: tracking_rmse_deg, below: 5}]}
  second: {controller: smc}
"""


def record(directory: Path, scenario: Scenario, scheme: str, flight: Flight, leave_out=()) -> Path:
    """Write the bag of a run, its attachments and its summary, as `quadftc run` does."""
    parameters = node_parameters(scenario, scheme)
    files = {
        "scenario.yaml": yaml.safe_dump(scenario.raw),
        "parameters.yaml": yaml.safe_dump({f"/{n}": {"ros__parameters": v} for n, v in parameters.items()}),
    }
    attachments = {name: text.encode() for name, text in files.items() if name not in leave_out}
    with BagWriter(directory, attachments, {"quadftc": "0.1.0", "mode": "lockstep"}, lockstep=True) as writer:
        for topic, type_name in TYPES.items():
            writer.add_topic(f"/{topic}", type_name, QoSProfile(depth=10))
        for row in range(len(flight)):
            for topic, message in messages_at(flight, row):
                if topic not in leave_out:
                    stamp = int(flight.stamp_ns[row])
                    writer.write(f"/{topic}", serialize_message(message), stamp, stamp)
    result = summary(flight, scenario, scenario.scheme(scheme), 0.5)
    result["versions"] = {"quadftc": "0.1.0", "commit": "abc"}
    (directory / "summary.json").write_text(json.dumps(result))
    return directory


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(TEXT)


@pytest.fixture(scope="module")
def flight(scenario) -> Flight:
    return fly(scenario, "first")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, scenario, flight) -> Path:
    return record(tmp_path_factory.mktemp("runs") / "short-first", scenario, "first", flight)


@pytest.fixture
def run(tmp_path, recorded) -> Path:
    """A copy of a run, to be damaged."""
    return Path(shutil.copytree(recorded, tmp_path / "short-first"))


def bag_file(run: Path) -> Path:
    return run / "short-first_0.mcap"


def cut(run: Path, share: float) -> None:
    data = bag_file(run).read_bytes()
    bag_file(run).write_bytes(data[: int(share * len(data))])


def refusal(path: Path) -> str:
    with pytest.raises(BagError) as caught:
        read_run(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_whole_run_comes_back_as_it_was_flown(recorded, scenario, flight):
    found = read_run(recorded)
    assert found.warnings == ()
    assert found.is_whole
    assert (found.name, found.scheme.name, found.duration) == ("short-first", "first", 1.0)
    assert found.scenario.raw == scenario.raw
    assert found.parameters == node_parameters(scenario, "first")
    assert found.summary == json.loads((recorded / "summary.json").read_text())
    assert found.versions == {"quadftc": "0.1.0", "commit": "abc"}
    for name in VECTORS:
        if name != "sliding_variable":  # not recorded here
            read, flown = getattr(found.flight, name), getattr(flight, name)
            assert np.array_equal(read, flown, equal_nan=True), name


def test_run_is_read_from_its_file_too(recorded):
    found = read_run(recorded / "short-first_0.mcap")
    assert (found.name, found.scheme.name, found.warnings) == ("short-first", "first", ())


def test_run_cut_in_the_middle_is_read_up_to_the_cut(run, flight):
    cut(run, 0.5)
    found = read_run(run)
    end = found.duration
    assert 0.2 < end < 0.8
    (warning,) = found.warnings
    assert warning.startswith(f"{run}: cut short at {end:.1f} s of 1 s; read up to there")
    assert warning.endswith(f"run quadftc repair {run}")
    assert found.summary["samples"] == len(found.flight) < len(flight)
    assert (found.summary["checks"], found.summary["passed"]) == ([], None)
    assert np.array_equal(found.flight.angles, flight.angles[: len(found.flight)])
    json.dumps(found.summary, allow_nan=False)


def test_run_cut_before_its_first_message_is_refused(run):
    cut(run, 0.05)
    assert "cut short before it holds a run: missing" in refusal(run)
    assert refusal(run).endswith(f"run quadftc repair {run}")
    bag_file(run).write_bytes(b"")
    assert refusal(run) == f"{bag_file(run)}: empty file"


def test_run_damaged_inside_is_read_up_to_the_damage(run):
    data = bytearray(bag_file(run).read_bytes())
    middle = len(data) // 2
    data[middle : middle + 64] = np.random.default_rng(1).bytes(64)
    bag_file(run).write_bytes(data)
    found = read_run(run)
    assert not found.is_whole
    assert "read up to there" in found.warnings[0]


def test_attachments_lost_are_taken_from_beside_the_bag(tmp_path, scenario, flight):
    lost = ("scenario.yaml", "parameters.yaml")
    run = record(tmp_path / "short-first", scenario, "first", flight, leave_out=lost)
    assert "missing scenario.yaml (attached to the bag, or beside it)" in refusal(run)
    (run / "scenario.yaml").write_text(TEXT)
    found = read_run(run)
    assert found.scheme.name == "first"
    assert found.parameters["controller"]["controller"] == "ismc"
    (warning,) = found.warnings
    assert warning == f"{run}: parameters.yaml is missing; took the parameters that the scenario gives"


def test_scheme_is_told_by_the_parameters_and_not_by_the_name(run):
    renamed = run.rename(run.parent / "short-second")
    assert read_run(renamed).scheme.name == "first"


def test_scheme_that_nothing_tells_is_asked_for(tmp_path, scenario, flight):
    run = record(tmp_path / "mine", scenario, "first", flight, leave_out=("parameters.yaml",))
    (run / "summary.json").unlink()
    assert "which of the schemes first, second was flown is not known" in refusal(run)


def test_summary_that_is_missing_or_broken_is_computed(run):
    whole = read_run(run).summary
    for text, word in (
        ("{", "broken"),
        ('{"samples": NaN}', "broken"),
        ("[]", "no mapping"),
        (None, "missing"),
    ):
        (run / "summary.json").unlink(missing_ok=True)
        if text is not None:
            (run / "summary.json").write_text(text)
        found = read_run(run)
        assert len(found.warnings) == 1
        assert f"summary.json: {word}" in found.warnings[0]
        assert found.summary["metrics"] == whole["metrics"]


def test_summary_that_disagrees_with_the_bag_does_not_count(run):
    stored = json.loads((run / "summary.json").read_text())
    true = stored["metrics"]["tracking_rmse_deg"]["roll"]
    stored["metrics"]["tracking_rmse_deg"]["roll"] = true + 1e-3
    (run / "summary.json").write_text(json.dumps(stored))
    found = read_run(run)
    assert "disagrees with the bag, whose numbers count: metrics.tracking_rmse_deg.roll" in found.warnings[0]
    assert found.summary["metrics"]["tracking_rmse_deg"]["roll"] == pytest.approx(true, rel=1e-12)
    assert found.summary["wall_time_s"] == 0.5


def test_missing_topics_are_named(tmp_path, scenario, flight):
    needed = record(tmp_path / "a-first", scenario, "first", flight, leave_out=("plant/attitude", "imu/data"))
    assert (
        "no run or replay of quadftc: missing messages on imu/data, plant/attitude; topics with"
        in refusal(needed)
    )
    wanted = record(tmp_path / "b-first", scenario, "first", flight, leave_out=("torque/command",))
    found = read_run(wanted)
    assert "no message on torque/command; their numbers are missing" in found.warnings[0]
    assert found.summary["metrics"]["torque_rms"]["roll"] is None


def test_foreign_bag_is_refused_with_what_it_lacks(tmp_path):
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/Header", "ros2msg", b"uint32 seq\n")
        writer.add_message(writer.register_channel("/camera", "cdr", schema), 0, b"\0\1\0\0\0\0\0\0", 0)
        writer.finish()
    text = refusal(path)
    assert "no run or replay of quadftc: missing scenario.yaml" in text
    assert "messages on imu/data, plant/attitude, attitude/reference" in text
    assert text.endswith("topics with messages there: /camera")


def test_what_is_no_bag_is_refused_in_one_line(tmp_path):
    (tmp_path / "noise.mcap").write_bytes(np.random.default_rng(2).bytes(1000))
    assert refusal(tmp_path / "noise.mcap").endswith("noise.mcap: not an MCAP file")
    assert refusal(tmp_path / "nothing").endswith("nothing: no such bag")


def test_flight_that_was_ended_early_is_no_whole_one(tmp_path, scenario, flight):
    found = read_run(record(tmp_path / "short-first", scenario, "first", flight.first(60)))
    assert found.warnings == (f"{found.path}: flight ended early, at 0.6 s of 1 s; read up to there",)


def test_runs_are_found_by_name_and_once(tmp_path, recorded):
    for name in ("b", "a", "c"):
        shutil.copytree(recorded, tmp_path / name)
    (tmp_path / "notes").mkdir()
    (tmp_path / "report.html").write_text("")
    assert find_runs([tmp_path / "c", tmp_path]) == [tmp_path / name for name in ("c", "a", "b")]
    assert find_runs([tmp_path / "a" / "short-first_0.mcap"]) == [tmp_path / "a" / "short-first_0.mcap"]


@pytest.mark.parametrize("name", ["notes", "none"])
def test_place_without_runs_is_refused(tmp_path, name):
    (tmp_path / "notes").mkdir()
    with pytest.raises(BagError, match=f"{name}: no (run in this directory|such file or directory)"):
        find_runs([tmp_path / name])
    with pytest.raises(BagError, match="no runs given"):
        find_runs([])


@pytest.mark.parametrize("role", ["observer: sliding_mode", "disturbance_observer: exosystem"])
def test_observer_that_is_not_installed_has_its_name_and_what_it_said(tmp_path, scenario, flight, role):
    without = ("scenario.yaml", "parameters.yaml")
    run = record(tmp_path / "short-first", scenario, "first", flight, leave_out=without)
    installed = read_run(record(tmp_path / "all-first", scenario, "first", flight))
    (run / "scenario.yaml").write_text(TEXT.replace(role, f"{role.partition(':')[0]}: psychic"))
    found = read_run(run)
    assert "psychic" in (found.observer, found.disturbance_observer)
    assert found.summary["metrics"] == installed.summary["metrics"]
    assert any("psychic: not installed here; what it said is in the bag" in said for said in found.warnings)


def test_controller_that_is_not_installed_is_named_as_such(tmp_path, scenario, flight):
    run = record(tmp_path / "short-first", scenario, "first", flight, leave_out=("scenario.yaml",))
    (run / "scenario.yaml").write_text(TEXT.replace("controller: ismc", "controller: psychic", 1))
    with pytest.raises(MissingPartError, match=r"no controller 'psychic'.*is the package installed"):
        read_run(run)


def test_flight_recorded_without_a_scenario_is_judged_by_what_was_injected(tmp_path, scenario, flight):
    path = record(tmp_path / "flight1", scenario, "first", flight, leave_out=("scenario.yaml",))
    bag = read_bag(path)
    assert is_live(bag)
    run = live_run(bag)
    assert (run.name, run.label, run.observer) == ("flight1", "live", "sliding_mode")
    assert [(event.axis, event.component) for event in run.fault_events] == [("roll", "attitude")]
    assert run.fault_events[0][2:4] == pytest.approx((0.3, 0.7), abs=0.011)
    assert run.scenario.rate == pytest.approx(100.0)
    assert run.duration == pytest.approx(1.0, abs=0.02)
    judged, flown = (
        run.summary["metrics"],
        summary(flight, scenario, scenario.scheme("first"), None)["metrics"],
    )
    assert judged["tracking_rmse_deg"] == pytest.approx(flown["tracking_rmse_deg"])
    assert judged["diagnosis"]["fault_count"] == 1
    assert "without a scenario" in run.warnings[0]


def test_flight_of_a_vehicle_without_truth_is_read_as_far_as_it_goes(tmp_path, scenario, flight):
    lacking = ("scenario.yaml", "parameters.yaml", "plant/attitude", "plant/rate", "fault/injected")
    run = live_run(read_bag(record(tmp_path / "a b", scenario, "first", flight, leave_out=lacking)))
    assert (run.scenario.name, run.observer) == ("a_b", "bank")
    assert run.fault_events == ()
    assert run.summary["metrics"]["tracking_rmse_deg"]["roll"] is None
    assert "no message on plant/attitude, plant/rate, fault/injected" in run.warnings[-1]
    assert "parameters.yaml is missing; vehicle and parts are taken" in run.warnings[1]


def test_run_with_its_scenario_and_a_foreign_imu_are_not_live(tmp_path, recorded, scenario, flight):
    assert not is_live(read_bag(recorded))
    lacking = ("scenario.yaml", *VECTOR_TOPICS, "attitude/reference", "control/status")
    assert not is_live(read_bag(record(tmp_path / "imu", scenario, "first", flight, leave_out=lacking)))


def test_fault_that_passes_zero_is_one_event(flight):
    sine = np.sin(3.0 * flight.time)[:, None] * np.ones(3) * (flight.time < 0.5)[:, None]
    found = events_of(dataclasses.replace(flight, gyro_fault=sine, fault=np.zeros_like(sine)))
    assert [(event.axis, event.component) for event in found] == [
        (axis, "gyro") for axis in ("roll", "pitch", "yaw")
    ]
    assert found[0].stop == pytest.approx(0.5, abs=0.011)


def test_rotor_is_faulty_while_its_thrust_is_not_that_of_a_healthy_one(flight):
    effectiveness = np.ones((len(flight), 4))
    effectiveness[(flight.time >= 0.3) & (flight.time < 0.7), 1] = 0.6
    effectiveness[:, 3] = np.nan  # not known
    (event,) = rotor_events_of(dataclasses.replace(flight, rotor_effectiveness=effectiveness))
    assert (event.axis, event.component) == ("2", "rotor")
    assert event[2:4] == pytest.approx((0.3, 0.7), abs=0.011)


def test_kind_of_a_fault_is_what_the_injector_said_while_it_acted(tmp_path):
    said = {  # s: what acts then
        4: ["bias on attitude roll, pitch until 9 s", "stuck on gyro roll until inf s"],
        6: ["bias on attitude roll, pitch until 9 s", "sine on attitude roll until 9 s"],
        12: ["loss on rotor 2 until inf s"],
    }
    topics = {"/a/imu/data": "sensor_msgs/msg/Imu", "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}
    with BagWriter(tmp_path / "bag") as writer:
        for topic, type_name in topics.items():
            writer.add_topic(topic, type_name, QoSProfile(depth=10))
        for second in range(20):  # the clock of the machine runs twice as fast as the flight
            imu = Imu(header=Header(stamp=Time(sec=100 + second)))
            values = [KeyValue(key=str(k), value=words) for k, words in enumerate(said.get(second, ()))]
            told = DiagnosticArray(status=[DiagnosticStatus(name="a/fault_injector: faults", values=values)])
            for topic, message in zip(topics, (imu, told), strict=True):
                at = (200 + 2 * second) * 10**9
                writer.write(topic, serialize_message(message), at, at)
    sensor = [("roll", "fault", 3.0, 7.0), ("pitch", "fault", 5.0, 7.0), ("yaw", "fault", 3.0, 7.0)]
    events = [FaultEvent(*each) for each in sensor]
    events += [FaultEvent("2", "fault", *span, "rotor") for span in ((10.0, 15.0), (16.0, 19.0))]
    found = with_kinds(read_bag(tmp_path / "bag"), events)
    assert [event.kind for event in found] == ["step+sine", "step", "fault", "loss", "fault"]
    assert [event._replace(kind="fault") for event in found] == events


def test_time_of_flight_is_that_of_the_samples_where_the_machine_is_behind():
    recorded = 1_700_000_000_000_000_000 + np.arange(0, 10_000_000_000, 1_000_000_000)
    stamps = 1_700_000_000_000_000_000 + np.arange(0, 5_000_000_000, 500_000_000)  # at half the speed
    asked = recorded[[0, 4, 8]] + 500_000_000
    np.testing.assert_allclose(flight_times(asked, recorded, stamps), [0.25, 2.25, 4.25], atol=1e-6)


def test_nodes_defaults_are_those_of_a_live_run():
    from quadftc_control.controller_node import ControllerParameters
    from quadftc_fdi import disturbance_observer_node, fault_observer_node
    from quadftc_model.parameters import parameters_of
    from quadftc_ros.parameters import VehicleParameters

    nodes = {
        "fault_observer": fault_observer_node.ObserverParameters,
        "disturbance_observer": disturbance_observer_node.ObserverParameters,
        "controller": ControllerParameters,
    }
    for node, (name, _, default) in PARTS.items():
        assert {spec.name: spec.default for spec in parameters_of(nodes[node])}[name] == default
    assert [spec.default for spec in parameters_of(VehicleParameters)] == [VEHICLE]
