"""Serialised messages to arrays: the same numbers as through rclpy, and errors for what is no message."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from geometry_msgs.msg import Vector3Stamped
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from message_objects import (
    ControlStatusWriter,
    FaultStatusWriter,
    ImuWriter,
    ReferenceWriter,
    VectorWriter,
    imu_sample,
    reference_of,
    set_stamp,
)
from quadftc_bags.cdr.layout import PaddingCleaner
from quadftc_model import samples
from quadftc_model.samples import AttitudeReference, ControllerOutput, FaultEstimate, ImuSample, level_sample
from quadftc_msgs.msg import AttitudeReference as AttitudeReferenceMessage
from quadftc_msgs.msg import ComponentFault, Diagnosis
from quadftc_ros.conversions import array_of, time_message
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.wire import (
    ControlStatusWire,
    FaultStatusWire,
    ImuWire,
    ReferenceWire,
    VectorWire,
    attitude_command_in,
    clock_message,
    imu_of,
    reference_in,
    vector_of,
)

FRAMES = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FF), max_size=20)


def doubles(count):
    return arrays(np.float64, count, elements=st.floats())


def swapped(data: bytes, count: int) -> bytes:
    """The same message as a big-endian machine sends it."""
    sec, nanosec, length = struct.unpack_from("<iII", data, 4)
    start = 4 + (12 + length + 7) // 8 * 8
    head = b"\x00\x00" + data[2:4] + struct.pack(">iII", sec, nanosec, length) + data[16:start]
    return head + struct.pack(f">{count}d", *struct.unpack_from(f"<{count}d", data, start))


@given(FRAMES, doubles(37))
def test_imu_is_what_rclpy_makes_of_it(frame, numbers):
    message = Imu()
    message.header.frame_id = frame
    q, rate, force = message.orientation, message.angular_velocity, message.linear_acceleration
    q.x, q.y, q.z, q.w = numbers[:4].tolist()
    rate.x, rate.y, rate.z = numbers[13:16].tolist()
    force.x, force.y, force.z = numbers[25:28].tolist()
    message.orientation_covariance = numbers[4:13]
    message.angular_velocity_covariance = numbers[16:25]
    message.linear_acceleration_covariance = numbers[28:37]
    data = serialize_message(message)
    for form in (data, swapped(data, 37)):
        for mine, theirs in zip(imu_of(form), imu_sample(message), strict=True):
            np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("channel", ["orientation", "angular_velocity", "linear_acceleration"])
def test_absent_channel_is_seen(channel):
    message = Imu()
    getattr(message, f"{channel}_covariance")[0] = -1.0
    names = ("orientation", "angular_velocity", "linear_acceleration")
    valid = imu_of(serialize_message(message))[3:]
    assert dict(zip(names, valid, strict=True)) == {name: name != channel for name in names}


@given(FRAMES, doubles(3))
def test_vector_is_what_rclpy_makes_of_it(frame, numbers):
    message = Vector3Stamped()
    message.header.frame_id = frame
    message.vector.x, message.vector.y, message.vector.z = numbers.tolist()
    data = serialize_message(message)
    np.testing.assert_array_equal(vector_of(data), array_of(message.vector))
    np.testing.assert_array_equal(vector_of(swapped(data, 3)), numbers)


@given(FRAMES, doubles(9), st.floats())
def test_reference_is_what_rclpy_makes_of_it(frame, numbers, thrust):
    message = AttitudeReferenceMessage(thrust=thrust)
    message.header.frame_id = frame
    for part, three in zip(
        (message.angles, message.rates, message.accelerations), numbers.reshape(3, 3), strict=True
    ):
        part.x, part.y, part.z = three.tolist()
    data = serialize_message(message)
    np.testing.assert_array_equal(attitude_command_in(data).thrust, thrust)
    for mine in (reference_in(data), attitude_command_in(data).attitude):
        for my_part, their_part in zip(mine, reference_of(message), strict=True):
            np.testing.assert_array_equal(my_part, their_part)


@pytest.mark.parametrize(
    "data", [b"", b"\x00\x01", bytes(12), serialize_message(Vector3Stamped()), b"\x07\x07" + bytes(60)]
)
def test_what_is_no_imu_is_an_error(data):
    with pytest.raises(ValueError, match="not a Imu"):
        imu_of(data)


@given(st.binary(max_size=400))
def test_any_bytes_give_a_sample_or_an_error(data):
    try:
        sample = imu_of(b"\x00\x01" + data)
    except ValueError:
        return
    assert sample.q_xyzw.shape == (4,)


STAMPS = st.integers(0, 2**31 * 10**9 - 1)
FLAGS = st.booleans().map(np.bool_)


def same_message(mine: bytes, theirs) -> bool:
    """Whether it is the same message, by its bytes without padding, which may be anything."""
    package, name = type(theirs).__module__.partition(".")[0], type(theirs).__name__
    clean = PaddingCleaner(f"{package}/msg/{name}").clean
    return clean(mine) == clean(serialize_message(theirs))


@given(STAMPS)
def test_clock_is_written_as_rclpy_does(stamp_ns):
    assert clock_message(stamp_ns) == serialize_message(Clock(clock=time_message(stamp_ns)))


@given(STAMPS, doubles(3), st.sampled_from(["map", "base_link", "imu_link"]))
def test_vector_is_written_as_rclpy_does(stamp_ns, vector, frame):
    assert same_message(VectorWire(frame)(stamp_ns, vector), VectorWriter(frame)(stamp_ns, vector))


@given(STAMPS, doubles(4), doubles(3), doubles(3), FLAGS, FLAGS, FLAGS)
def test_imu_is_written_as_rclpy_does(stamp_ns, q_xyzw, rate, force, attitude, turning, pushed):
    sample = ImuSample(q_xyzw, rate, force, attitude, turning, pushed)
    wire = ImuWire()
    for _ in range(2):  # nothing stays of the one before
        assert same_message(wire(stamp_ns, sample), ImuWriter()(stamp_ns, sample))
        wire(7, sample._replace(attitude_valid=~attitude, rate_valid=~turning, force_valid=~pushed))


@given(STAMPS, doubles((3, 3)), st.floats())
def test_reference_is_written_as_rclpy_does(stamp_ns, parts, thrust):
    reference, wire = AttitudeReference(*parts), ReferenceWire()
    assert same_message(wire(stamp_ns, reference, thrust), ReferenceWriter()(stamp_ns, reference, thrust))
    assert same_message(wire(stamp_ns, reference), ReferenceWriter()(stamp_ns, reference))  # nothing stays


AGES = arrays(np.float64, 3, elements=st.one_of(st.just(-1.0), st.floats(0.0, 1.0)))


@given(
    st.integers(2 * 10**9, 2**31 * 10**9 - 1),
    doubles((2, 3)),
    arrays(np.uint8, 3, elements=st.integers(0, 4)),
    AGES,
    AGES,
)
def test_fault_status_is_written_as_rclpy_does(stamp_ns, numbers, state, ages, others):
    wire, writer = FaultStatusWire(), FaultStatusWriter()
    for age in (others, ages):
        estimate = FaultEstimate(numbers[0], numbers[1], state, age, level_sample())
        assert same_message(wire(stamp_ns, estimate), writer(stamp_ns, estimate))


@given(
    STAMPS, doubles(3), st.lists(st.sampled_from(["gyro/x", "attitude/roll"]), max_size=2), st.integers(0, 3)
)
def test_diagnosis_is_written_as_rclpy_does(stamp_ns, numbers, rivals, count):
    size, std_dev, probability = numbers.tolist()
    fault = samples.ComponentFault(
        "gyro", "x", "stuck", 3, size, std_dev, "rad/s", probability, tuple(rivals), stamp_ns
    )
    wanted = Diagnosis(watched=["gyro"] * count)
    set_stamp(wanted.header, stamp_ns)
    wanted.header.frame_id = "imu_link"
    said = {"component": "gyro", "element": "x", "kind": "stuck", "state": 3, "unit": "rad/s"}
    said |= {"size": size, "std_dev": std_dev, "probability": probability}
    onset = wanted.header.stamp
    wanted.faults = [ComponentFault(**said, ambiguous_with=rivals, onset=onset) for _ in range(count)]
    report = samples.DiagnosisReport(stamp_ns, ("gyro",) * count, (fault,) * count)
    assert same_message(DiagnosisWire()(report), wanted)


COUNTS = st.integers(0, 2**32 - 1)


@given(STAMPS, doubles((3, 3)), arrays(np.bool_, 3), st.integers(0, 4), COUNTS, st.floats(0.0, 1.0))
def test_control_status_is_written_as_rclpy_does(stamp_ns, numbers, saturated, mode, restarts, compute_time):
    told = stamp_ns, ControllerOutput(*numbers, saturated), mode, restarts, compute_time
    assert same_message(ControlStatusWire()(*told), ControlStatusWriter()(*told))
