"""Serialised messages to arrays: the same numbers as through rclpy, and errors for what is no message."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from geometry_msgs.msg import Vector3Stamped
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from quadftc_msgs.msg import AttitudeReference as AttitudeReferenceMessage
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu

from quadftc_ros.conversions import array_of, imu_sample, reference_of
from quadftc_ros.wire import imu_of, reference_in, vector_of

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


@given(FRAMES, doubles(9))
def test_reference_is_what_rclpy_makes_of_it(frame, numbers):
    message = AttitudeReferenceMessage()
    message.header.frame_id = frame
    for part, three in zip(
        (message.angles, message.rates, message.accelerations), numbers.reshape(3, 3), strict=True
    ):
        part.x, part.y, part.z = three.tolist()
    for mine, theirs in zip(reference_in(serialize_message(message)), reference_of(message), strict=True):
        np.testing.assert_array_equal(mine, theirs)


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
