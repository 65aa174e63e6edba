"""The messages that only free flight has: motion, position samples, rotor speeds; as `quadftc_ros.wire`.

Readers raise ValueError for bytes that are no such message.
"""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from quadftc_bags.cdr.message import FieldReader, FieldWriter, read_message
from quadftc_model.samples import ABSENT, PositionSample
from quadftc_ros.conversions import Floats
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME

_POSITION, _ATTITUDE = "pose.pose.position", "pose.pose.orientation_xyzw"  # fields of Odometry
_VELOCITY, _BODY_RATE = "twist.twist.linear", "twist.twist.angular"


def rotor_names(count: int) -> list[str]:
    """Return the names of rotors in messages, in the order of the vehicle file: rotor_1 ..."""
    return [f"rotor_{number}" for number in range(1, count + 1)]


class PoseWire:
    """Makes serialised poses in the earth frame."""

    def __init__(self) -> None:
        self._write = FieldWriter(PoseStamped(header=Header(frame_id=EARTH_FRAME)))

    def __call__(self, stamp_ns: int, position: Floats, q_xyzw: Floats) -> bytes:
        """Return the message of a position (3,) [m] and an attitude (4,)."""
        return self._write(stamp_ns, *position.tolist(), *q_xyzw.tolist())


class OdometryWire:
    """Makes serialised odometry: pose in the earth frame, velocity and body rate in the body frame.

    An Odometry states its twist in the child frame: a velocity in earth axes, as the plant has it, is rotated
    by the attitude before. Covariances are unknown (0).
    """

    def __init__(self, frame: str = BASE_FRAME) -> None:
        message = Odometry(header=Header(frame_id=EARTH_FRAME), child_frame_id=frame)
        self._write = FieldWriter(message, _POSITION, _ATTITUDE, _VELOCITY, _BODY_RATE)

    def __call__(
        self, stamp_ns: int, position: Floats, q_xyzw: Floats, velocity: Floats, body_rate: Floats
    ) -> bytes:
        """Return the message of one vehicle; ``velocity`` (3,) [m/s] and ``body_rate`` in body axes."""
        pose = *position.tolist(), *q_xyzw.tolist()
        return self._write(stamp_ns, *pose, *velocity.tolist(), *body_rate.tolist())


class PositionSampleWire:
    """Makes serialised samples of a position sensor: odometry with the velocity along the earth's axes.

    The child frame is the earth frame, as the sensor does not know the attitude. What the sensor lacks has
    covariance -1 in its first element: attitude and body rate, and the velocity without ``has_velocity``.
    """

    def __init__(self, noise: float = 0.0, velocity_noise: float = 0.0, has_velocity: bool = True) -> None:
        """Take standard deviations [m], [m/s]; 0: unknown."""
        message = Odometry(header=Header(frame_id=EARTH_FRAME), child_frame_id=EARTH_FRAME)
        pose, twist = message.pose.covariance, message.twist.covariance
        pose[[0, 7, 14]], pose[21] = noise**2, ABSENT
        twist[[0, 7, 14]], twist[21] = velocity_noise**2 if has_velocity else ABSENT, ABSENT
        self._write = FieldWriter(message, _POSITION, _VELOCITY)

    def __call__(self, stamp_ns: int, sample: PositionSample) -> bytes:
        """Return the message of a sample of one vehicle that is there."""
        return self._write(stamp_ns, *sample.position.tolist(), *sample.velocity.tolist())


class PositionSampleReader:
    """Reads samples of a position sensor: any odometry in the earth frame.

    Its velocity counts only if the child frame is the earth frame. In another frame it would have to be
    rotated by an attitude that may be faulty.
    """

    def __init__(self) -> None:
        self._read = FieldReader(Odometry, _POSITION, _VELOCITY, "twist.covariance")
        self._head = b""
        self._in_earth = False

    def __call__(self, data: bytes) -> PositionSample:
        """Return the sample of a message; the velocity is zero where there is none."""
        head, values = self._read(data)
        if head != self._head:
            frame = read_message(data, Odometry).child_frame_id
            self._head, self._in_earth = head, frame.rpartition("/")[2] == EARTH_FRAME
        has_velocity = self._in_earth and values[6] != ABSENT
        velocity = np.array(values[3:6]) if has_velocity else np.zeros(3)
        return PositionSample(np.array(values[:3]), velocity, np.bool_(True))


class RotorsWire:
    """Makes serialised speeds of rotors: joints rotor_1 ... with their velocity."""

    def __init__(self, count: int, frame: str = BASE_FRAME) -> None:
        names = rotor_names(count)
        message = JointState(header=Header(frame_id=frame), name=names, velocity=[0.0] * count)
        self._write = FieldWriter(message, "velocity")

    def __call__(self, stamp_ns: int, speeds: Floats) -> bytes:
        """Return the message of speeds (count,) [rad/s]."""
        return self._write(stamp_ns, *speeds.tolist())


class RotorsReader:
    """Reads speeds of rotors by their names, in whatever order and among whatever joints they come."""

    def __init__(self, count: int) -> None:
        self._names = rotor_names(count)
        self._read = FieldReader(JointState, "velocity")
        self._head = b""
        self._order: list[int] = []

    def __call__(self, data: bytes) -> Floats:
        """Return the speeds (count,) [rad/s] of a message; ValueError if a rotor has none."""
        head, values = self._read(data)
        if head != self._head:
            self._head, self._order = b"", self._find_order(data)
            self._head = head
        return np.array([values[place] for place in self._order])

    def _find_order(self, data: bytes) -> list[int]:
        message = read_message(data, JointState)
        known = dict(zip(message.name, range(len(message.velocity)), strict=False))
        if missing := [name for name in self._names if name not in known]:
            raise ValueError(f"no velocity of {', '.join(missing)}")
        return [known[name] for name in self._names]
