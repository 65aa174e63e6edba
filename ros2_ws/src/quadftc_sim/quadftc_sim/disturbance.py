"""The interface of disturbances, torques on the body over scenario time, and their registry."""

from __future__ import annotations

import abc
import dataclasses
import math

from quadftc_model.arrays import Column, Scalar, Vector, column, where, whole_nanoseconds
from quadftc_model.parameters import Timed, parameter
from quadftc_model.registry import Registry


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Disturbance(Timed, abc.ABC):
    """Base of all disturbances: they act from ``start`` to ``stop`` and are zero outside."""

    start: float = parameter(0.0, unit="s", low=0.0, doc="onset, scenario time")
    stop: float = parameter(math.inf, unit="s", low=0.0, doc="end, scenario time")

    @abc.abstractmethod
    def shape(self, elapsed: Column) -> Vector:
        """Torque [N m] (..., 3), body frame, ``elapsed`` seconds (..., 1) after the onset."""

    def torque(self, time: Scalar) -> Vector:
        """Torque [N m] (..., 3), body frame, at scenario time ``time`` [s] (...)."""
        stamp = whole_nanoseconds(time)  # so that start and stop mean the same at whatever step
        acts = (self.start <= stamp) & (stamp < self.stop)
        return where(column(acts), self.shape(column(time - self.start)), 0.0)


disturbances: Registry[Disturbance] = Registry(
    "disturbance", "quadftc_sim.disturbances", "quadftc.disturbances"
)
register = disturbances.register
