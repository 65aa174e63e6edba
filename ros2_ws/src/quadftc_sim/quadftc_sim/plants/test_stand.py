"""The attitude of a multirotor that turns about a fixed point, under rotor torques and disturbances.

Equations: rigid body (1), torques (2) and full kinematics (4) of Wang et al. (2021), by Runge-Kutta of order
4. A unit quaternion gives the same motion as (4) and has no singularity. The paper has no motor lag.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_model.arrays import Array, Components, Quaternion, Vector, namespace
from quadftc_model.rigid_body import Derivative, angular_acceleration, propeller_momentum, rk4
from quadftc_model.rotations import normalise, quaternion_rate
from quadftc_model.rotors import commands_from_torque, torque_from_commands
from quadftc_sim.plant import Plant, register
from quadftc_sim.sensors import resting_force


class StandState(NamedTuple):
    """Motion of the vehicle."""

    q_xyzw: Quaternion  # attitude, body to earth
    body_rate: Vector  # [rad/s]
    commands: Components  # rotor commands that act now: with motor lag, behind the commands given


@register("test_stand")
class AttitudeStand(Plant):
    """A vehicle that turns about a fixed point, as the paper's does."""

    flies = False

    def init(self, q_xyzw: Quaternion, body_rate: Vector) -> StandState:
        """State at an attitude and a body rate [rad/s], rotors at trim."""
        xp = namespace(q_xyzw)
        trim = xp.full_like(q_xyzw[..., :1], self.vehicle.rotors.command_trim)
        commands = xp.concatenate([trim] * len(self.vehicle.rotors.positions), axis=-1)
        return StandState(q_xyzw, body_rate, commands)

    def step(self, state: StandState, command: Vector, time: float, dt: float) -> StandState:
        """Advance by ``dt`` [s] from scenario time ``time`` [s] under a torque command [N m], held.

        The command goes through the mixer and its limits.
        """
        wanted = commands_from_torque(self.vehicle, command)
        step = dt / self.substeps
        if self.motor_lag:
            arrays, derivative = tuple(state), self._lagging(wanted)
        else:
            arrays, derivative = (state.q_xyzw, state.body_rate), self._driven(wanted)
        for index in range(self.substeps):
            q_xyzw, *rest = rk4(derivative, time + index * step, arrays, step)
            arrays = (normalise(q_xyzw), *rest)
        return StandState(*(arrays if self.motor_lag else (*arrays, wanted)))

    def specific_force(self, state: StandState, time: float) -> Vector:
        """The reaction to gravity alone [m/s²]: the accelerometer is at the fixed point."""
        return resting_force(state.q_xyzw)

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
