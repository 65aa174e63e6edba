"""The interface of winds, velocities of the air over scenario time, and their registry."""

from __future__ import annotations

import abc
import dataclasses
import math

from quadftc_model.arrays import Column, Scalar, Vector, column, where, whole_nanoseconds
from quadftc_model.parameters import Timed, parameter
from quadftc_model.registry import Registry


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Wind(Timed, abc.ABC):
    """Base of all winds: they blow from ``start`` to ``stop``; those of a scenario add up."""

    start: float = parameter(0.0, unit="s", low=0.0, doc="onset, scenario time")
    stop: float = parameter(math.inf, unit="s", low=0.0, doc="end, scenario time")

    @abc.abstractmethod
    def shape(self, elapsed: Column) -> Vector:
        """Velocity of the air [m/s] (..., 3), earth axes, ``elapsed`` seconds (..., 1) after the onset."""

    def velocity(self, time: Scalar) -> Vector:
        """Velocity of the air [m/s] (..., 3), earth axes, at scenario time ``time`` [s] (...)."""
        stamp = whole_nanoseconds(time)  # so that start and stop mean the same at whatever step
        blows = (self.start <= stamp) & (stamp < self.stop)
        return where(column(blows), self.shape(column(time - self.start)), 0.0)


winds: Registry[Wind] = Registry("wind", "quadftc_sim.winds", "quadftc.winds")
register = winds.register
