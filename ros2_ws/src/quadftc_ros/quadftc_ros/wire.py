"""Serialised messages straight to arrays, for those that are a header and float64 fields.

To take a message, rclpy builds an object with all its parts, in Python, and fills it; for an IMU sample that
takes ten times as long as to unpack its numbers (`quadftc bench latency`). What is not plain CDR, as Fast DDS
and Cyclone DDS send it, goes through rclpy first.
"""

from __future__ import annotations

import struct

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from quadftc_msgs.msg import AttitudeReference as AttitudeReferenceMessage
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu

from quadftc_model.samples import AttitudeReference, ImuSample
from quadftc_ros.conversions import ABSENT, Floats

FRAME_LENGTH = 12  # where the length of frame_id stands, behind encapsulation and stamp
FRAME = 16  # where frame_id begins
ORIGIN = 4  # alignment counts from behind the encapsulation
PLAIN = (b"\x00\x00", b"\x00\x01")  # CDR, big and little endian


class Numbers:
    """Read the float64 fields of a message type that has a header and nothing else.

    Parameters
    ----------
    message_class : type
    count : int
        How many float64 fields it has.
    """

    def __init__(self, message_class: type, count: int) -> None:
        self._class = message_class
        self._size = 8 * count
        self._layouts = struct.Struct(f">{count}d"), struct.Struct(f"<{count}d")
        self._lengths = struct.Struct(">I"), struct.Struct("<I")

    def __call__(self, data: bytes) -> tuple[float, ...]:
        """Return the fields, in the order of the type's definition.

        Raises
        ------
        ValueError
            If it is no message of the type.
        """
        if data[:2] not in PLAIN:
            try:
                data = serialize_message(deserialize_message(data, self._class))
            except Exception as error:  # of rclpy, which has no class for it
                raise ValueError(f"not a {self._class.__name__}: {error}") from None
        little = data[1]
        try:
            (length,) = self._lengths[little].unpack_from(data, FRAME_LENGTH)
            start = ORIGIN + (FRAME + length - ORIGIN + 7) // 8 * 8
            return self._layouts[little].unpack_from(data, start)
        except struct.error:
            raise ValueError(f"not a {self._class.__name__}: {len(data)} bytes") from None


_imu = Numbers(Imu, 37)
_vector = Numbers(Vector3Stamped, 3)
_reference = Numbers(AttitudeReferenceMessage, 9)


def imu_of(data: bytes) -> ImuSample:
    """Sample of a serialised Imu, as `quadftc_ros.conversions.imu_sample` has it of the message.

    Raises
    ------
    ValueError
        If it is none.
    """
    values = _imu(data)
    there = [np.bool_(values[at] != ABSENT) for at in (4, 16, 28)]
    return ImuSample(np.array(values[:4]), np.array(values[13:16]), np.array(values[25:28]), *there)


def vector_of(data: bytes) -> Floats:
    """Array (3,) of a serialised Vector3Stamped.

    Raises
    ------
    ValueError
        If it is none.
    """
    return np.array(_vector(data))


def reference_in(data: bytes) -> AttitudeReference:
    """Reference of a serialised AttitudeReference.

    Raises
    ------
    ValueError
        If it is none.
    """
    values = _reference(data)
    return AttitudeReference(np.array(values[:3]), np.array(values[3:6]), np.array(values[6:]))
