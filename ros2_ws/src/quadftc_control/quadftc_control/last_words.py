"""The last words of both observers, kept for observers that restart.

When an observer falls silent, the controller publishes for one that is started in its place:

* ``fault/kept``: the last fault/status. While the controller knows how wrong imu/data is, it replaces the
  fault 20 times a second, because faults change;
* ``gyro/kept``: minus the last gyro/bias [rad/s]. Of an observer that does not tell it: what imu/corrected
  last added to the body rate of imu/data;
* ``disturbance/kept``: the last disturbance/estimate.

The stamps are those of the last samples that were diagnosed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Vector
from quadftc_model.rotations import euler_from_quaternion, wrap
from quadftc_model.samples import STARTING, ImuSample
from quadftc_model.stepper import MAX_GAP, seconds

DEPTH = 64  # samples of imu/data of which imu/corrected may still come
PERIOD = 0.05  # s; over which a fault is averaged when it is seen without diagnosis
BIAS_AGE = 0.5  # s; an older gyro bias is not used


class MessageReader(NamedTuple):
    """Functions that read serialised messages, which are mostly kept unread; ValueError for what is none."""

    imu: Callable[[bytes], ImuSample]  # the sample of imu/data
    states: Callable[[bytes], tuple[int, ...]]  # the state of each axis of fault/status
    status: Callable[[bytes], object]  # the message of fault/status
    faulty_part: Callable[[Any], Vector]  # estimate (3,) [rad] of that message, zero on axes without an alarm
    # (message, stamp_ns, fault, certain): put another fault (3,) [rad] in; beyond certain an axis is faulty
    revise: Callable[[Any, int, Vector, float], None]


class LastWords:
    """What both observers said last: the controller puts in what it hears."""

    def __init__(self, reader: MessageReader) -> None:
        self._reader = reader
        self._faults: list[Vector] = []
        self._since_ns = 0
        self.raws: deque[tuple[int, bytes]] = deque(maxlen=DEPTH)  # imu/data: stamp [ns], serialised
        self.corrected: tuple[int, ImuSample] | None = None  # the newest imu/corrected in use, with its stamp
        self.status: bytes | None = None  # the newest fault/status, serialised
        self.bias: tuple[int, Vector] | None = None  # the newest gyro/bias: stamp [ns], (3,) [rad/s]

    @property
    def starting(self) -> bool:
        """Whether the fault observer says that an axis has not converged, or nothing readable."""
        if self.status is None:
            return False
        try:
            return STARTING in self._reader.states(self.status)
        except ValueError:
            return True

    def average_fault(self, stamp_ns: int, read: ImuSample, flown: ImuSample) -> Vector | None:
        """Return, every `PERIOD`, by how much imu/data was off, on average (3,) [rad].

        Its samples come [stamp in ns] with what is flown on in their place.
        """
        angles = euler_from_quaternion(read.q_xyzw) - euler_from_quaternion(flown.q_xyzw)
        elapsed = seconds(stamp_ns - self._since_ns)
        if elapsed > 2.0 * PERIOD:
            self._faults.clear()
        if not self._faults:
            self._since_ns, elapsed = stamp_ns, 0.0
        self._faults.append(wrap(angles))
        if elapsed < PERIOD:
            return None
        mean = np.mean(self._faults, axis=0)
        self._faults.clear()
        return mean

    def gyro_correction(self, stamp_ns: int, seen: Vector) -> Vector:
        """Return what to add to the gyro [rad/s] (3,) of a sample [ns]: by its bias, else as ``seen``."""
        if self.bias is None or not abs(seconds(stamp_ns - self.bias[0])) < BIAS_AGE:
            return seen
        return -self.bias[1]

    def recall(self, now_ns: int) -> tuple[object, int, Vector] | None:
        """Return the last status (message), its stamp [ns] and the correction of the gyro [rad/s] (3,).

        None if nothing helps at a sample of imu/data [stamp in ns]. Then nothing was heard, the observer was
        starting, or imu/data was missing so long that all laws restart.
        """
        if self.status is None or self.corrected is None or self.starting:
            return None
        stamp_ns, corrected = self.corrected
        if seconds(now_ns - stamp_ns) > MAX_GAP:
            return None
        try:
            data = next(data for each_ns, data in self.raws if each_ns == stamp_ns)
            raw, status = self._reader.imu(data), self._reader.status(self.status)
        except (StopIteration, ValueError):  # not heard, or not readable
            return None
        known = raw.rate_valid and corrected.rate_valid
        correction = corrected.body_rate - raw.body_rate if known else np.zeros(3)
        return (status, stamp_ns, correction) if np.all(np.isfinite(correction)) else None
