"""The interface of disturbance observers, their registry, and how one runs on a stream of samples."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple, cast

import numpy as np

from quadftc_model.arrays import Flag, Vector, namespace
from quadftc_model.assembly import VehicleLaw, law_from
from quadftc_model.fade import Fade
from quadftc_model.guarded import ResumingStepper
from quadftc_model.numbers import structure_of
from quadftc_model.registry import Registry
from quadftc_model.samples import (
    DisturbanceObserverInputs,
    ImuSample,
    has_rate,
    is_usable,
    level_sample,
    sanitised,
    usable,
)
from quadftc_model.stepper import Engine, NumpyRunner


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class DisturbanceObserver(VehicleLaw[DisturbanceObserverInputs, Vector]):
    """Base of all disturbance observers: from body rates and torques to d of (36) [rad/s²]."""

    def resumed(self, inputs: DisturbanceObserverInputs, estimate: Vector) -> Any:
        """Return the state that resumes from the last estimate [rad/s²] of another; by default a new one."""
        return self.init(inputs)


class DisturbanceObservationInputs(NamedTuple):
    """A corrected sample as it is received, and the torque that acted since the sample before."""

    corrected: ImuSample
    torque: Vector  # [N m]

    @property
    def seen(self) -> DisturbanceObserverInputs:
        """What the observer sees; a body rate that cannot be used is absent."""
        clean = sanitised(self.corrected)
        return DisturbanceObserverInputs(clean.body_rate, clean.rate_valid, self.torque)


@dataclasses.dataclass(frozen=True, eq=False)
class DisturbanceObservation:
    """A disturbance observer on received samples; nodes and the closed loop without ROS run this law."""

    observer: DisturbanceObserver

    @property
    def named_after(self) -> DisturbanceObserver:
        """What it is called after where it is compiled."""
        return self.observer

    def init(self, inputs: DisturbanceObservationInputs) -> Any:
        """Return the state of the observer at the first sample."""
        return self.observer.init(inputs.seen)

    def step(self, state: Any, inputs: DisturbanceObservationInputs, dt: float) -> tuple[Any, Vector]:
        """Advance the observer by ``dt`` [s] to a sample."""
        return self.observer.step(state, inputs.seen, dt)

    def resumed(self, inputs: DisturbanceObservationInputs, estimate: Vector) -> Any:
        """Return the state that resumes from the last estimate [rad/s²] of another."""
        return self.observer.resumed(inputs.seen, estimate)

    def ready(self, inputs: DisturbanceObservationInputs) -> Flag:
        """Whether the observer can start at a sample: at any."""
        return inputs.corrected.rate_valid | True

    def usable(self, output: Vector) -> Flag:
        """Whether all numbers of an estimate can be used."""
        return usable(output)

    def fallback(self, inputs: DisturbanceObservationInputs, output: Vector) -> Vector:
        """Return what is said in place of an estimate: no disturbance."""
        return namespace(output).zeros_like(output)

    def example(self) -> DisturbanceObservationInputs:
        """Return inputs as they will come, for the compiler."""
        return DisturbanceObservationInputs(level_sample(), np.zeros(3))

    def example_words(self) -> Vector:
        """Return a last estimate as it may come, for the compiler."""
        return np.zeros(3)


class DisturbanceEstimation(ResumingStepper[DisturbanceObservationInputs, Vector, Vector]):
    """A disturbance observer on a stream. An estimate that cannot be used becomes zero and restarts it."""

    def __init__(self, observer: DisturbanceObserver, engine: Engine = NumpyRunner) -> None:
        super().__init__(DisturbanceObservation(observer), engine)
        self._next: DisturbanceObserver | None = None  # takes over with the next body rate
        self._fade = Fade()  # of the estimate [rad/s²], (3,)

    def switch(self, observer: DisturbanceObserver) -> None:
        """Go on with changed parameters, or have another law take over from the estimate, without a jump."""
        if structure_of(observer) == structure_of(self.observer):
            self._use(observer)
        else:
            self._next = observer

    def offer(self, stamp_ns: int, words: Vector) -> None:
        """Offer the last estimate [rad/s², stamp in ns] of an observer that has died, to resume from."""
        if is_usable(words):
            super().offer(stamp_ns, words)

    def estimate(self, stamp_ns: int, corrected: ImuSample, torque: Vector) -> Vector | None:
        """Return the estimate [rad/s²] at a corrected sample; None if its stamp is repeated or went back.

        ``torque`` [N m] is the one that acted since the sample before.
        """
        inputs = DisturbanceObservationInputs(corrected, torque)
        last = self.words_for(stamp_ns)
        if last is not None and has_rate(corrected) and self.time_step(stamp_ns) is not None:
            return self.take_over(stamp_ns, inputs, last)
        said, left = self.step(stamp_ns, inputs), self._fade.at(stamp_ns)
        if said is None:
            return None
        estimate = said if left is None else said + left
        if self._next is not None and has_rate(corrected):
            self._use(self._next)
            self._fade.begin(stamp_ns, estimate - self.begin(stamp_ns, inputs, estimate))
        return estimate

    @property
    def observer(self) -> DisturbanceObserver:
        """The observer that runs."""
        return cast("DisturbanceObservation", self.law).observer

    def _use(self, observer: DisturbanceObserver) -> None:
        law = DisturbanceObservation(observer)
        self.replace_law(law, law.example())
        self._next = None


disturbance_observers: Registry[Any] = Registry(
    "disturbance observer", "quadftc_fdi.disturbance_observers", "quadftc.disturbance_observers"
)
register = disturbance_observers.register
disturbance_observer_from = law_from(disturbance_observers, "observer")  # from the parameters of its node
