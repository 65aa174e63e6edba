"""What all plants in free flight share: their state, their parameters, the air and its drag."""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import (
    Array,
    Components,
    Quaternion,
    Vector,
    clip,
    components,
    namespace,
    stacked,
)
from quadftc_model.parameters import parameter
from quadftc_model.rotations import turned
from quadftc_model.samples import AIR_DENSITY, RotorCondition
from quadftc_sim.plant import Plant
from quadftc_sim.wind import Wind

Parts = Sequence[Any]  # components, each a float or an array (...)


class FaultyRotors(NamedTuple):
    """Rotors that may be faulty."""

    condition: RotorCondition
    angle: Components  # by which each has turned about body z (..., n) [rad]


class FlightState(NamedTuple):
    """Motion of the vehicle and of its rotors."""

    position: Vector  # of the centre of mass [m]
    velocity: Vector  # [m/s]
    q_xyzw: Quaternion  # attitude, body to earth
    body_rate: Vector  # [rad/s]
    speeds: Components  # of the rotors, unsigned [rad/s]
    rotors: FaultyRotors | None = None  # None: all are healthy


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FlyingPlant(Plant):
    """A vehicle with six degrees of freedom; its states are `FlightState`, earth axes east, north, up."""

    flies = True

    motor_lag: bool = parameter(
        True, doc="rotor speed follows its command through the vehicle's first-order lag"
    )
    start: tuple[float, float, float] = parameter(
        (0.0, 0.0, 1.0), unit="m", low=-1e4, high=1e4, doc="position at the start, where it hovers"
    )
    ground: bool = parameter(True, doc="the ground, at height 0, carries the vehicle")
    winds: tuple[Wind, ...] = ()

    @functools.cached_property
    def feet(self) -> Array:
        """Where the vehicle stands, one foot below each rotor, (n, 3) [m]."""
        xy = self.vehicle.rotors.positions
        below = -0.5 * np.max(np.hypot(xy[:, 0], xy[:, 1]))
        return np.column_stack([xy, np.full(len(xy), below)])

    def init(self, q_xyzw: Quaternion, body_rate: Vector) -> FlightState:
        """State at an attitude and a body rate [rad/s], at ``start``, at rest, with hover thrust."""
        xp = namespace(q_xyzw)
        hover = xp.full_like(q_xyzw[..., :1], self.vehicle.hover_speed)
        speeds = xp.concatenate([hover] * len(self.vehicle.rotors.positions), axis=-1)
        zeros = 0.0 * body_rate
        return FlightState(zeros + xp.asarray(self.start), zeros, q_xyzw, body_rate, speeds)

    def with_rotors(self, state: FlightState, condition: RotorCondition | None) -> FlightState:
        """Return the state with rotors in a condition; None: as they are."""
        if condition is None:
            return state
        angle = 0.0 * state.speeds if state.rotors is None else state.rotors.angle
        return state._replace(rotors=FaultyRotors(condition, angle))

    def speeds_wanted(self, state: FlightState, command: Components) -> Components:
        """Return the speeds [rad/s] (..., n) that the rotors go to under a command [rad/s] (..., n)."""
        rotors = self.vehicle.rotors
        wanted = clip(command, rotors.speed_min, rotors.speed_max)
        if state.rotors is None:
            return wanted
        xp, condition = namespace(wanted), state.rotors.condition
        held = xp.where(condition.stuck, state.speeds, wanted)
        return xp.minimum(held, condition.speed_limit)

    def wind(self, time: float, like: Vector) -> Vector:
        """Velocity of the air at ``time`` [m/s], earth axes, shaped as ``like``."""
        return stacked(self._weather(time)[0]) + 0.0 * like

    def _weather(self, time: float) -> tuple[Parts, Parts]:
        """Velocity of the air [m/s] and disturbance torque [N m] at ``time`` [s]."""
        return known_weather(self, time) if isinstance(time, float) else self.weather(time)

    def weather(self, time: float) -> tuple[Parts, Parts]:
        """Compute what `known_weather` remembers."""
        air = [components(wind.velocity(time)) for wind in self.winds]
        torque = [components(each.torque(time)) for each in self.disturbances]
        none = (0.0, 0.0, 0.0)
        return sum_of(air) if air else none, sum_of(torque) if torque else none

    def _shaking(self, speeds: Parts, unbalance: Parts, angles: Parts) -> tuple[Parts, Any]:
        """Force [N] of unbalanced rotors, body axes, and its torque about body z [N m]."""
        forces = [each * speed * speed for each, speed in zip(unbalance, speeds, strict=True)]
        turns = [math if isinstance(angle, float) else namespace(angle) for angle in angles]
        along_x = [f * xp.cos(angle) for f, xp, angle in zip(forces, turns, angles, strict=True)]
        along_y = [f * xp.sin(angle) for f, xp, angle in zip(forces, turns, angles, strict=True)]
        x, y = (components(self.vehicle.rotors.positions[:, axis]) for axis in (0, 1))
        arms = zip(x, y, along_x, along_y, strict=True)
        torque = total([a * fy - b * fx for a, b, fx, fy in arms])
        return (total(along_x), total(along_y), 0.0), torque

    def _drag(self, q: Parts, velocity: Parts, air: Parts, speeds: Any) -> Parts:
        """Drag of rotors and body [N], body axes; ``speeds`` is their sum [rad/s]."""
        body = self.vehicle.aerodynamics
        ux, uy, uz = turned(inverse(q), [v - a for v, a in zip(velocity, air, strict=True)])
        x, y, z = (0.5 * AIR_DENSITY * area for area in components(body.drag_area))
        in_plane = body.rotor_drag * speeds
        return -(in_plane + x * abs(ux)) * ux, -(in_plane + y * abs(uy)) * uy, -z * abs(uz) * uz


def inverse(q: Parts) -> Parts:
    """Components of the inverse of a unit quaternion."""
    x, y, z, w = q
    return x, y, z, -w


@functools.lru_cache(maxsize=8)
def known_weather(plant: FlyingPlant, time: float) -> tuple[Parts, Parts]:
    """Return the weather at a time [s], which a step and its neighbours ask for several times."""
    return plant.weather(time)


def total(parts: Parts) -> Any:
    """Sum of numbers or arrays."""
    return functools.reduce(operator.add, parts)


def sum_of(vectors: Sequence[Parts]) -> Parts:
    """Sum of vectors, component by component."""
    return [total(axis) for axis in zip(*vectors, strict=True)]
