"""Which inputs of the controller are there: what it flies on, and when it gives up.

* no diagnosis: ``corrected_samples`` imu/data came in a row, but no imu/corrected, or none younger than
  ``corrected_age``; until ``return_samples`` came in time, and the observer says that it has started.
* no disturbance estimate: it is older than ``disturbance_age``; until it was not for ``return_samples``.
* hold: no IMU for the time ``hold``; until the next sample. The torque is the mean of those before.
* off: no IMU for the time ``off``; until ``return_samples`` came, none of them ``hold`` after the last.

Counts samples and compares stamps; `quadftc_control.flight_manager` acts on it.
"""

from __future__ import annotations

import dataclasses
import enum
import math

import numpy as np

from quadftc_model.arrays import Vector
from quadftc_model.parameters import Checked, parameter
from quadftc_model.stepper import seconds

MOST_SAMPLES = 1000  # that any count of samples may be
MEMORY = 0.2  # s; time constant of the torque that is held


class Mode(enum.IntEnum):
    """How the controller flies; the numbers are those of quadftc_msgs/ControlStatus."""

    FULL = 0
    NO_DIAGNOSIS = 1  # on imu/data: imu/corrected is missing
    NO_DISTURBANCE_ESTIMATE = 2  # the disturbance estimate is missing: the switching gain takes over
    HOLD = 3  # no IMU: the torque is held
    OFF = 4  # no IMU for long: zero torque


@dataclasses.dataclass(frozen=True, kw_only=True)
class Patience(Checked):
    """How long each input may be missing, and how gradually the controller goes over to what is left."""

    corrected_samples: int = parameter(
        3, low=2, high=MOST_SAMPLES, doc="which imu/data in a row without imu/corrected is used in its place"
    )
    corrected_age: float = parameter(0.05, unit="s", low=0.0, doc="lag behind imu/data: it is missing")
    return_samples: int = parameter(
        25, low=1, high=MOST_SAMPLES, doc="good samples in a row after which a better mode is returned to"
    )
    starting: float = parameter(3.0, unit="s", low=0.0, doc="how long a returning observer may take to start")
    correction_hold: float = parameter(
        5.0, unit="s", low=0.0, doc="how long the body rate alone carries an attitude that was faulty"
    )
    correction_fade: float = parameter(2.0, unit="s", low=1e-3, doc="time in which that is given up")
    jump: float = parameter(
        math.radians(1.0), unit="rad", low=0.0, doc="step of imu/data that the gyro does not show: a fault"
    )
    blend: float = parameter(0.5, unit="s", low=1e-3, doc="time in which what is back comes into use")
    disturbance_age: float = parameter(0.05, unit="s", low=0.0, doc="age from which the estimate fades")
    disturbance_fade: float = parameter(0.5, unit="s", low=1e-3, doc="time in which it fades to zero")
    hold: float = parameter(0.1, unit="s", low=1e-3, doc="time without IMU until the torque counts as held")
    off: float = parameter(0.5, unit="s", low=1e-3, doc="time without IMU until zero torque is commanded")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.off < self.hold:
            raise ValueError(f"off = {self.off:g} s: must not be less than hold = {self.hold:g} s")


class HeldTorque:
    """Mean torque of the last samples: what a vehicle needs that stays as it is.

    The torque of a single sample is mostly noise, which would turn the vehicle.
    """

    def __init__(self) -> None:
        self.mean = np.zeros(3)  # [N m]
        self._stamp_ns = 0

    def add(self, stamp_ns: int, torque: Vector) -> None:
        """Note the torque (3,) [N m] of a sample [ns]; what is older than a gap does not count."""
        elapsed = seconds(stamp_ns - self._stamp_ns)
        self._stamp_ns = stamp_ns
        share = -math.expm1(-elapsed / MEMORY) if 0.0 < elapsed <= MEMORY else 1.0
        self.mean = self.mean + share * (torque - self.mean)


class InputMonitor:
    """Keeps count of what came and what did not."""

    def __init__(self, patience: Patience) -> None:
        self.patience = patience
        self.undiagnosed = False  # flies on imu/data
        self._raw_ns = 0  # stamp of the newest imu/data
        self._uncorrected, self._good, self._good_since_ns = 0, 0, 0
        # the last disturbance estimate: stamp [ns], and value [rad/s²]
        self.estimate: tuple[int, Vector] = (0, np.zeros(3))
        self._estimated_ns: int | None = None  # stamp of the last call of `disturbance_at`
        self._share, self._unestimated, self._fresh = 0.0, True, 0
        self._back, self._back_ns = 0, 0

    def use_raw(self, stamp_ns: int) -> bool:
        """Note that imu/data of a stamp [ns] came; whether it has to be used."""
        self._raw_ns = stamp_ns
        self._uncorrected += 1
        if self._uncorrected >= self.patience.corrected_samples:
            self.undiagnosed, self._good = True, 0
        return self.undiagnosed

    def is_late(self, stamp_ns: int) -> bool:
        """Whether imu/corrected of a stamp [ns] comes too late to count."""
        return seconds(self._raw_ns - stamp_ns) > self.patience.corrected_age

    def use_corrected(self, stamp_ns: int, starting: bool) -> bool:
        """Note that imu/corrected of a stamp [ns] came; whether it is to be used.

        ``starting`` says that its observer has not converged: then it is not returned to yet.
        """
        if self.is_late(stamp_ns):
            return False
        self._uncorrected = 0
        if not self.undiagnosed:
            return True
        if self._good == 0:
            self._good_since_ns = stamp_ns
        self._good += 1
        waited = seconds(stamp_ns - self._good_since_ns) > self.patience.starting
        if self._good >= self.patience.return_samples and (waited or not starting):
            self.undiagnosed = False
        return not self.undiagnosed

    def disturbance_at(self, stamp_ns: int) -> tuple[Vector, float, bool]:
        """Return the estimate to use for the sample of a stamp [ns], its share, and whether it is trusted.

        The share is 1 in flight and 0 without estimate; it fades when the estimate gets old, and comes back
        when it is fresh again. At the first sample it is used at once.
        """
        patience, (estimated_ns, disturbance) = self.patience, self.estimate
        fresh = seconds(stamp_ns - estimated_ns) <= patience.disturbance_age
        first, since_ns = self._estimated_ns is None, stamp_ns - (self._estimated_ns or stamp_ns)
        self._estimated_ns = stamp_ns
        self._fresh = self._fresh + 1 if fresh else 0
        if first:
            self._share = float(fresh)
        if first or not fresh or self._fresh >= patience.return_samples:
            self._unestimated = not fresh
        dt = max(0.0, seconds(since_ns))
        change = -dt / patience.disturbance_fade if self._unestimated else dt / patience.blend
        self._share = min(1.0, max(0.0, self._share + change))
        if self._share == 1.0:  # bit for bit
            return disturbance, 1.0, not self._unestimated
        return self._share * disturbance, self._share, not self._unestimated

    def silence(self, elapsed: float) -> Mode:
        """Return the mode after ``elapsed`` seconds without any IMU sample."""
        if elapsed >= self.patience.off:
            self._back = 0
            return Mode.OFF
        return Mode.HOLD if elapsed >= self.patience.hold else Mode.FULL

    def is_back(self, stamp_ns: int) -> bool:
        """In the mode off: note a sample [ns]; whether enough have come in a row to fly again."""
        if self._back and seconds(stamp_ns - self._back_ns) >= self.patience.hold:
            self._back = 0
        self._back, self._back_ns = self._back + 1, stamp_ns
        return self._back >= self.patience.return_samples
