"""Between messages and arrays, without loss: float64 stays float64, stamps stay whole nanoseconds."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3, Vector3Stamped
from numpy.typing import NDArray
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from quadftc_model.samples import (
    ABSENT,
    ALARMS,
    FAULTY,
    AttitudeReference,
    ControllerOutput,
    FaultEstimate,
    ImuSample,
)
from quadftc_msgs.msg import AttitudeReference as AttitudeReferenceMessage
from quadftc_msgs.msg import ControlStatus, FaultStatus
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME, IMU_FRAME

NANOSECONDS = 1_000_000_000  # per second
END_NS = 2**31 * NANOSECONDS  # ns; where the stamps end that a message can have
ABSURD = 1e6  # in rad, rad/s, rad/s², N m and m/s² alike: no number that can be meant is so large
PLAIN = (b"\x00\x00", b"\x00\x01")  # encapsulation of plain CDR, big and little endian
STAMP_END = 12  # bytes; of a serialised message, behind encapsulation and stamp: the length of frame_id
FRAME = 16  # where frame_id begins

Floats = NDArray[np.float64]


def stamp_of(message: Any) -> int:
    """Stamp [ns] of a message with a header, or of a header itself."""
    stamp = getattr(message, "header", message).stamp
    return stamp.sec * NANOSECONDS + stamp.nanosec


def leading_stamp_ns(cdr_bytes: bytes) -> int:
    """Return the stamp [ns] that a serialised message begins with.

    Raises
    ------
    ValueError
        If it is too short to have one.
    """
    if len(cdr_bytes) < STAMP_END:
        raise ValueError(f"no stamp in {len(cdr_bytes)} bytes")
    sec, nanosec = struct.unpack_from("<iI" if cdr_bytes[1] else ">iI", cdr_bytes, 4)
    return sec * NANOSECONDS + nanosec


def leading_frame(cdr_bytes: bytes) -> str:
    """Return the frame of the header that a serialised message, in plain CDR, begins with.

    Raises
    ------
    ValueError
        If it has none.
    """
    try:
        (length,) = struct.unpack_from("<I" if cdr_bytes[1] else ">I", cdr_bytes, STAMP_END)
    except (struct.error, IndexError):
        raise ValueError(f"no frame in {len(cdr_bytes)} bytes") from None
    return cdr_bytes[FRAME:][: max(0, length - 1)].decode(errors="replace")


def time_message(stamp_ns: int) -> Time:
    """Message of a time [ns]."""
    sec, nanosec = divmod(stamp_ns, NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def set_stamp(header: Header, stamp_ns: int) -> None:
    """Write a time [ns] into a header."""
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, NANOSECONDS)


def array_of(vector: Vector3) -> Floats:
    """Array (3,) of a vector message."""
    return np.array((vector.x, vector.y, vector.z))


def is_finite(array: Floats) -> bool:
    """Whether every number of a small array is finite, and none so large that it overflows somewhere."""
    return all(-ABSURD < x < ABSURD for x in array.tolist())  # false for NaN, too


def fill_vector(vector: Vector3, array: Floats) -> None:
    """Write an array (3,) into a vector message."""
    vector.x, vector.y, vector.z = array.tolist()


class VectorWriter:
    """Makes stamped vectors in a frame; each call returns the same message object, filled anew.

    Publishing copies it.
    """

    def __init__(self, frame: str) -> None:
        self._message = Vector3Stamped()
        self._message.header.frame_id = frame

    def __call__(self, stamp_ns: int, array: Floats) -> Vector3Stamped:
        """Return the message of an array (3,)."""
        set_stamp(self._message.header, stamp_ns)
        fill_vector(self._message.vector, array)
        return self._message


def imu_sample(message: Imu) -> ImuSample:
    """Sample of an IMU message; absent channels are marked by covariance element 0 as REP-145 says."""
    q, rate, force = message.orientation, message.angular_velocity, message.linear_acceleration
    return ImuSample(
        q_xyzw=np.array((q.x, q.y, q.z, q.w)),
        body_rate=np.array((rate.x, rate.y, rate.z)),
        specific_force=np.array((force.x, force.y, force.z)),
        attitude_valid=np.bool_(message.orientation_covariance[0] != ABSENT),
        rate_valid=np.bool_(message.angular_velocity_covariance[0] != ABSENT),
        force_valid=np.bool_(message.linear_acceleration_covariance[0] != ABSENT),
    )


class ImuWriter:
    """Makes IMU messages; each call returns the same message object, filled anew (publishing copies it).

    Covariances are unknown (0), or mark a channel absent (-1).
    """

    def __init__(self) -> None:
        self._message = Imu()
        self._message.header.frame_id = IMU_FRAME

    def __call__(self, stamp_ns: int, sample: ImuSample) -> Imu:
        """Return the message of a sample of one vehicle."""
        message = self._message
        set_stamp(message.header, stamp_ns)
        q = message.orientation
        q.x, q.y, q.z, q.w = sample.q_xyzw.tolist()
        fill_vector(message.angular_velocity, sample.body_rate)
        fill_vector(message.linear_acceleration, sample.specific_force)
        message.orientation_covariance[0] = 0.0 if sample.attitude_valid else ABSENT
        message.angular_velocity_covariance[0] = 0.0 if sample.rate_valid else ABSENT
        message.linear_acceleration_covariance[0] = 0.0 if sample.force_valid else ABSENT
        return message


class ReferenceWriter:
    """Makes reference messages; each call returns the same message object, filled anew.

    Publishing copies it.
    """

    def __init__(self) -> None:
        self._message = AttitudeReferenceMessage()
        self._message.header.frame_id = EARTH_FRAME

    def __call__(self, stamp_ns: int, reference: AttitudeReference) -> AttitudeReferenceMessage:
        """Return the message of a reference of one vehicle."""
        message = self._message
        set_stamp(message.header, stamp_ns)
        fill_vector(message.angles, reference.angles)
        fill_vector(message.rates, reference.rates)
        fill_vector(message.accelerations, reference.accelerations)
        return message


def reference_of(message: AttitudeReferenceMessage) -> AttitudeReference:
    """Reference of a message."""
    return AttitudeReference(
        array_of(message.angles), array_of(message.rates), array_of(message.accelerations)
    )


class FaultStatusWriter:
    """Makes status messages of the diagnosis; each call returns the same message object, filled anew.

    Publishing copies it.
    """

    def __init__(self) -> None:
        self._message = FaultStatus()
        self._message.header.frame_id = IMU_FRAME
        self._has_onset = False

    def __call__(self, stamp_ns: int, estimate: FaultEstimate) -> FaultStatus:
        """Return the message of an estimate of one vehicle."""
        message = self._message
        set_stamp(message.header, stamp_ns)
        message.state = estimate.state
        fill_vector(message.estimate, estimate.fault)
        fill_vector(message.std_dev, estimate.std_dev)
        ages = estimate.onset_age.tolist()
        has_onset = max(ages) >= 0.0
        if has_onset or self._has_onset:
            message.onset = [
                time_message(stamp_ns - round(age * NANOSECONDS) if age >= 0.0 else 0) for age in ages
            ]
        self._has_onset = has_onset
        return message


def revise_status(message: FaultStatus, stamp_ns: int, fault: Floats, certain: float) -> None:
    """Put another fault (3,) [rad] into a status whose observer is gone; the header stays as it is.

    An axis that is off by more than ``certain`` [rad] counts as faulty, if it did not, since ``stamp_ns``.
    """
    fill_vector(message.estimate, fault)
    for axis in np.flatnonzero((np.abs(fault) > certain) & ~np.isin(message.state, ALARMS)).tolist():
        states: Any = message.state
        onsets: Any = message.onset
        states[axis], onsets[axis] = FAULTY, time_message(stamp_ns)


class ControlStatusWriter:
    """Makes status messages of the control; each call returns the same message object, filled anew.

    Publishing copies it.
    """

    def __init__(self) -> None:
        self._message = ControlStatus()
        self._message.header.frame_id = BASE_FRAME

    def __call__(
        self, stamp_ns: int, output: ControllerOutput, mode: int, compute_time: float
    ) -> ControlStatus:
        """Return the message of a control step of one vehicle; ``compute_time`` in seconds."""
        message = self._message
        set_stamp(message.header, stamp_ns)
        fill_vector(message.error, output.error)
        fill_vector(message.sliding_variable, output.sliding_variable)
        message.saturated = output.saturated.tolist()
        message.mode = int(mode)
        message.compute_time = compute_time
        return message
