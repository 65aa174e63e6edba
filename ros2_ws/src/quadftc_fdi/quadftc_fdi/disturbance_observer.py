"""The interface of disturbance observers, their registry, and how one runs on a stream of samples."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from quadftc_model.arrays import Vector
from quadftc_model.assembly import VehicleLaw, law_from
from quadftc_model.fade import Fade
from quadftc_model.registry import Registry
from quadftc_model.samples import DisturbanceObserverInputs, ImuSample, is_usable, sanitised
from quadftc_model.stepper import ResumingStepper


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class DisturbanceObserver(VehicleLaw[DisturbanceObserverInputs, Vector]):
    """Base of all disturbance observers: from body rates and torques to d of (36) [rad/s²]."""

    def resumed(self, inputs: DisturbanceObserverInputs, estimate: Vector) -> Any:
        """Return the state that resumes from the last estimate [rad/s²] of another; by default a new one."""
        return self.init(inputs)


class DisturbanceEstimation(ResumingStepper[DisturbanceObserverInputs, Vector, Vector]):
    """A disturbance observer on a stream. An estimate that cannot be used becomes zero and restarts it."""

    law: DisturbanceObserver

    def __init__(self, law: DisturbanceObserver) -> None:
        super().__init__(law, lambda _, estimate: estimate if is_usable(estimate) else np.zeros(3))
        self._next: DisturbanceObserver | None = None  # takes over with the next body rate
        self._fade = Fade()  # of the estimate [rad/s²], (3,)

    def switch(self, law: DisturbanceObserver) -> None:
        """Go on with changed parameters, or have another law take over from the estimate, without a jump."""
        if type(law) is type(self.law):
            self.law, self._next = law, None
        else:
            self._next = law

    def offer(self, stamp_ns: int, words: Vector) -> None:
        """Offer the last estimate [rad/s², stamp in ns] of an observer that has died, to resume from."""
        if is_usable(words):
            super().offer(stamp_ns, words)

    def estimate(self, stamp_ns: int, corrected: ImuSample, torque: Vector) -> Vector | None:
        """Return the estimate [rad/s²] at a corrected sample; None if its stamp is repeated or went back.

        ``torque`` [N m] is the one that acted since the sample before.
        """
        clean = sanitised(corrected)
        inputs = DisturbanceObserverInputs(clean.body_rate, clean.rate_valid, torque)
        last = self.words_for(stamp_ns)
        if last is not None and inputs.rate_valid and self.time_step(stamp_ns) is not None:
            return self.take_over(stamp_ns, inputs, self.law.resumed(inputs, last))
        estimate, left = self.step(stamp_ns, inputs), self._fade.at(stamp_ns)
        if estimate is None:
            return None
        estimate = estimate if left is None else estimate + left
        if self._next is not None and inputs.rate_valid:
            self.law, self._next = self._next, None
            new = self.resume(stamp_ns, inputs, self.law.resumed(inputs, estimate))
            self._fade.begin(stamp_ns, estimate - new)
        return estimate


disturbance_observers: Registry[Any] = Registry(
    "disturbance observer", "quadftc_fdi.disturbance_observers", "quadftc.disturbance_observers"
)
register = disturbance_observers.register
disturbance_observer_from = law_from(disturbance_observers, "observer")  # from the parameters of its node
