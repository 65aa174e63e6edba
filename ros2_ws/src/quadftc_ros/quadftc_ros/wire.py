"""Serialised messages straight to arrays and back, for those that the graph exchanges with every sample.

To take a message, rclpy builds an object with all its parts, in Python, and fills it, which takes several
times as long as to unpack its numbers; to give one, it reads them back out of such an object. What comes and
is not plain CDR, as Fast DDS and Cyclone DDS send it, goes through rclpy first. What goes is a message that
rclpy has serialised once, with other numbers.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu

from quadftc_model.samples import (
    ABSENT,
    AttitudeReference,
    ControllerOutput,
    FaultEstimate,
    ImuSample,
    level_sample,
)
from quadftc_msgs.msg import AttitudeReference as AttitudeReferenceMessage
from quadftc_msgs.msg import FaultStatus
from quadftc_ros.conversions import (
    FRAME,
    NANOSECONDS,
    PLAIN,
    STAMP_END,
    ControlStatusWriter,
    FaultStatusWriter,
    Floats,
    ImuWriter,
    ReferenceWriter,
    VectorWriter,
)

ORIGIN = 4  # alignment counts from behind the encapsulation
_UNKNOWN = (0.0,) * 8  # the rest of a covariance


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
            data = serialize_message(_whole(data, self._class))
        little = data[1]
        try:
            (length,) = self._lengths[little].unpack_from(data, STAMP_END)
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


def fault_states_of(data: bytes) -> tuple[int, ...]:
    """State of each axis, of a serialised FaultStatus.

    Raises
    ------
    ValueError
        If it is none.
    """
    if data[:2] not in PLAIN:
        return tuple(_whole(data, FaultStatus).state.tolist())
    try:
        (length,) = struct.unpack_from("<I" if data[1] else ">I", data, STAMP_END)
        return struct.unpack_from("3B", data, FRAME + length)
    except struct.error:
        raise ValueError(f"not a FaultStatus: {len(data)} bytes") from None


def fault_status_of(data: bytes) -> FaultStatus:
    """Message of a serialised FaultStatus.

    Raises
    ------
    ValueError
        If it is none.
    """
    return _whole(data, FaultStatus)


def _whole(data: bytes, message_class: type) -> Any:
    """Message of bytes that may be in any encoding."""
    try:
        return deserialize_message(data, message_class)
    except Exception as error:  # of rclpy, which has no class for it
        raise ValueError(f"not a {message_class.__name__}: {error}") from None


class _Template:
    """A serialised message, to be filled with another stamp and other numbers.

    Parameters
    ----------
    message
        With the frame; its numbers do not matter.
    """

    def __init__(self, message: Any) -> None:
        self.data = bytearray(serialize_message(message))
        self.order = "<" if self.data[1] else ">"
        (length,) = struct.unpack_from(f"{self.order}I", self.data, STAMP_END)
        self.end = FRAME + length  # of the header
        self._stamp = struct.Struct(f"{self.order}iI").pack_into

    def aligned(self, position: int) -> int:
        """Return where a float64 stands that comes behind a position."""
        return ORIGIN + (position - ORIGIN + 7) // 8 * 8

    def stamp(self, stamp_ns: int) -> None:
        """Write the time [ns]."""
        self._stamp(self.data, ORIGIN, *divmod(stamp_ns, NANOSECONDS))


class _NumbersWire:
    """Writes messages that are a header and float64 fields."""

    def __init__(self, message: Any, count: int) -> None:
        self._template = _Template(message)
        self._start = self._template.aligned(self._template.end)
        self._pack = struct.Struct(f"{self._template.order}{count}d").pack_into

    def write(self, stamp_ns: int, numbers: list[float]) -> bytes:
        template = self._template
        template.stamp(stamp_ns)
        self._pack(template.data, self._start, *numbers)
        return bytes(template.data)


class VectorWire:
    """Makes serialised stamped vectors in a frame."""

    def __init__(self, frame: str) -> None:
        self._wire = _NumbersWire(VectorWriter(frame)(0, np.zeros(3)), 3)

    def __call__(self, stamp_ns: int, array: Floats) -> bytes:
        """Return the message of an array (3,)."""
        return self._wire.write(stamp_ns, array.tolist())


class ImuWire:
    """Makes serialised IMU messages, as `quadftc_ros.conversions.ImuWriter` makes messages."""

    def __init__(self) -> None:
        self._wire = _NumbersWire(ImuWriter()(0, level_sample()), 37)

    def __call__(self, stamp_ns: int, sample: ImuSample) -> bytes:
        """Return the message of a sample of one vehicle."""
        numbers = [
            *sample.q_xyzw.tolist(),
            0.0 if sample.attitude_valid else ABSENT,
            *_UNKNOWN,
            *sample.body_rate.tolist(),
            0.0 if sample.rate_valid else ABSENT,
            *_UNKNOWN,
            *sample.specific_force.tolist(),
            0.0 if sample.force_valid else ABSENT,
            *_UNKNOWN,
        ]
        return self._wire.write(stamp_ns, numbers)


class ReferenceWire:
    """Makes serialised references."""

    def __init__(self) -> None:
        zeros = np.zeros(3)
        message = ReferenceWriter()(0, AttitudeReference(zeros, zeros, zeros))
        self._wire = _NumbersWire(message, 9)

    def __call__(self, stamp_ns: int, reference: AttitudeReference) -> bytes:
        """Return the message of a reference of one vehicle."""
        angles, rates, accelerations = reference
        return self._wire.write(stamp_ns, [*angles.tolist(), *rates.tolist(), *accelerations.tolist()])


class FaultStatusWire:
    """Makes serialised status messages of the diagnosis."""

    def __init__(self) -> None:
        zeros = np.zeros(3)
        nothing = FaultEstimate(zeros, zeros, np.zeros(3, np.uint8), zeros - 1.0, level_sample())
        self._template = template = _Template(FaultStatusWriter()(0, nothing))
        self._numbers_at = template.aligned(template.end + 3)
        self._states = struct.Struct("3B").pack_into
        self._numbers = struct.Struct(f"{template.order}6d").pack_into
        self._onsets = struct.Struct(f"{template.order}iIiIiI").pack_into
        self._has_onset = False

    def __call__(self, stamp_ns: int, estimate: FaultEstimate) -> bytes:
        """Return the message of an estimate of one vehicle."""
        template = self._template
        data = template.data
        template.stamp(stamp_ns)
        self._states(data, template.end, *estimate.state.tolist())
        numbers = (*estimate.fault.tolist(), *estimate.std_dev.tolist())
        self._numbers(data, self._numbers_at, *numbers)
        ages = estimate.onset_age.tolist()
        has_onset = max(ages) >= 0.0
        if has_onset or self._has_onset:
            times = [stamp_ns - round(age * NANOSECONDS) if age >= 0.0 else 0 for age in ages]
            parts = [part for time_ns in times for part in divmod(time_ns, NANOSECONDS)]
            self._onsets(data, self._numbers_at + 48, *parts)
        self._has_onset = has_onset
        return bytes(data)


class ControlStatusWire:
    """Makes serialised status messages of the control."""

    def __init__(self) -> None:
        zeros = np.zeros(3)
        nothing = ControllerOutput(zeros, zeros, zeros, np.zeros(3, bool))
        self._template = template = _Template(ControlStatusWriter()(0, nothing, 0, 0.0))
        self._numbers_at = template.aligned(template.end)
        self._flags_at = self._numbers_at + 48
        self._time_at = template.aligned(self._flags_at + 4)
        self._numbers = struct.Struct(f"{template.order}6d").pack_into
        self._flags = struct.Struct("3?B").pack_into
        self._time = struct.Struct(f"{template.order}d").pack_into

    def __call__(self, stamp_ns: int, output: ControllerOutput, mode: int, compute_time: float) -> bytes:
        """Return the message of a control step of one vehicle; ``compute_time`` in seconds."""
        template = self._template
        data = template.data
        template.stamp(stamp_ns)
        numbers = (*output.error.tolist(), *output.sliding_variable.tolist())
        self._numbers(data, self._numbers_at, *numbers)
        self._flags(data, self._flags_at, *output.saturated.tolist(), mode)
        self._time(data, self._time_at, compute_time)
        return bytes(data)
