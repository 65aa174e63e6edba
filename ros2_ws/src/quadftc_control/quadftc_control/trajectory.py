"""Where the vehicle shall fly: the interface of trajectories, their registry, the filter of live setpoints.

A scenario adds up trajectories, positions with three derivatives and a heading (`quadftc_control.guidance`).
Every trajectory begins at rest, and its acceleration is continuous.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import operator
from collections.abc import Sequence
from typing import NamedTuple

from quadftc_control.reference import smooth_rise
from quadftc_model.arrays import (
    Array,
    Scalar,
    Vector,
    arctan2,
    clip,
    column,
    larger,
    namespace,
    norm,
    stacked,
)
from quadftc_model.assembly import NodeParameters, components_from
from quadftc_model.parameters import Checked, parameter
from quadftc_model.registry import Registry
from quadftc_model.rotations import wrap
from quadftc_model.samples import PositionReference


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory(Checked, abc.ABC):
    """Base of all trajectories; those of a scenario add up."""

    @abc.abstractmethod
    def sample(self, time: Scalar) -> PositionReference:
        """Position [m], heading [rad] and their derivatives, (..., 3) and (...), at times [s] (...)."""


class Phase(NamedTuple):
    """How far along a curve, with three time derivatives; (...) each."""

    value: Scalar
    rate: Scalar
    acceleration: Scalar
    jerk: Scalar


def smooth_run(elapsed: Scalar, rise: float) -> Phase:
    """Phase that rests until 0 s, then gains the rate 1/s over ``rise`` [s] and keeps it; ``elapsed`` in s.

    The rate is a :func:`smooth_rise`, so the phase has three continuous derivatives.
    """
    fraction = elapsed / rise
    s = clip(fraction, 0.0, 1.0)
    value = rise * (s * s * s * s * (2.5 + s * (s - 3.0)) + larger(fraction - 1.0, 0.0))
    rate, slope, curvature = smooth_rise(fraction)
    return Phase(value, rate, slope / rise, curvature / rise**2)


def there_and_back(time: Scalar, start: float, stop: float, rise: float, speed: float) -> Phase:
    """Phase of a curve that is flown from ``start`` to ``stop`` [s] at a speed, with smooth ends."""
    up, down = smooth_run(time - start, rise), smooth_run(time - stop, rise)
    return Phase(*(speed * (a - b) for a, b in zip(up, down, strict=True)))


Curve = Sequence[tuple[Scalar, Scalar]]  # x and y [m], then their three derivatives by the phase


def along(centre: Sequence[float], curve: Curve, phase: Phase, yaw: float, follow: bool) -> PositionReference:
    """Motion along a level curve about a centre (3,) [m].

    The heading is ``yaw`` [rad] from the x axis of the earth or, to ``follow``, from the curve's direction.
    """
    zero = namespace(phase.rate).zeros_like(phase.rate)
    p, d1, d2, d3 = (stacked([x, y, zero]) for x, y in curve)
    r, a, j = map(column, phase[1:])
    course = turning = zero
    if follow:
        (x1, y1), (x2, y2) = curve[1:3]
        course, turning = arctan2(y1, x1), (x1 * y2 - y1 * x2) / (x1 * x1 + y1 * y1)
    return PositionReference(
        position=namespace(p).asarray(centre) + p,
        velocity=d1 * r,
        acceleration=d1 * a + d2 * r * r,
        yaw=yaw + course,
        yaw_rate=turning * phase.rate,
        jerk=d1 * j + 3.0 * d2 * r * a + d3 * r * r * r,
    )


def at_origin(time: Scalar) -> PositionReference:
    """At rest at the origin, at times [s] (...)."""
    zero = namespace(time).zeros_like(time)
    still = stacked([zero, zero, zero])
    return PositionReference(still, still, still, zero, zero, still)


def combined(trajectories: Sequence[Trajectory], time: Scalar) -> PositionReference:
    """Sum of trajectories at times [s] (...); with none, at rest at the origin."""
    parts = [each.sample(time) for each in trajectories] or [at_origin(time)]
    return functools.reduce(_sum, parts)


def _sum(one: Sequence[Array], other: Sequence[Array]) -> PositionReference:
    return PositionReference(*map(operator.add, one, other))


trajectories: Registry[Trajectory] = Registry(
    "trajectory", "quadftc_control.trajectories", "quadftc.trajectories"
)
register = trajectories.register


def trajectories_from(parameters: NodeParameters) -> tuple[Trajectory, ...]:
    """Build the trajectories of a node from its list ``trajectories``."""
    return tuple(components_from(trajectories, parameters, "trajectories"))


class PositionSetpoint(NamedTuple):
    """A live setpoint."""

    position: Vector  # [m]
    yaw: Scalar  # [rad]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PositionSetpointFilter(Checked):
    """Makes live setpoints smooth: second order, critically damped, with speed and acceleration bounded."""

    bandwidth: float = parameter(1.5, unit="rad/s", low=1e-3, high=20.0, doc="natural frequency w")
    max_speed: float = parameter(2.0, unit="m/s", low=1e-3, doc="bound of the speed")
    max_acceleration: float = parameter(2.0, unit="m/s^2", low=1e-3, doc="bound of the acceleration")
    yaw_bandwidth: float = parameter(1.5, unit="rad/s", low=1e-3, high=20.0, doc="the same of the heading")
    max_yaw_acceleration: float = parameter(2.0, unit="rad/s^2", low=1e-3, doc="the same of the heading")

    def init(self, inputs: PositionSetpoint) -> PositionReference:
        """Start at a setpoint, at rest."""
        xp = namespace(inputs.position)
        still = xp.zeros_like(inputs.position)
        return PositionReference(inputs.position, still, still, inputs.yaw, xp.zeros_like(inputs.yaw), still)

    def step(
        self, state: PositionReference, inputs: PositionSetpoint, dt: float
    ) -> tuple[PositionReference, PositionReference]:
        """Advance by ``dt`` [s] towards a setpoint; the state is the last reference, without its jerk."""
        w, v = self.bandwidth, self.yaw_bandwidth
        # the velocity that closes the distance, no faster than allowed, and what brings it about
        towards = within(0.5 * w * (inputs.position - state.position), self.max_speed)
        acceleration = within(2.0 * w * (towards - state.velocity), self.max_acceleration)
        velocity = state.velocity + dt * acceleration
        position = state.position + 0.5 * dt * (state.velocity + velocity)
        turn = v * v * wrap(inputs.yaw - state.yaw) - 2.0 * v * state.yaw_rate
        bound = self.max_yaw_acceleration
        yaw_rate = state.yaw_rate + dt * clip(turn, -bound, bound)
        yaw = state.yaw + 0.5 * dt * (state.yaw_rate + yaw_rate)
        reference = PositionReference(position, velocity, acceleration, yaw, yaw_rate, state.jerk)
        return reference, reference


def within(vector: Vector, bound: float) -> Vector:
    """Vector (..., 3), scaled to a length of no more than a bound."""
    return bound / larger(norm(vector), bound) * vector
