"""Reading a recording: which topic, which samples count, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Vector3, Vector3Stamped
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from message_objects import set_stamp
from quadftc_bags.bag import BagError
from quadftc_bags.writer import BagWriter
from quadftc_replay.imu_from_bag import IMU, VECTOR, recording_from_bag, windows_of
from quadftc_replay.imu_recording import keep_good_stamps, torque_before
from quadftc_ros.join import CommandGate

PERIOD_NS = 10_000_000
START_NS = 5_000_000_000
COUNT = 20


def imu(stamp_ns: int, number: int = 1) -> Imu:
    message = Imu()
    set_stamp(message.header, stamp_ns)
    message.orientation.w = 1.0
    message.angular_velocity.x = 0.01 * number
    message.linear_acceleration.z = 9.81
    return message


def imus(count: int = COUNT) -> list[Imu]:
    return [imu(START_NS + k * PERIOD_NS, k) for k in range(count)]


def vector(stamp_ns: int, x: float = 0.0) -> Vector3Stamped:
    message = Vector3Stamped(vector=Vector3(x=x))
    set_stamp(message.header, stamp_ns)
    return message


def write(directory: Path, topics: dict[str, tuple[str, list]], attachments=None) -> Path:
    """Write a bag: topic to type and messages; a message is recorded every period."""
    with BagWriter(directory, attachments or {}) as writer:
        for topic, (type_name, messages) in topics.items():
            writer.add_topic(topic, type_name, QoSProfile(depth=10))
            for number, message in enumerate(messages):
                log_time = START_NS + number * PERIOD_NS
                writer.write(topic, serialize_message(message), log_time, log_time)
    return directory


def imu_bag(tmp_path: Path, messages: list[Imu], topic: str = "/imu/data") -> Path:
    return write(tmp_path / "bag", {topic: (IMU, messages)})


def refusal(path: Path, topic: str = "") -> str:
    with pytest.raises(BagError) as caught:
        recording_from_bag(path, topic)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("topics", "wanted", "chosen"),
    [
        (["/camera/imu"], "", "/camera/imu"),
        (["/plant/imu", "/imu/data", "/imu/corrected"], "", "/imu/data"),
        (["/plant/imu", "/imu/data"], "plant/imu", "/plant/imu"),
        (["/one/imu/data", "/two/imu/data"], "two/imu/data", "/two/imu/data"),
    ],
)
def test_topic_is_the_only_imu_or_imu_data_or_the_one_asked_for(tmp_path, topics, wanted, chosen):
    path = write(tmp_path / "bag", {topic: (IMU, imus()) for topic in topics})
    assert recording_from_bag(path, wanted).topic == chosen


@pytest.mark.parametrize(
    ("topics", "wanted", "words"),
    [
        ({"/a": (VECTOR, [vector(1)])}, "", "no topic of type sensor_msgs/msg/Imu; topics there: /a (geom"),
        ({"/imu/data": (IMU, [])}, "", "no message on /imu/data"),
        (
            {"/imu/data": (IMU, imus())},
            "imu/raw",
            "topic 'imu/raw' is not in the bag; topics there: /imu/data",
        ),
        (
            {"/imu/data": (VECTOR, [vector(1)])},
            "imu/data",
            "of type geometry_msgs/msg/Vector3Stamped, expected",
        ),
        ({"/a": (IMU, imus()), "/b": (IMU, imus())}, "", "several IMUs, choose one with --topic: /a, /b"),
        ({"/a/imu/data": (IMU, imus()), "/b/imu/data": (IMU, imus())}, "imu/data", "more than one namespace"),
        ({"/imu/data": (IMU, imus(1))}, "", "1 samples with a good stamp; expected at least 2"),
    ],
)
def test_bag_without_the_topic_is_refused_with_what_there_is(tmp_path, topics, wanted, words):
    assert words in refusal(write(tmp_path / "bag", topics), wanted)


def change(messages: list[Imu], rows: slice, path: str, value: object) -> list[Imu]:
    """Set a field of some messages, such as ``orientation_covariance.0``."""
    *places, last = path.split(".")
    for message in messages[rows]:
        target = message
        for place in places:
            target = getattr(target, place)
        if last.isdecimal():
            target[int(last)] = value
        else:
            setattr(target, last, value)
    return messages


ALL = slice(None)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("orientation_covariance.0", -1.0, "no sample has a usable attitude (20 marked absent, 0 zero"),
        ("orientation.w", 0.0, "no sample has a usable attitude (0 marked absent, 20 zero"),
        ("orientation.x", np.nan, "no sample has a usable attitude (0 marked absent, 20 zero"),
        ("angular_velocity_covariance.0", -1.0, "no sample has a usable body rate (20 marked absent"),
        ("angular_velocity.y", np.inf, "no sample has a usable body rate (0 marked absent, 20 not finite)"),
    ],
)
def test_recording_without_attitude_or_rate_is_refused(tmp_path, path, value, words):
    assert words in refusal(imu_bag(tmp_path, change(imus(), ALL, path, value)))


def test_recording_without_a_sample_to_start_from_is_refused(tmp_path):
    messages = change(imus(), slice(0, None, 2), "orientation_covariance.0", -1.0)
    path = imu_bag(tmp_path, change(messages, slice(1, None, 2), "angular_velocity.x", np.nan))
    assert "no sample has both attitude and body rate" in refusal(path)


@pytest.mark.parametrize(
    ("path", "value", "valid"),
    [
        ("orientation_covariance.0", -1.0, "attitude_valid"),
        ("orientation.w", 0.5, "attitude_valid"),
        ("angular_velocity.y", np.nan, "rate_valid"),
    ],
)
def test_unusable_samples_are_marked_absent_and_counted(tmp_path, path, value, valid):
    recording = recording_from_bag(imu_bag(tmp_path, change(imus(), slice(4, 7), path, value)))
    assert np.flatnonzero(~getattr(recording.imu, valid)).tolist() == [4, 5, 6]
    assert all(np.isfinite(column).all() for column in recording.imu)
    (warning,) = recording.warnings
    assert "3 of 20 samples without" in warning


def test_time_going_back_is_refused_with_its_place(tmp_path):
    messages = imus()
    set_stamp(messages[12].header, START_NS)
    words = refusal(imu_bag(tmp_path, messages))
    assert "time goes back by 0.11 s at message 13; expected stamps that increase; --skip-backwards" in words


def test_samples_that_go_back_are_left_out_if_asked(tmp_path):
    messages = imus()
    set_stamp(messages[12].header, START_NS)
    recording = recording_from_bag(imu_bag(tmp_path, messages), skip_backwards=True)
    assert recording.rejected == {"stamp went back": 1}
    assert len(recording.passed_on["plant/imu"].messages) == len(recording) == COUNT - 1
    assert 0.01 * 12 not in recording.imu.body_rate[:, 0]


def test_repeated_and_unset_stamps_are_left_out_and_counted(tmp_path):
    messages = imus()
    for row, stamp_ns in ((0, 0), (7, START_NS + 6 * PERIOD_NS)):
        set_stamp(messages[row].header, stamp_ns)
    recording = recording_from_bag(imu_bag(tmp_path, messages))
    assert recording.rejected == {"stamp not set": 1, "stamp repeated": 1}
    assert "2 of 20 samples left out" in recording.warnings[0]
    assert np.all(np.diff(recording.stamp_ns) > 0)


def test_clock_that_begins_at_zero_is_a_clock():
    stamps = np.arange(5) * PERIOD_NS
    assert len(keep_good_stamps(stamps, stamps, "bag", False).rows) == 5


def test_stamps_that_are_never_set_are_replaced_by_the_time_of_recording(tmp_path):
    messages = imus()
    for message in messages:
        set_stamp(message.header, 0)
    recording = recording_from_bag(imu_bag(tmp_path, messages))
    assert recording.stamp_ns[3] == START_NS + 3 * PERIOD_NS
    assert "no stamp is set" in recording.warnings[0]


def test_gap_is_reported(tmp_path):
    messages = imus()
    for message in messages[10:]:
        message.header.stamp.sec += 3
    (warning,) = recording_from_bag(imu_bag(tmp_path, messages)).warnings
    assert "gaps of more than 1 s: 1" in warning


def test_damaged_file_is_read_up_to_the_damage(tmp_path):
    path = imu_bag(tmp_path, imus(2000))
    file = path / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-200])
    recording = recording_from_bag(path)
    assert "cut short" in recording.warnings[0]
    assert len(recording) > 0


def test_sqlite_bag_reads_like_mcap(tmp_path):
    mcap = recording_from_bag(imu_bag(tmp_path, imus()))
    store = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(tmp_path / "old", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/imu/data", IMU, typestore=store)
        for number, message in enumerate(imus()):
            writer.write(connection, START_NS + number * PERIOD_NS, serialize_message(message))
    for path in (tmp_path / "old", next((tmp_path / "old").glob("*.db3"))):
        old = recording_from_bag(path)
        assert old.topic == "/imu/data"
        np.testing.assert_array_equal(old.stamp_ns, mcap.stamp_ns)
        for column, other in zip(old.imu, mcap.imu, strict=True):
            np.testing.assert_array_equal(column, other)


def test_broken_sqlite_bag_is_refused(tmp_path):
    (tmp_path / "broken.db3").write_bytes(b"nothing of the kind")
    assert "not a bag that can be read" in refusal(tmp_path / "broken.db3")


def test_torque_is_paired_with_samples_as_the_graph_does_in_lockstep():
    rng = np.random.default_rng(1)
    stamps = START_NS + PERIOD_NS * np.flatnonzero(rng.random(200) < 0.7)  # some samples are withheld
    commands = rng.standard_normal((len(stamps), 3))
    commands[rng.random(len(stamps)) < 0.1, 1] = np.nan
    given: list[np.ndarray] = []
    gate = CommandGate("lockstep", lambda stamp_ns, message, torque: given.append(torque), str)
    for stamp_ns, command in zip(stamps.tolist(), commands, strict=True):
        gate.put_sample(stamp_ns, None)
        gate.put_command(stamp_ns, command)
    np.testing.assert_array_equal(torque_before(stamps, stamps, commands), given)


@pytest.mark.parametrize(
    ("topic", "found"),
    [("/one/imu/data", "/one/torque/command"), ("/three/imu/data", None), ("/camera/imu", None)],
)
def test_torque_is_that_of_the_vehicle(tmp_path, topic, found):
    commands = [vector(START_NS + k * PERIOD_NS, 0.5) for k in range(COUNT)]
    topics = {f"/{name}/torque/command": (VECTOR, commands) for name in ("one", "two")}
    recording = recording_from_bag(write(tmp_path / "bag", {topic: (IMU, imus()), **topics}))
    assert recording.torque_topic == found
    assert recording.torque[1:, 0].tolist() == [0.5 if found else 0.0] * (COUNT - 1)


SCENARIO = """
duration: 0.2 s
rate: 100 Hz
vehicle: qball_x4
faults: [{kind: bias, axes: pitch, value: 1 deg, start: 0.05 s, stop: 0.1 s}]
schemes: {only: {controller: smc}}
"""


def test_recorded_faults_have_the_windows_of_their_scenario_from_the_first_sample_on(tmp_path):
    """The first sample was withheld, so the recording begins a period late."""
    faults = [vector(START_NS + k * PERIOD_NS, 0.1 if 5 <= k < 10 else 0.0) for k in range(COUNT)]
    withheld = Header()
    withheld.stamp.sec, withheld.stamp.nanosec = divmod(START_NS, 10**9)
    topics = {
        "/imu/data": (IMU, imus()[1:]),
        "/fault/injected": (VECTOR, faults),
        "/fault/dropped": ("std_msgs/msg/Header", [withheld]),
    }
    recording = recording_from_bag(write(tmp_path / "bag", topics, {"scenario.yaml": SCENARIO.encode()}))
    ((start, stop, axes),) = recording.fault_windows
    assert (start, stop, axes) == (pytest.approx(0.04), pytest.approx(0.09), ("pitch",))
    (event,) = recording.fault_events
    assert event == ("pitch", event.kind, start, stop, "attitude")
    assert recording.faults["attitude"][:, 0].tolist() == [0.0] * 4 + [0.1] * 5 + [0.0] * 10


def test_windows_of_a_recorded_fault_ignore_short_pauses():
    stamps = np.arange(1000) * PERIOD_NS
    fault = np.zeros((1000, 3))
    fault[100:200, 0] = fault[250:300, 2] = 0.1  # a pause of 0.5 s
    fault[600:700, 1] = 0.1  # a pause of 3 s
    windows = windows_of(stamps, fault)
    assert [tuple(window) for window in windows] == [(1.0, 3.0, ("roll", "yaw")), (6.0, 7.0, ("pitch",))]
