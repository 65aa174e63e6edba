"""Messages made and read by rclpy's objects, field by field: what `quadftc_ros.wire` is compared with.

A writer returns the same message object with every call; publishing copies it.
"""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from quadftc_model.samples import ABSENT, AttitudeReference, ControllerOutput, FaultEstimate, ImuSample
from quadftc_msgs.msg import AttitudeReference as AttitudeReferenceMessage
from quadftc_msgs.msg import ControlStatus, FaultStatus
from quadftc_ros.conversions import NANOSECONDS, Floats, array_of, fill_vector, time_message
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME, IMU_FRAME


def set_stamp(header: Header, stamp_ns: int) -> None:
    """Write a time [ns] into a header."""
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, NANOSECONDS)


class VectorWriter:
    """Makes stamped vectors in a frame; each call returns the same message object, filled again.

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
    """Makes IMU messages; each call returns the same message object, filled again (publishing copies it).

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
    """Makes reference messages; each call returns the same message object, filled again.

    Publishing copies it.
    """

    def __init__(self) -> None:
        self._message = AttitudeReferenceMessage()
        self._message.header.frame_id = EARTH_FRAME

    def __call__(
        self, stamp_ns: int, reference: AttitudeReference, thrust: float = -1.0
    ) -> AttitudeReferenceMessage:
        """Return the message of a reference of one vehicle."""
        message = self._message
        set_stamp(message.header, stamp_ns)
        fill_vector(message.angles, reference.angles)
        fill_vector(message.rates, reference.rates)
        fill_vector(message.accelerations, reference.accelerations)
        message.thrust = thrust
        return message


def reference_of(message: AttitudeReferenceMessage) -> AttitudeReference:
    """Reference of a message."""
    return AttitudeReference(
        array_of(message.angles), array_of(message.rates), array_of(message.accelerations)
    )


class FaultStatusWriter:
    """Makes status messages of the diagnosis; each call returns the same message object, filled again.

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


class ControlStatusWriter:
    """Makes status messages of the control; each call returns the same message object, filled again.

    Publishing copies it.
    """

    def __init__(self) -> None:
        self._message = ControlStatus()
        self._message.header.frame_id = BASE_FRAME

    def __call__(
        self, stamp_ns: int, output: ControllerOutput, mode: int, restarts: int, compute_time: float
    ) -> ControlStatus:
        """Return the message of a control step of one vehicle; ``compute_time`` in seconds."""
        message = self._message
        set_stamp(message.header, stamp_ns)
        fill_vector(message.error, output.error)
        fill_vector(message.sliding_variable, output.sliding_variable)
        message.saturated = output.saturated.tolist()
        message.mode = int(mode)
        message.restarts = restarts
        message.compute_time = compute_time
        return message
