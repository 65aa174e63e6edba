"""What all plants in free flight share: their state, their parameters, the air and its drag."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import (
    Array,
    Components,
    Quaternion,
    Scalar,
    Vector,
    clip,
    column,
    cos,
    namespace,
    sin,
    smaller,
    where,
)
from quadftc_model.numbers import prepared
from quadftc_model.parameters import parameter
from quadftc_model.rotations import to_body
from quadftc_model.samples import AIR_DENSITY, RotorCondition
from quadftc_sim.plant import Plant
from quadftc_sim.rotor_fault import healthy_rotors
from quadftc_sim.wind import Wind

ACROSS = np.array([1.0, 1.0, 0.0])  # body axes in the plane of the rotors


class RotorState(NamedTuple):
    """What else there is to rotors that may be faulty; n rotors, in the order of the vehicle file."""

    condition: RotorCondition
    angle: Components  # by which each has turned about body z (..., n) [rad]


class FlightState(NamedTuple):
    """Motion of the vehicle and of its rotors."""

    position: Vector  # of the centre of mass [m]
    velocity: Vector  # [m/s]
    q_xyzw: Quaternion  # attitude, body to earth
    body_rate: Vector  # [rad/s]
    speeds: Components  # of the rotors, unsigned [rad/s]
    rotors: RotorState


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

    @prepared
    def feet(self) -> Array:
        """Where the vehicle stands, one foot below each rotor, (n, 3) [m]."""
        xy = self.vehicle.rotors.positions
        below = -0.5 * np.max(np.hypot(xy[:, 0], xy[:, 1]))
        return np.column_stack([xy, np.full(len(xy), below)])

    def init(self, q_xyzw: Quaternion, body_rate: Vector) -> FlightState:
        """State at an attitude and a body rate [rad/s], at ``start``, at rest, with hover thrust."""
        xp = namespace(q_xyzw)
        zeros = xp.zeros_like(body_rate)
        still = xp.zeros_like(q_xyzw, shape=(*q_xyzw.shape[:-1], len(self.vehicle.rotors.positions)))
        return FlightState(
            position=zeros + xp.asarray(self.start),
            velocity=zeros,
            q_xyzw=q_xyzw,
            body_rate=body_rate,
            speeds=still + self.vehicle.hover_speed,
            rotors=RotorState(healthy_rotors(still), still),
        )

    def with_rotors(self, state: FlightState, condition: RotorCondition) -> FlightState:
        """Return the state with rotors in a condition."""
        return state._replace(rotors=state.rotors._replace(condition=condition))

    def speeds_wanted(self, state: FlightState, command: Components) -> Components:
        """Return the speeds [rad/s] (..., n) that the rotors go to under a command [rad/s] (..., n)."""
        rotors, condition = self.vehicle.rotors, state.rotors.condition
        driven = clip(command, rotors.speed_min, rotors.speed_max)
        return smaller(where(condition.stuck, state.speeds, driven), condition.speed_limit)

    def wind(self, time: Scalar, like: Vector) -> Vector:
        """Velocity of the air at ``time`` [m/s], earth axes, shaped as ``like``."""
        return sum((wind.at(time) for wind in self.winds), start=namespace(like).zeros_like(like))

    def drag(self, state: FlightState, time: Scalar) -> Vector:
        """Drag of rotors and body [N], body axes:

        -c_r sum_i effectiveness_i speed_i (u_x, u_y, 0) - rho/2 A |u| u,    u = R^T (v - wind)
        """
        body = self.vehicle.aerodynamics
        u = to_body(state.q_xyzw, state.velocity - self.wind(time, state.velocity))
        turning = (state.rotors.condition.effectiveness * state.speeds).sum(axis=-1)
        return -(body.rotor_drag * column(turning) * ACROSS + 0.5 * AIR_DENSITY * body.drag_area * abs(u)) * u

    def shaking(self, state: FlightState) -> tuple[Scalar, Scalar, Scalar]:
        """Force along body x and y [N] of unbalanced rotors, and its torque about body z [N m].

        The force of each, unbalance * speed², turns with it.
        """
        x, y = self.vehicle.rotors.positions[:, 0], self.vehicle.rotors.positions[:, 1]
        force = state.rotors.condition.unbalance * state.speeds * state.speeds
        fx, fy = force * cos(state.rotors.angle), force * sin(state.rotors.angle)
        return fx.sum(axis=-1), fy.sum(axis=-1), (x * fy - y * fx).sum(axis=-1)
