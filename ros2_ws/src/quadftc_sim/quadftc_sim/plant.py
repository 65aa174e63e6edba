"""The plant: the attitude of a multirotor under rotor torques and disturbances.

Equations: rigid body (1), torques (2) and full kinematics (4) of Wang et al. (2021), by Runge-Kutta of order
4. A unit quaternion gives the same motion as (4) and has no singularity.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Components, Quaternion, Vector, namespace
from quadftc_model.parameters import Checked, parameter
from quadftc_model.rigid_body import Derivative, angular_acceleration, propeller_momentum, rk4
from quadftc_model.rotations import normalise, quaternion_rate
from quadftc_model.rotors import commands_from_torque, torque_from_commands
from quadftc_model.vehicle import Vehicle
from quadftc_sim.disturbance import Disturbance


class PlantState(NamedTuple):
    """Motion of the vehicle."""

    q_xyzw: Quaternion  # attitude, body to earth
    body_rate: Vector  # [rad/s]
    commands: Components  # rotor commands that act now: with motor lag, behind the commands given


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Plant(Checked):
    """A vehicle in its disturbances.

    It may differ from the ``vehicle`` that observers and controller are designed for: in its moments of
    inertia, and in how fast its rotors are. The torques of the disturbances add. The paper has no motor lag.
    """

    vehicle: Vehicle
    disturbances: tuple[Disturbance, ...] = ()
    motor_lag: bool = parameter(False, doc="thrust follows its command through the vehicle's first-order lag")
    motor_bandwidth: float = parameter(
        0.0, unit="rad/s", low=0.0, high=500.0, doc="of the motor lag; 0: the vehicle's own"
    )
    substeps: int = parameter(1, low=1, high=1000, doc="integration steps to a control period")
    inertia_factor: tuple[float, float, float] = parameter(
        (1.0, 1.0, 1.0), low=0.2, high=5.0, doc="true moments of inertia over those of the vehicle"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.motor_bandwidth > 0.0 and not self.motor_lag:
            raise ValueError(f"motor_bandwidth = {self.motor_bandwidth:g} rad/s: motor_lag is false")

    @functools.cached_property
    def inertia(self) -> Vector:
        """True principal moments of inertia [kg m²]."""
        return self.vehicle.inertia * np.array(self.inertia_factor)

    @functools.cached_property
    def motor_time_constant(self) -> float:
        """Time constant of the motor lag [s]."""
        own = self.vehicle.rotors.time_constant
        return 1.0 / self.motor_bandwidth if self.motor_bandwidth > 0.0 else own

    def init(self, q_xyzw: Quaternion, body_rate: Vector) -> PlantState:
        """State at an attitude and a body rate [rad/s], rotors at trim."""
        xp = namespace(q_xyzw)
        trim = xp.full_like(q_xyzw[..., :1], self.vehicle.rotors.command_trim)
        commands = xp.concatenate([trim] * len(self.vehicle.rotors.positions), axis=-1)
        return PlantState(q_xyzw, body_rate, commands)

    def step(self, state: PlantState, torque: Vector, time: float, dt: float) -> PlantState:
        """Advance by ``dt`` [s] from scenario time ``time`` [s] under a torque command [N m], held.

        The command goes through the mixer and its limits.
        """
        wanted = commands_from_torque(self.vehicle, torque)
        step = dt / self.substeps
        if self.motor_lag:
            arrays, derivative = tuple(state), self._lagging(wanted)
        else:
            arrays, derivative = (state.q_xyzw, state.body_rate), self._driven(wanted)
        for index in range(self.substeps):
            q_xyzw, *rest = rk4(derivative, time + index * step, arrays, step)
            arrays = (normalise(q_xyzw), *rest)
        return PlantState(*(arrays if self.motor_lag else (*arrays, wanted)))

    def disturbance(self, time: float, like: Vector) -> Vector:
        """Sum of the disturbance torques at ``time`` [N m], shaped as ``like``."""
        torques = [disturbance.torque(time) for disturbance in self.disturbances]
        return sum(torques, start=0.0 * like)

    def disturbance_acceleration(self, time: float, like: Vector) -> Vector:
        """Disturbance at ``time`` [rad/s²], shaped as ``like``: its torque over the true inertia."""
        return self.disturbance(time, like) / self.inertia

    def _driven(self, commands: Components) -> Derivative:
        """Derivative of attitude and body rate under rotor commands that are held."""
        rotor_torque = torque_from_commands(self.vehicle, commands)
        momentum = propeller_momentum(self.vehicle, commands)

        def derivative(time: float, arrays: tuple[Array, ...]) -> tuple[Array, ...]:
            q_xyzw, body_rate = arrays
            torque = rotor_torque + self.disturbance(time, body_rate)
            acceleration = angular_acceleration(self.vehicle, body_rate, torque, momentum, self.inertia)
            return quaternion_rate(q_xyzw, body_rate), acceleration

        return derivative

    def _lagging(self, wanted: Components) -> Derivative:
        """Derivative of attitude, body rate and rotor commands, which follow those that are wanted."""

        def derivative(time: float, arrays: tuple[Array, ...]) -> tuple[Array, ...]:
            *motion, commands = arrays
            command_rate = (wanted - commands) / self.motor_time_constant
            return (*self._driven(commands)(time, tuple(motion)), command_rate)

        return derivative
