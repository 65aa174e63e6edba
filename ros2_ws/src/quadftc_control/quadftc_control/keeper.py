"""What the controller keeps for observers that die: their last words, for those started in their place.

A node that dies takes its state with it, and what it has published for late readers, too. The controller
hears both observers in any case. When one of them falls silent, it publishes, for late readers:

* ``fault/kept``: the last fault/status, and, as long as the controller knows by how much imu/data is off
  without it, that fault in its place, again and again: a fault may change meanwhile;
* ``gyro/kept``: what imu/corrected last added to the body rate of imu/data [rad/s], minus the gyro bias;
* ``disturbance/kept``: the last disturbance/estimate.

The stamps are those of the last samples that were diagnosed, whatever comes later.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_model.rotations import euler_from_quaternion, wrap
from quadftc_model.samples import STARTING, ImuSample
from quadftc_model.stepper import MAX_GAP, seconds

DEPTH = 64  # samples of imu/data of which imu/corrected may still come
PERIOD = 0.05  # s; over which a fault is averaged when it is seen without diagnosis


class Keeper:
    """The last words of both observers.

    Parameters
    ----------
    decode : callable
        Sample of a serialised imu/data.
    states : callable
        State of each axis, of a serialised fault/status.
    message : callable
        Message of a serialised fault/status.
    """

    def __init__(
        self,
        decode: Callable[[bytes], ImuSample],
        states: Callable[[bytes], tuple[int, ...]],
        message: Callable[[bytes], Any],
    ) -> None:
        self._decode, self._states, self._message = decode, states, message
        self._faults: list[NDArray[np.float64]] = []
        self._since_ns = 0
        self._raws: deque[tuple[int, bytes]] = deque(maxlen=DEPTH)
        self._newest: tuple[int, ImuSample] | None = None
        self._status: bytes | None = None

    def raw(self, stamp_ns: int, data: bytes) -> None:
        """Note imu/data [stamp in ns], serialised."""
        self._raws.append((stamp_ns, data))

    def corrected(self, stamp_ns: int, imu: ImuSample) -> None:
        """Note imu/corrected that is in use [stamp in ns]."""
        self._newest = stamp_ns, imu

    def status(self, stamp_ns: int, data: bytes) -> None:
        """Note fault/status [stamp in ns], serialised."""
        self._status = data

    @property
    def starting(self) -> bool:
        """Whether the fault observer says that it has not converged on some axis, or nothing readable."""
        if self._status is None:
            return False
        try:
            return STARTING in self._states(self._status)
        except ValueError:
            return True

    def fault(self, stamp_ns: int, read: ImuSample, flown: ImuSample) -> NDArray[np.float64] | None:
        """Note a sample of imu/data [stamp in ns] and what is flown on in its place.

        Returns
        -------
        array (3,) or None
            Every `PERIOD`: by how much imu/data was off, on average [rad].
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

    def last_words(self, now_ns: int) -> tuple[Any, int, NDArray[np.float64]] | None:
        """Return the last status (message), its stamp [ns] and the correction of the gyro [rad/s] (3,).

        None if there is none that would help at a sample of imu/data [stamp in ns]: nothing has been heard,
        the observer was starting, or there was no imu/data for so long that all laws start anew.
        """
        if self._status is None or self._newest is None or self.starting:
            return None
        stamp_ns, corrected = self._newest
        if seconds(now_ns - stamp_ns) > MAX_GAP:
            return None
        data = next((data for each_ns, data in self._raws if each_ns == stamp_ns), None)
        if data is None:
            return None
        try:
            raw, status = self._decode(data), self._message(self._status)
        except ValueError:
            return None
        known = raw.rate_valid and corrected.rate_valid
        correction = corrected.body_rate - raw.body_rate if known else np.zeros(3)
        return (status, stamp_ns, correction) if np.all(np.isfinite(correction)) else None
