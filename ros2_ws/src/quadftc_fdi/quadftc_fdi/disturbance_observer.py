"""The interface of disturbance observers and their registry."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any

import numpy as np

from quadftc_model.arrays import Array
from quadftc_model.parameters import check
from quadftc_model.registry import Registry
from quadftc_model.samples import DisturbanceObserverInputs, ImuSample, is_usable, sanitised
from quadftc_model.stepper import Stepper
from quadftc_model.vehicle import Vehicle


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class DisturbanceObserver(abc.ABC):
    """Base of all disturbance observers: from body rates and torques to d of (36) [rad/s²]."""

    vehicle: Vehicle

    def __post_init__(self) -> None:
        """Check the parameters."""
        check(self)

    @abc.abstractmethod
    def init(self, inputs: DisturbanceObserverInputs) -> Any:
        """Return the state at the first sample."""

    def resumed(self, inputs: DisturbanceObserverInputs, estimate: Array) -> Any:
        """Return the state with which to go on where another one has left off, at ``estimate`` [rad/s²].

        By default it starts anew.
        """
        return self.init(inputs)

    @abc.abstractmethod
    def step(self, state: Any, inputs: DisturbanceObserverInputs, dt: float) -> tuple[Any, Array]:
        """Advance by ``dt`` [s] to a sample (0 at the first one); return the estimate (..., 3) [rad/s²]."""


def stepper_of(law: DisturbanceObserver) -> Stepper[DisturbanceObserverInputs, Array]:
    """Run a disturbance observer on a stream: an estimate that cannot be used is zero, and restarts it."""
    return Stepper(law, lambda _, estimate: estimate if is_usable(estimate) else np.zeros(3))


def inputs_of(corrected: ImuSample, torque: Array) -> DisturbanceObserverInputs:
    """Inputs of a disturbance observer, of a corrected sample and the torque that acted before it [N m]."""
    clean = sanitised(corrected)
    return DisturbanceObserverInputs(clean.body_rate, clean.rate_valid, torque)


disturbance_observers: Registry[Any] = Registry(
    "disturbance observer", "quadftc_fdi.disturbance_observers", "quadftc.disturbance_observers"
)
register = disturbance_observers.register
