"""Reading a replay back: whole it is what was replayed; damaged or incomplete it says so in one line."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from rclpy.serialization import serialize_message

from message_objects import ImuWriter
from quadftc_bags.bag import BagError, read_bag
from quadftc_bags.writer import BagWriter
from quadftc_flight.flight import Flight
from quadftc_flight.run_directory import is_replay, read_run
from quadftc_model.rotations import body_rates, quaternion_from_euler
from quadftc_model.samples import ImuSample
from quadftc_replay.diagnose import flight_of
from quadftc_replay.plan import ReplayOptions, plan_replay
from quadftc_replay.replay_bag import replay
from quadftc_replay.replay_directory import RecordedReplay, replay_from_bag
from quadftc_ros.qos import topic_profile

PERIOD_NS, START_NS, COUNT = 10_000_000, 7_000_000_000, 3000
ABSENT = slice(500, 520)  # samples without attitude
FAULTS = (
    "bias axis=roll value=2deg start=5s stop=8s",
    "drift axis=yaw rate=1deg/s start=20s stop=25s",
    "dropout channel=imu probability=0.5 start=12s stop=13s",
)
OPTIONS = ReplayOptions(observer="supervised", faults=FAULTS, seed=3)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """A bag of half a minute of an IMU that sways, with a time without attitude."""
    directory = tmp_path_factory.mktemp("bags") / "sway"
    time = PERIOD_NS * 1e-9 * np.arange(COUNT)[:, None]
    frequency = np.array([1.0, 2.0, 3.0])
    angles, rates = 0.1 * np.sin(frequency * time), 0.1 * frequency * np.cos(frequency * time)
    there, attitude_valid = np.ones(COUNT, np.bool_), np.ones(COUNT, np.bool_)
    attitude_valid[ABSENT] = False
    force = np.tile([0.0, 0.0, 9.81], (COUNT, 1))
    q_xyzw, write_imu = quaternion_from_euler(angles), ImuWriter()
    imu = ImuSample(q_xyzw, body_rates(angles, rates), force, attitude_valid, there, there)
    with BagWriter(directory) as writer:
        writer.add_topic("/imu/data", "sensor_msgs/msg/Imu", topic_profile("sensor", "realtime"))
        for row in range(COUNT):
            stamp_ns = START_NS + row * PERIOD_NS
            sample = ImuSample(*(column[row] for column in imu))
            writer.write("/imu/data", serialize_message(write_imu(stamp_ns, sample)), stamp_ns, stamp_ns)
    return directory


@pytest.fixture(scope="module")
def replayed(recording, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("replays")
    return out / replay(recording, OPTIONS, out)["bag"]


@pytest.fixture
def copy(replayed, tmp_path) -> Path:
    """A copy of the replay, to be damaged."""
    return Path(shutil.copytree(replayed, tmp_path / replayed.name))


def read(path: Path) -> RecordedReplay:
    return replay_from_bag(read_bag(path))


def refusal(path: Path) -> str:
    with pytest.raises(BagError) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def bag_file(replayed: Path) -> Path:
    (found,) = replayed.glob("*.mcap")
    return found


def without_attachments(directory: Path, path: Path, leave_out=()) -> Path:
    """The messages of a bag written again, without what is attached to it."""
    bag = read_bag(directory)
    with BagWriter(path) as writer:
        for name, topic in bag.topics.items():
            if name not in leave_out:
                writer.add_topic(name, topic.type_name, topic_profile("sensor", "realtime"))
        for name, log_time, data in bag.messages():
            if name not in leave_out:
                writer.write(name, data, log_time, log_time)
    return path


def test_whole_replay_comes_back_as_it_was_made(recording, replayed):
    plan = plan_replay(recording, OPTIONS)
    expected = flight_of(plan.recording, plan.diagnose())
    found = read(replayed)
    assert found.warnings == ()
    assert found.is_whole
    assert (found.name, found.observer, found.duration) == ("sway-supervised", "supervised", 30.0)
    for field in dataclasses.fields(Flight):
        np.testing.assert_array_equal(getattr(found.flight, field.name), getattr(expected, field.name))
    assert found.summary == json.loads((replayed / "summary.json").read_text())
    assert found.parameters["fault_observer"] == plan.observer.parameters
    assert [fault.spec for fault in found.faults] == [fault.spec for fault in plan.faults]
    assert [(event.axis, event.kind, event.start) for event in found.fault_events] == [
        ("roll", "step", 5.0),
        ("yaw", "ramp", 20.0),
    ]


def test_readings_are_what_the_observer_saw_and_passed_on(replayed):
    found = read(replayed)
    held = ~found.flight.delivered
    absent = np.isnan(found.measured.angles).all(axis=1)
    assert np.array_equal(np.flatnonzero(absent & ~held), np.arange(COUNT)[ABSENT])
    assert 20 < held.sum() < 80
    assert np.isnan(found.measured.body_rate[held]).all()
    rows = (found.flight.time >= 6.0) & (found.flight.time < 8.0) & ~absent
    sway = 0.1 * np.sin(found.flight.time[rows])
    assert found.measured.angles[rows, 0] == pytest.approx(sway + np.radians(2.0))
    assert found.corrected.angles[rows, 1] == pytest.approx(found.measured.angles[rows, 1], abs=1e-4)
    assert np.all(np.abs(found.corrected.angles[rows, 0] - sway) < np.radians(0.5))


def test_replay_of_a_replay_has_its_faults_from_the_recording(replayed, tmp_path):
    again = read(tmp_path / replay(replayed, ReplayOptions(), tmp_path)["bag"])
    assert again.warnings == ()
    assert again.faults == ()
    assert again.origin.truth == "recorded faults"
    assert {event.axis for event in again.fault_events} == {"roll", "yaw"}


def test_bag_alone_says_it_all(replayed, tmp_path):
    shutil.copy(bag_file(replayed), tmp_path)
    found = read(bag_file(tmp_path))
    (warning,) = found.warnings
    assert warning == f"{tmp_path / 'summary.json'}: missing; computed from the bag"
    assert found.summary["metrics"] == read(replayed).summary["metrics"]


def test_replay_cut_in_the_middle_is_read_up_to_the_cut(copy):
    data = bag_file(copy).read_bytes()
    bag_file(copy).write_bytes(data[: len(data) * 7 // 10])
    found = read(copy)
    end = found.duration
    assert 8.0 < end < 25.0
    (warning,) = found.warnings
    assert warning.startswith(f"{copy}: cut short at {end:.1f} s of 30.0 s; read up to there")
    assert warning.endswith(f"run quadftc repair {copy}")
    assert len(found.flight) == found.summary["samples"] < COUNT
    events = found.summary["metrics"]["diagnosis"]["events"]
    assert [(event["axis"], event["stop"]) for event in events][:1] == [("roll", 8.0)]
    assert all(event["stop"] <= end for event in events)
    json.dumps(found.summary, allow_nan=False)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"samples": "many"}, "replay.yaml: samples: Input should be a valid integer"),
        ({"fault_events": [{"axis": "rol"}]}, "replay.yaml: fault_events.0.axis: Input should be 'roll'"),
        ({"duration": None}, "replay.yaml: duration: Input should be a valid number"),
        ({"faults": ["bias axis=rol"]}, "replay.yaml: fault 'bias axis=rol': axes: 'rol' is no axis"),
    ],
)
def test_description_that_makes_no_sense_is_refused(replayed, tmp_path, changes, words):
    bare = without_attachments(replayed, tmp_path / "bare")
    assert not is_replay(read_bag(bare))
    shutil.copy(replayed / "parameters.yaml", bare)
    text = yaml.safe_load((replayed / "replay.yaml").read_text())
    (bare / "replay.yaml").write_text(yaml.safe_dump({**text, **changes}))
    assert words in refusal(bare)


def test_what_lies_beside_a_bag_stands_for_what_is_not_attached(replayed, tmp_path):
    bare = without_attachments(replayed, tmp_path / "bare")
    shutil.copy(replayed / "replay.yaml", bare)
    assert "a replay without parameters.yaml" in refusal(bare)
    (bare / "parameters.yaml").write_text("- no parameter file")
    assert "parameters.yaml makes no sense" in refusal(bare)
    shutil.copy(replayed / "parameters.yaml", bare)
    assert read(bare).summary["metrics"] == read(replayed).summary["metrics"]


def test_topics_that_are_missing_are_named(replayed, tmp_path):
    bare = without_attachments(replayed, tmp_path / "a", leave_out=("/fault/status", "/fault/estimate"))
    for name in ("replay.yaml", "parameters.yaml"):
        shutil.copy(replayed / name, bare)
    assert "missing messages on fault/estimate, fault/status; topics with messages there: /d" in refusal(bare)
    partly = without_attachments(replayed, tmp_path / "b", leave_out=("/imu/corrected",))
    for name in ("replay.yaml", "parameters.yaml", "summary.json"):
        shutil.copy(replayed / name, partly)
    found = read(partly)
    assert found.warnings == (f"{partly}: no message on imu/corrected; their figures are missing",)
    assert np.isnan(found.corrected.angles).all()


def test_replay_is_no_flight(replayed):
    with pytest.raises(BagError, match="a replay of a recording; expected a flight") as caught:
        read_run(replayed)
    assert "\n" not in str(caught.value)
