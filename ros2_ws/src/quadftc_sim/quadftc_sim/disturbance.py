"""The interface of disturbances, torques on the body, their registry, and the base that winds share."""

from __future__ import annotations

import abc
import dataclasses
import math

from quadftc_model.arrays import Column, Scalar, Vector, column, where, whole_nanoseconds
from quadftc_model.parameters import Timed, parameter
from quadftc_model.registry import Registry


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Acting(Timed, abc.ABC):
    """Base of what acts on the vehicle from ``start`` to ``stop``; subclasses say in which unit and frame."""

    start: float = parameter(0.0, unit="s", low=0.0, doc="onset, scenario time")
    stop: float = parameter(math.inf, unit="s", low=0.0, doc="end, scenario time")

    @abc.abstractmethod
    def shape(self, elapsed: Column) -> Vector:
        """Size (..., 3), ``elapsed`` seconds (..., 1) after the onset."""

    def at(self, time: Scalar) -> Vector:
        """Size (..., 3) at scenario time ``time`` [s] (...)."""
        stamp = whole_nanoseconds(time)  # so that start and stop mean the same at whatever step
        acts = (self.start <= stamp) & (stamp < self.stop)
        return where(column(acts), self.shape(column(time - self.start)), 0.0)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Disturbance(Acting):
    """Base of all disturbances: their size is a torque [N m], body frame."""


disturbances: Registry[Disturbance] = Registry(
    "disturbance", "quadftc_sim.disturbances", "quadftc.disturbances"
)
register = disturbances.register
