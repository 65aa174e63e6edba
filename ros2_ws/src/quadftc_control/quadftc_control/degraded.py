"""What a controller does when its inputs go missing: which IMU it believes, and when it gives up.

Pure bookkeeping of stamps and times; the node acts on it.
"""

from __future__ import annotations

import dataclasses
import enum

import numpy as np
from numpy.typing import NDArray

from quadftc_model.parameters import check, parameter
from quadftc_model.stepper import seconds


class Mode(enum.IntEnum):
    """How the controller flies; the numbers are those of quadftc_msgs/ControlStatus."""

    FULL = 0
    NO_DIAGNOSIS = 1  # on imu/data: imu/corrected is missing
    NO_DISTURBANCE_ESTIMATE = 2  # the disturbance estimate is missing: it has faded to zero
    HOLD = 3  # no IMU: the last torque is held
    OFF = 4  # no IMU for long: zero torque


@dataclasses.dataclass(frozen=True, kw_only=True)
class Patience:
    """How long each input may be missing."""

    corrected_samples: int = parameter(
        3, low=2, high=1000, doc="which imu/data in a row without imu/corrected is used in its place"
    )
    disturbance_age: float = parameter(0.05, unit="s", low=0.0, doc="age from which the estimate fades")
    disturbance_fade: float = parameter(0.5, unit="s", low=1e-3, doc="time in which it fades to zero")
    hold: float = parameter(0.1, unit="s", low=1e-3, doc="time without IMU until the torque counts as held")
    off: float = parameter(0.5, unit="s", low=1e-3, doc="time without IMU until zero torque is commanded")

    def __post_init__(self) -> None:
        """Check the parameters."""
        check(self)
        if self.off < self.hold:
            raise ValueError(f"off = {self.off:g} s: must not be less than hold = {self.hold:g} s")


class InputMonitor:
    """Keeps count of what came and what did not.

    Parameters
    ----------
    patience : Patience
    """

    def __init__(self, patience: Patience) -> None:
        self.patience = patience
        self._uncorrected = 0
        self._disturbance, self._disturbance_ns = np.zeros(3), 0

    def corrected(self) -> None:
        """Note that imu/corrected came."""
        self._uncorrected = 0

    def use_raw(self) -> bool:
        """Note that imu/data came; whether it has to be used."""
        self._uncorrected += 1
        return self._uncorrected >= self.patience.corrected_samples

    def estimated(self, stamp_ns: int, disturbance: NDArray[np.float64]) -> None:
        """Note a disturbance estimate [rad/s²] (3,) with its stamp [ns]."""
        self._disturbance, self._disturbance_ns = disturbance, stamp_ns

    def disturbance_at(self, stamp_ns: int) -> tuple[NDArray[np.float64], bool]:
        """Return the estimate to use at a stamp [ns], and whether it is fresh; it fades when it gets old."""
        age = seconds(stamp_ns - self._disturbance_ns) - self.patience.disturbance_age
        if age <= 0.0:
            return self._disturbance, True
        return self._disturbance * max(0.0, 1.0 - age / self.patience.disturbance_fade), False

    def silence(self, elapsed: float) -> Mode:
        """Return the mode after ``elapsed`` seconds without any IMU sample."""
        if elapsed >= self.patience.off:
            return Mode.OFF
        return Mode.HOLD if elapsed >= self.patience.hold else Mode.FULL
