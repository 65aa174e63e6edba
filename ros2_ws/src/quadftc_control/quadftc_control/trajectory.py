"""Where the vehicle shall fly: the interface of trajectories, their registry, and two sources of them.

A scenario adds up trajectories, positions with three derivatives and a heading; live setpoints go through a
filter. Every trajectory begins at rest, and its acceleration is continuous.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_control.reference import smooth_rise
from quadftc_model.arrays import Array, Scalar, Vector, clip, components, larger, namespace, stacked
from quadftc_model.assembly import NodeParameters, components_from
from quadftc_model.parameters import Checked, parameter
from quadftc_model.registry import Registry
from quadftc_model.rotations import wrap
from quadftc_model.samples import PositionReference, is_usable
from quadftc_model.stepper import seconds


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory(Checked, abc.ABC):
    """Base of all trajectories; those of a scenario add up."""

    @abc.abstractmethod
    def sample(self, time: Array) -> PositionReference:
        """Position [m], heading [rad] and their derivatives, (..., 3) and (...), at times [s] (...)."""


class Phase(NamedTuple):
    """How far along a curve, with three time derivatives; (...) each."""

    value: Array
    rate: Array
    acceleration: Array
    jerk: Array


def smooth_run(elapsed: Array, rise: float) -> Phase:
    """Phase that rests until 0 s, then gains the rate 1/s over ``rise`` [s] and keeps it; ``elapsed`` in s.

    The rate is a :func:`smooth_rise`, so the phase has three continuous derivatives.
    """
    fraction = elapsed / rise
    s = clip(fraction, 0.0, 1.0)
    value = rise * (s * s * s * s * (2.5 + s * (s - 3.0)) + larger(fraction - 1.0, 0.0))
    rate, slope, curvature = smooth_rise(fraction)
    return Phase(value, rate, slope / rise, curvature / rise**2)


def there_and_back(time: Array, start: float, stop: float, rise: float, speed: float) -> Phase:
    """Phase of a curve that is flown from ``start`` to ``stop`` [s] at a speed, with smooth ends."""
    up, down = smooth_run(time - start, rise), smooth_run(time - stop, rise)
    return Phase(*(speed * (a - b) for a, b in zip(up, down, strict=True)))


Curve = tuple[tuple[Array, Array], tuple[Array, Array], tuple[Array, Array], tuple[Array, Array]]


def along(centre: Sequence[float], curve: Curve, phase: Phase, yaw: float, follow: bool) -> PositionReference:
    """Motion along a level curve: x and y with three derivatives by the phase, about a centre [m].

    The heading is ``yaw`` [rad] from the x axis of the earth or, to ``follow``, from the curve's direction.
    """
    p, d1, d2, d3 = curve
    _, r, a, j = phase
    zero = 0.0 * r
    x, y, z = centre
    turning = (d1[0] * d2[1] - d1[1] * d2[0]) / (d1[0] * d1[0] + d1[1] * d1[1]) if follow else zero
    course = namespace(r).arctan2(d1[1], d1[0]) if follow else zero
    return PositionReference(
        stacked([x + p[0], y + p[1], z + zero]),
        stacked([d1[0] * r, d1[1] * r, zero]),
        stacked([each * a + second * r * r for each, second in zip(d1, d2, strict=True)] + [zero]),
        yaw + course,
        turning * r,
        stacked([d1[i] * j + 3.0 * d2[i] * r * a + d3[i] * r * r * r for i in (0, 1)] + [zero]),
    )


def combined(trajectories: Sequence[Trajectory], time: Array) -> PositionReference:
    """Sum of trajectories at ``time`` [s]; with none, at rest at the origin."""
    zeros = np.zeros(3)
    parts = [each.sample(time) for each in trajectories]
    parts = parts or [PositionReference(zeros, zeros, zeros, 0.0, 0.0, zeros)]
    return functools.reduce(_sum, parts)


def _sum(one: Any, other: Any) -> PositionReference:
    return PositionReference(*map(operator.add, one, other))


trajectories: Registry[Any] = Registry("trajectory", "quadftc_control.trajectories", "quadftc.trajectories")
register = trajectories.register


class TrajectoryGenerator:
    """The trajectory of a scenario on a stream of stamps; the first stamp is scenario time 0.

    A sample that cannot be used, such as one with absurd accelerations, is replaced by the last one.
    """

    def __init__(self, parts: Sequence[Trajectory]) -> None:
        self.parts = tuple(parts)
        self._last = combined((), 0.0)
        self._epoch_ns: int | None = None

    def at(self, stamp_ns: int) -> PositionReference:
        """Return the trajectory at a stamp [ns]."""
        if self._epoch_ns is None:
            self._epoch_ns = stamp_ns
        sample = combined(self.parts, seconds(stamp_ns - self._epoch_ns))
        if is_usable(*sample[:3], np.array(sample[3:5])):
            self._last = sample
        return self._last


def trajectory_from(parameters: NodeParameters) -> TrajectoryGenerator:
    """Build the trajectory of a node from its list ``trajectories``; the origin without any."""
    return TrajectoryGenerator(components_from(trajectories, parameters, "trajectories"))


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
        still = 0.0 * inputs.position
        return PositionReference(inputs.position, still, still, inputs.yaw, 0.0 * inputs.yaw)

    def step(
        self, state: PositionReference, inputs: PositionSetpoint, dt: float
    ) -> tuple[PositionReference, PositionReference]:
        """Advance by ``dt`` [s] towards a setpoint; the state is the last reference."""
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
        reference = PositionReference(position, velocity, acceleration, yaw, yaw_rate)
        return reference, reference


def within(vector: Vector, bound: float) -> Vector:
    """Vector (..., 3), scaled to a length of no more than a bound."""
    x, y, z = components(vector)
    xp = namespace(x)
    scale = bound / larger(xp.sqrt(x * x + y * y + z * z), bound)
    return stacked([scale * x, scale * y, scale * z])
