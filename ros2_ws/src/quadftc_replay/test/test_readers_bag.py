"""Bags as flight logs: which topic becomes which signal, in MCAP and SQLite, whole and damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import BatteryState, Imu, JointState

from message_objects import set_stamp
from quadftc_bags.bag import BagError
from quadftc_model.rotations import quaternion_from_euler
from quadftc_replay.readers import read_log
from quadftc_replay.readers.bag_rotors import ARRAYS, add_rotors, find_rotor_choice
from quadftc_replay.readers.signals import Signals

PERIOD_NS = 10_000_000
START_NS = 5_000_000_000
COUNT = 60
YAW = np.pi / 2


def imu(row: int, scale: float = 1.0) -> Imu:
    message = Imu()
    message.orientation_covariance[0] = -1.0
    message.angular_velocity.x = 0.01 * scale * row
    message.linear_acceleration.z = 9.81
    return message


def pose(row: int) -> PoseStamped:
    message, q = PoseStamped(), quaternion_from_euler(np.array([0.01 * row, 0.0, 0.0]))
    orientation = message.pose.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = q.tolist()
    return message


def odometry(row: int) -> Odometry:
    message, q = Odometry(child_frame_id="base_link"), quaternion_from_euler(np.array([0.0, 0.0, YAW]))
    message.header.frame_id = "odom"
    orientation = message.pose.pose.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = q.tolist()
    message.pose.pose.position.x = 0.1 * row
    message.twist.twist.linear.x = 2.0  # forward: to the north, at this heading
    return message


def joints(speeds: list[float]) -> JointState:
    """Rotors 1 to 4 in another order."""
    order = (2, 0, 3, 1)
    return JointState(name=[f"rotor_{k + 1}" for k in order], velocity=[speeds[k] for k in order])


TOPICS = {
    "/imu/data": (Imu, imu),
    "/imu/second": (Imu, lambda row: imu(row, 1.1)),
    "/imu/raw": (Imu, imu),  # the main one again
    "/vicon/pose": (PoseStamped, pose),
    "/goal/pose": (PoseStamped, pose),
    "/odom": (Odometry, odometry),
    "/rotors/speed": (JointState, lambda row: joints([100.0, 200.0, 300.0, 400.0 + row])),
    "/rotors/command": (JointState, lambda row: joints([100.0, 200.0, 300.0, 400.0])),
    "/other/joints": (JointState, lambda row: joints([1.0, 2.0, 3.0, 4.0])),
    "/torque/command": (Vector3Stamped, lambda row: Vector3Stamped()),
    "/battery": (BatteryState, lambda row: BatteryState(voltage=12.0 - 0.01 * row)),
}


def write(directory: Path, plugin: StoragePlugin) -> Path:
    store = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(directory, version=9, storage_plugin=plugin) as writer:
        for topic, (kind, make) in TOPICS.items():
            name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
            connection = writer.add_connection(topic, name, typestore=store)
            for row in range(COUNT):
                message, stamp_ns = make(row), START_NS + row * PERIOD_NS
                set_stamp(message.header, stamp_ns)
                writer.write(connection, stamp_ns, serialize_message(message))
    return directory


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_topics_become_signals_whatever_the_storage_and_the_name(tmp_path, plugin):
    directory = write(tmp_path / "bag", plugin)
    file = next(each for each in directory.iterdir() if each.suffix in (".mcap", ".db3"))
    (tmp_path / "flight.log").write_bytes(file.read_bytes())
    for path in (directory, tmp_path / "flight.log"):
        log = read_log(path)
        assert set(log.gyros) == set(log.accelerometers) == {"", "/imu/second"}
        np.testing.assert_allclose(log.gyros[""].value[:, 0], 0.01 * np.arange(COUNT))
        np.testing.assert_allclose(log.gyros[""].time, 0.01 * np.arange(COUNT), atol=1e-12)
        assert log.start_ns == START_NS
        assert log.attitude is not None
        assert log.attitude_from_gyro is False  # of motion capture
        assert log.rotor_speeds is not None
        assert log.rotor_speeds.value[0].tolist() == [100.0, 200.0, 300.0, 400.0]
        assert log.rotor_commands is not None
        np.testing.assert_allclose(log.rotor_commands.value[0] * 16.0, [1.0, 4.0, 9.0, 16.0])
        assert log.velocity is not None
        np.testing.assert_allclose(log.velocity.value[0], [0.0, 2.0, 0.0], atol=1e-12)
        assert log.position is not None
        assert log.battery is not None
        assert any("/imu/raw: the same samples as /imu/data" in note for note in log.notes)


def test_rotors_are_known_by_the_names_of_their_topics(tmp_path):
    kinds = dict.fromkeys(("/motor_speeds", "/esc/rpm_setpoint", "/other/joints"), ARRAYS[1])
    stamp_ns, fields = np.arange(3) * PERIOD_NS, {"data": np.full((3, 4), 60.0, np.float32)}
    data = {
        name: {"stamp_ns": stamp_ns, **choose(fields)}
        for name, kind in kinds.items()
        if (choose := find_rotor_choice(name, kind)) is not None
    }
    assert set(data) == {"/motor_speeds", "/esc/rpm_setpoint"}
    signals = Signals(tmp_path, "bag")
    add_rotors(signals, {name: kinds[name] for name in data}, data, None)
    log = signals.flight_log()
    assert log.rotor_speeds is not None
    assert log.rotor_speeds.value[0].tolist() == [60.0] * 4
    assert log.rotor_commands is not None
    assert log.rotor_commands.value[0].tolist() == [1.0] * 4


def test_bag_cut_or_damaged_is_read_as_far_as_it_goes_or_refused_in_one_line(tmp_path):
    for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3):
        directory = write(tmp_path / plugin.name, plugin)
        whole = next(each for each in directory.iterdir() if each.suffix in (".mcap", ".db3")).read_bytes()
        rng = np.random.default_rng(3)
        for trial in range(12):
            data = bytearray(whole[: len(whole) * (trial + 1) // 12])
            if trial % 2:
                for place in rng.integers(16, len(data), 20).tolist():
                    data[place] ^= 1 << int(rng.integers(8))
            path = tmp_path / "damaged"
            path.write_bytes(data)
            assert_read_or_refused(path, plugin is StoragePlugin.MCAP)


def assert_read_or_refused(path: Path, has_check_sums: bool) -> None:
    problem = ""
    try:
        log = read_log(path)
        assert log.notes or not has_check_sums
        assert log.end < 3600.0
    except BagError as error:
        problem = str(error)
    assert "\n" not in problem
    assert not problem or problem.startswith(str(path))


def test_bag_without_a_usable_topic_says_what_was_expected(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
    with pytest.raises(BagError, match="without a usable signal; expected a gyro"):
        read_log(tmp_path / "bag")
    with pytest.raises(BagError, match="no bag in this directory"):
        read_log(tmp_path)
