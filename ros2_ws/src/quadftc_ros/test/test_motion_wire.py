"""Motion, position samples and rotor speeds: what is written is what rclpy reads, and the other way round."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from quadftc_model.samples import (
    FAULTY,
    HEALTHY,
    RECOVERING,
    PositionSample,
    RotorCondition,
    RotorEstimate,
    effectiveness_of,
)
from quadftc_msgs.msg import RotorCondition as RotorConditionMessage
from quadftc_ros.conversions import array_of, stamp_of
from quadftc_ros.motion_wire import (
    OdometryWire,
    PoseWire,
    PositionSampleReader,
    PositionSampleWire,
    RotorsReader,
    RotorsWire,
)
from quadftc_ros.rotor_wire import (
    EffectivenessReader,
    RotorConditionReader,
    RotorConditionWire,
    RotorStatusWire,
)
from quadftc_ros.wire import pose_of

STAMPS = st.integers(0, 2**31 * 10**9 - 1)
THREE = arrays(np.float64, 3, elements=st.floats(allow_nan=False))
FOUR = arrays(np.float64, 4, elements=st.floats(allow_nan=False))


def quaternion(message):
    return np.array([message.x, message.y, message.z, message.w])


@given(STAMPS, THREE, FOUR, THREE, THREE)
def test_odometry_is_what_rclpy_reads(stamp_ns, position, q_xyzw, velocity, body_rate):
    wire = OdometryWire()
    wire(7, velocity, -q_xyzw, position, velocity)  # nothing stays of the one before
    message = deserialize_message(wire(stamp_ns, position, q_xyzw, velocity, body_rate), Odometry)
    assert (stamp_of(message), message.header.frame_id, message.child_frame_id) == (
        stamp_ns,
        "map",
        "base_link",
    )
    np.testing.assert_array_equal(array_of(message.pose.pose.position), position)
    np.testing.assert_array_equal(quaternion(message.pose.pose.orientation), q_xyzw)
    np.testing.assert_array_equal(array_of(message.twist.twist.linear), velocity)
    np.testing.assert_array_equal(array_of(message.twist.twist.angular), body_rate)
    assert not np.any([message.pose.covariance, message.twist.covariance])


@given(STAMPS, THREE, FOUR)
def test_pose_comes_back(stamp_ns, position, q_xyzw):
    data = PoseWire()(stamp_ns, position, q_xyzw)
    message = deserialize_message(data, PoseStamped)
    assert (stamp_of(message), message.header.frame_id) == (stamp_ns, "map")
    for mine, theirs in zip(pose_of(data), (position, q_xyzw), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@given(STAMPS, THREE, THREE, st.booleans())
def test_position_sample_comes_back(stamp_ns, position, velocity, has_velocity):
    sample = PositionSample(position, velocity if has_velocity else np.zeros(3), np.bool_(True))
    data = PositionSampleWire(0.5, 0.25, has_velocity)(stamp_ns, sample)
    for mine, theirs in zip(PositionSampleReader()(data), sample, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    message = deserialize_message(data, Odometry)
    assert message.pose.covariance[[0, 7, 14, 21]].tolist() == [0.25, 0.25, 0.25, -1.0]
    assert message.twist.covariance[[0, 21]].tolist() == [0.0625 if has_velocity else -1.0, -1.0]


@pytest.mark.parametrize(
    ("frame", "velocity"), [("map", 2.0), ("uav1/map", 2.0), ("base_link", 0.0), ("", 0.0)]
)
def test_velocity_counts_only_in_the_earth_frame(frame, velocity):
    message = Odometry(child_frame_id=frame)
    message.twist.twist.linear.x = 2.0
    read = PositionSampleReader()
    for _ in range(2):
        assert read(serialize_message(message)).velocity.tolist() == [velocity, 0.0, 0.0]
    message.child_frame_id = "map"  # another driver
    assert read(serialize_message(message)).velocity.tolist() == [2.0, 0.0, 0.0]


@given(STAMPS, FOUR)
def test_rotor_speeds_come_back(stamp_ns, speeds):
    data = RotorsWire(4)(stamp_ns, speeds)
    message = deserialize_message(data, JointState)
    assert stamp_of(message) == stamp_ns
    assert list(message.name) == ["rotor_1", "rotor_2", "rotor_3", "rotor_4"]
    assert (len(message.position), len(message.effort)) == (0, 0)
    np.testing.assert_array_equal(message.velocity, speeds)
    np.testing.assert_array_equal(RotorsReader(4)(data), speeds)


def test_rotors_are_read_by_name_whatever_changes_between_messages():
    read = RotorsReader(2)
    ours = RotorsWire(2)(0, np.array([1.0, 2.0]))
    for message, wanted in (
        (JointState(name=["rotor_2", "rotor_1"], velocity=[2.0, 1.0]), [1.0, 2.0]),
        (JointState(name=["rotor_1", "rotor_2"], velocity=[3.0, 4.0]), [3.0, 4.0]),
        (
            JointState(name=["arm", "rotor_1", "rotor_2"], position=[9.0] * 3, velocity=[9.0, 5.0, 6.0]),
            [5.0, 6.0],
        ),
        (JointState(name=["rotor_2", "rotor_1"], position=[9.0], velocity=[2.0, 1.0]), [1.0, 2.0]),
    ):
        assert read(serialize_message(message)).tolist() == wanted
        assert read(ours).tolist() == [1.0, 2.0]


def test_rotor_without_speed_is_named():
    read = RotorsReader(4)
    for message in (
        JointState(name=["rotor_1", "rotor_3"], velocity=[1.0, 2.0]),
        JointState(name=["rotor_1", "rotor_2", "rotor_3", "rotor_4"], velocity=[1.0]),
    ):
        for _ in range(2):
            with pytest.raises(ValueError, match=r"no velocity of rotor_2.* rotor_4"):
                read(serialize_message(message))


@given(st.binary(max_size=800))
def test_any_bytes_give_a_sample_or_an_error(data):
    for read in (PositionSampleReader(), RotorsReader(4)):
        try:
            result = read(b"\x00\x01" + data)
        except ValueError:
            continue
        assert len(result) in (3, 4)


def test_condition_of_rotors_survives_the_way_and_none_is_healthy():
    condition = RotorCondition(
        np.array([0.7, 1.0, 0.9]),
        np.array([np.inf, 0.0, 500.0]),
        np.array([True, False, False]),
        np.array([0.0, 1e-6, 0.0]),
    )
    wire, read = RotorConditionWire(3), RotorConditionReader(3)
    ones = np.ones(3)
    healthy = RotorCondition(ones, np.inf * ones, ones < 0.0, 0.0 * ones)
    for sent, wanted in ((condition, condition), (None, healthy)):
        found = read(wire(5, sent))
        assert deserialize_message(wire(5, sent), RotorConditionMessage).header.stamp.nanosec == 5
        for each, other in zip(found, wanted, strict=True):
            np.testing.assert_array_equal(each, other)
    with pytest.raises(ValueError, match="12 numbers: expected 4 for each of 4 rotors"):
        RotorConditionReader(4)(wire(5, condition))


def test_effectiveness_of_confirmed_faults_is_what_a_controller_counts_on():
    ones = np.ones(3)
    estimate = RotorEstimate(
        state=np.array([FAULTY, HEALTHY, RECOVERING], np.uint8),
        effectiveness=np.array([0.7, 0.8, 1.1]),
        std_dev=0.01 * ones,
        onset_age=ones,
        probability=ones,
        kind=np.zeros(3, np.uint8),
        ambiguous=np.zeros(3, bool),
    )
    wire, read = RotorStatusWire(3), EffectivenessReader(3)
    np.testing.assert_array_equal(read(wire(5, estimate)), effectiveness_of(estimate))
    np.testing.assert_array_equal(read(wire(5, estimate)), [0.7, 1.0, 1.0])
    assert read(wire(5, None)) is None
