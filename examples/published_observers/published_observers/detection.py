"""What is made of the size of an estimated fault: states of a diagnosis."""

from __future__ import annotations

from typing import NamedTuple

from quadftc_model import samples
from quadftc_model.arrays import Mask, Vector, namespace
from quadftc_model.samples import FaultEstimate, ImuSample


class Detection(NamedTuple):
    """Detection of a fault from the size of its estimate: a level with hysteresis, and a time to recover."""

    detected: Mask  # the level has been high and not low again for long enough
    low: Mask  # the level is low now
    calm: Vector  # how long it has been low while detected [s]
    age: Vector  # time since it was last low without a fault [s]

    @classmethod
    def start(cls, like: Vector) -> Detection:
        """Start with nothing detected on the axes of an array (..., 3)."""
        zeros = namespace(like).zeros_like(like)
        return cls(zeros > 0.0, zeros == 0.0, zeros, zeros)

    def step(self, level: Vector, high: float, low: float, recovery_time: float, dt: float) -> Detection:
        """Advance by ``dt`` [s] to a level.

        A fault is there from the first level of ``high`` or more, until the level has been below ``low`` for
        ``recovery_time`` [s].
        """
        xp = namespace(level)
        is_low = level < low
        detected = self.detected | (level >= high)
        calm = xp.where(detected & is_low, self.calm + dt, 0.0)
        detected = detected & (calm < recovery_time)
        return Detection(detected, is_low, calm, xp.where(is_low & ~detected, 0.0, self.age + dt))

    def report(self, fault: Vector, std_dev: Vector, suspect: Mask, corrected: ImuSample) -> FaultEstimate:
        """Return the estimate; ``suspect`` tells SUSPECT from HEALTHY."""
        xp = namespace(fault)
        healthy = xp.where(suspect, samples.SUSPECT, samples.HEALTHY)
        faulty = xp.where(self.low, samples.RECOVERING, samples.FAULTY)
        state = xp.where(self.detected, faulty, healthy).astype(xp.uint8)
        return FaultEstimate(fault, std_dev, state, xp.where(self.detected, self.age, -1.0), corrected)
