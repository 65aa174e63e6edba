"""ROS 1 bags, as rosbags writes them: whole, compressed, cut and damaged."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from quadftc_bags.bag import bag_topics, read_bag
from quadftc_replay.readers import read_log

COUNT = 4000
PERIOD_NS = 2_500_000
START_NS = 1_700_000_000_000_000_000
STORE = get_typestore(Stores.ROS1_NOETIC)
HEADER, TIME, IMU, VECTOR, QUATERNION, JOINTS, TEXT = (
    STORE.types[name]
    for name in (
        *("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "sensor_msgs/msg/Imu"),
        *("geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion", "sensor_msgs/msg/JointState"),
        "std_msgs/msg/String",
    )
)


def write(path, compression=None, chunk=1 << 16):
    writer = Writer(path)
    writer.chunk_threshold = chunk
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        imu = writer.add_connection("/imu/data", IMU.__msgtype__, typestore=STORE)
        joints = writer.add_connection("/motor_speeds", JOINTS.__msgtype__, typestore=STORE)
        text = writer.add_connection("/other", TEXT.__msgtype__, typestore=STORE)
        for k in range(COUNT):
            stamp_ns = START_NS + k * PERIOD_NS
            header = HEADER(k, TIME(stamp_ns // 10**9, stamp_ns % 10**9), "base_link")
            nine, none = np.zeros(9), np.zeros(0)
            rate, force = VECTOR(0.001 * k, np.sin(k), 0.0), VECTOR(0.0, 0.0, 9.81)
            # the message itself says that there is no orientation
            sample = IMU(
                header, QUATERNION(0.0, 0.0, 0.0, 1.0), np.r_[-1.0, nine[1:]], rate, nine, force, nine
            )
            speeds = JOINTS(header, [f"rotor_{i}" for i in range(4)], none, 100.0 * np.arange(4) + k, none)
            late_ns = stamp_ns + 5_000_000
            writer.write(imu, late_ns, STORE.serialize_ros1(sample, imu.msgtype))
            writer.write(joints, late_ns, STORE.serialize_ros1(speeds, joints.msgtype))
            writer.write(text, late_ns, STORE.serialize_ros1(TEXT("nothing of interest"), text.msgtype))
    return path


@pytest.mark.parametrize("compression", [None, *Writer.CompressionFormat])
def test_signals_stand_in_the_log_at_the_stamps_of_the_headers(tmp_path, compression):
    log = read_log(write(tmp_path / "flight.bag", compression))
    assert (log.format, log.notes, log.attitude) == ("ROS 1 bag", (), None)
    assert log.start_ns == START_NS
    np.testing.assert_allclose(log.gyros[""].time, 1e-9 * PERIOD_NS * np.arange(COUNT))
    np.testing.assert_array_equal(log.gyros[""].value[:, 0], 0.001 * np.arange(COUNT))
    assert log.rotor_speeds is not None
    np.testing.assert_array_equal(log.rotor_speeds.value[7], [7.0, 107.0, 207.0, 307.0])


@pytest.mark.parametrize("compression", [None, *Writer.CompressionFormat])
def test_bag_that_is_cut_is_read_up_to_the_cut(tmp_path, compression):
    path = write(tmp_path / "flight.bag", compression, chunk=1 << 18)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    log = read_log(path)
    assert log.notes == ("cut short or damaged; read what is there",)
    assert 0.25 * COUNT < len(log.gyros[""]) < 0.75 * COUNT


def test_bag_is_read_as_those_of_ros_2(tmp_path):
    path = write(tmp_path / "flight.bag")
    assert {name: info.count for name, info in bag_topics(path).items()} == dict.fromkeys(
        ("/imu/data", "/motor_speeds", "/other"), COUNT
    )
    series = read_bag(path, ["/imu/data"]).series("/imu/data")
    assert series.type_name == "sensor_msgs/msg/Imu"
    assert series.stamp_ns[1] - series.stamp_ns[0] == PERIOD_NS
    assert set(series["frame_id"]) == {"base_link"}
