"""The messages that the graph exchanges: serialised bytes to arrays and back.

Readers raise ValueError for bytes that are no such message.
"""

from __future__ import annotations

import struct

import numpy as np
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from sensor_msgs.msg import FluidPressure, Imu, MagneticField
from std_msgs.msg import Header

from quadftc_bags.cdr.message import NANOSECONDS, FieldWriter, read_message, read_numbers
from quadftc_model.samples import (
    ABSENT,
    AttitudeCommand,
    AttitudeReference,
    ControllerOutput,
    FaultEstimate,
    ImuSample,
)
from quadftc_msgs.msg import AttitudeReference as AttitudeReferenceMessage
from quadftc_msgs.msg import ControlStatus, FaultStatus
from quadftc_ros.conversions import Floats
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME, IMU_FRAME

_UNKNOWN = (0.0,) * 9  # a covariance
_ABSENT = (ABSENT, *_UNKNOWN[1:])
_CLOCK = struct.Struct("<4siI")
_YES, _NO = np.bool_(True), np.bool_(False)


def imu_of(data: bytes) -> ImuSample:
    """Sample of a serialised Imu; covariance element 0 marks absent channels."""
    values = read_numbers(data, Imu)
    there = [_NO if values[at] == ABSENT else _YES for at in (4, 16, 28)]
    return ImuSample(np.array(values[:4]), np.array(values[13:16]), np.array(values[25:28]), *there)


def vector_of(data: bytes) -> Floats:
    """Array (3,) of a serialised Vector3Stamped."""
    return np.array(read_numbers(data, Vector3Stamped))


def field_of(data: bytes) -> Floats:
    """Magnetic field (3,) [T] of a serialised MagneticField."""
    return np.array(read_numbers(data, MagneticField)[:3])


def attitude_of(data: bytes) -> Floats:
    """Attitude q_xyzw (4,) of a serialised PoseStamped."""
    return np.array(read_numbers(data, PoseStamped)[3:])


def pose_of(data: bytes) -> tuple[Floats, Floats]:
    """Position (3,) [m] and attitude q_xyzw (4,) of a serialised PoseStamped."""
    values = read_numbers(data, PoseStamped)
    return np.array(values[:3]), np.array(values[3:])


def reference_in(data: bytes) -> AttitudeReference:
    """Reference of a serialised AttitudeReference, without its thrust."""
    return attitude_command_in(data).attitude


def attitude_command_in(data: bytes) -> AttitudeCommand:
    """Reference and thrust of a serialised AttitudeReference; the thrust is -1 where none is commanded."""
    values = read_numbers(data, AttitudeReferenceMessage)
    attitude = AttitudeReference(np.array(values[:3]), np.array(values[3:6]), np.array(values[6:9]))
    return AttitudeCommand(attitude, np.float64(values[9]))


def fault_states_of(data: bytes) -> tuple[int, ...]:
    """State of each axis of a serialised FaultStatus."""
    return read_numbers(data, FaultStatus)[:3]


def fault_status_of(data: bytes) -> FaultStatus:
    """Message of a serialised FaultStatus."""
    return read_message(data, FaultStatus)


def clock_message(stamp_ns: int) -> bytes:
    """Return the serialised Clock of a time [ns]: little-endian CDR of one time."""
    return _CLOCK.pack(b"\0\1\0\0", *divmod(stamp_ns, NANOSECONDS))


class VectorWire:
    """Makes serialised stamped vectors in a frame."""

    def __init__(self, frame: str) -> None:
        self._write = FieldWriter(Vector3Stamped(header=Header(frame_id=frame)))

    def __call__(self, stamp_ns: int, array: Floats) -> bytes:
        """Return the message of an array (3,)."""
        return self._write(stamp_ns, *array.tolist())


class ImuWire:
    """Makes serialised IMU messages.

    Covariances are unknown (0), or mark a channel absent (-1); that of the attitude may be given.
    """

    def __init__(self, frame: str = IMU_FRAME) -> None:
        self._write = FieldWriter(Imu(header=Header(frame_id=frame)))

    def __call__(self, stamp_ns: int, sample: ImuSample, variance: Floats | None = None) -> bytes:
        """Return the message of a sample of one vehicle; ``variance`` (3,) of the attitude [rad²]."""
        attitude = _UNKNOWN if sample.attitude_valid else _ABSENT
        rate = _UNKNOWN if sample.rate_valid else _ABSENT
        force = _UNKNOWN if sample.force_valid else _ABSENT
        if variance is not None:
            x, y, z = variance.tolist()
            attitude = (x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z)
        q_xyzw, body_rate = sample.q_xyzw.tolist(), sample.body_rate.tolist()
        specific_force = sample.specific_force.tolist()
        return self._write(stamp_ns, *q_xyzw, *attitude, *body_rate, *rate, *specific_force, *force)


class FieldWire:
    """Makes serialised magnetic fields; ``std_dev`` [T] of each component, 0: unknown."""

    def __init__(self, frame: str, std_dev: float) -> None:
        v = std_dev**2
        self._covariance = (v, 0.0, 0.0, 0.0, v, 0.0, 0.0, 0.0, v)
        self._write = FieldWriter(MagneticField(header=Header(frame_id=frame)))

    def __call__(self, stamp_ns: int, field: Floats) -> bytes:
        """Return the message of a field (3,) [T] in body axes."""
        return self._write(stamp_ns, *field.tolist(), *self._covariance)


class PressureWire:
    """Makes serialised pressures; ``std_dev`` [Pa], 0: unknown."""

    def __init__(self, frame: str, std_dev: float) -> None:
        self._variance = std_dev**2
        self._write = FieldWriter(FluidPressure(header=Header(frame_id=frame)))

    def __call__(self, stamp_ns: int, pressure: float) -> bytes:
        """Return the message of a pressure [Pa]."""
        return self._write(stamp_ns, pressure, self._variance)


class ReferenceWire:
    """Makes serialised references."""

    def __init__(self) -> None:
        self._write = FieldWriter(AttitudeReferenceMessage(header=Header(frame_id=EARTH_FRAME)))

    def __call__(self, stamp_ns: int, reference: AttitudeReference, thrust: float = -1.0) -> bytes:
        """Return the message of a reference of one vehicle, and of a thrust [N]; -1: none is commanded."""
        angles, rates, accelerations = reference
        return self._write(stamp_ns, *angles.tolist(), *rates.tolist(), *accelerations.tolist(), thrust)


class FaultStatusWire:
    """Makes serialised status messages of the diagnosis."""

    def __init__(self, frame: str = IMU_FRAME) -> None:
        self._write = FieldWriter(FaultStatus(header=Header(frame_id=frame)))

    def __call__(self, stamp_ns: int, estimate: FaultEstimate) -> bytes:
        """Return the message of an estimate of one vehicle."""
        ages = estimate.onset_age.tolist()
        times = [stamp_ns - round(age * NANOSECONDS) if age >= 0.0 else 0 for age in ages]
        onsets = [part for time_ns in times for part in divmod(time_ns, NANOSECONDS)]
        state, fault, std_dev = estimate.state.tolist(), estimate.fault.tolist(), estimate.std_dev.tolist()
        return self._write(stamp_ns, *state, *fault, *std_dev, *onsets)


class ControlStatusWire:
    """Makes serialised status messages of the control."""

    def __init__(self, frame: str = BASE_FRAME) -> None:
        self._write = FieldWriter(ControlStatus(header=Header(frame_id=frame)))

    def __call__(
        self, stamp_ns: int, output: ControllerOutput, mode: int, restarts: int, compute_time: float
    ) -> bytes:
        """Return the message of a control step of one vehicle; ``compute_time`` in seconds."""
        error, sliding, saturated = output.error, output.sliding_variable, output.saturated
        numbers = *error.tolist(), *sliding.tolist(), *saturated.tolist()
        return self._write(stamp_ns, *numbers, mode, restarts, compute_time)
