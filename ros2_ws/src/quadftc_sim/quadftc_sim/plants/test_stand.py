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
        shape = (*q_xyzw.shape[:-1], len(self.vehicle.rotors.positions))
        still = namespace(q_xyzw).zeros_like(q_xyzw, shape=shape)
        return StandState(q_xyzw, body_rate, still + self.vehicle.rotors.command_trim)

    def step(self, state: StandState, command: Vector, time: float, dt: float) -> StandState:
        """Advance by ``dt`` [s] from scenario time ``time`` [s] under a torque command [N m], held.

        The command goes through the mixer and its limits.
        """
        wanted = commands_from_torque(self.vehicle, command)
        arrays = state if self.motor_lag else state._replace(commands=wanted)
        step = dt / self.substeps
        for index in range(self.substeps):
            q_xyzw, body_rate, commands = rk4(self._derivative(wanted), time + index * step, arrays, step)
            arrays = StandState(normalise(q_xyzw), body_rate, commands)
        return arrays

    def specific_force(self, state: StandState, time: float) -> Vector:
        """The reaction to gravity alone [m/s²]: the accelerometer is at the fixed point."""
        return resting_force(state.q_xyzw)

    def _derivative(self, wanted: Components) -> Derivative:
        """Derivative of attitude, body rate and rotor commands, which follow those that are wanted."""

        def derivative(time: float, arrays: tuple[Array, ...]) -> tuple[Array, ...]:
            q_xyzw, body_rate, commands = arrays
            momentum = propeller_momentum(self.vehicle, commands)
            torque = torque_from_commands(self.vehicle, commands) + self.disturbance(time, body_rate)
            acceleration = angular_acceleration(self.vehicle, body_rate, torque, momentum, self.inertia)
            if self.motor_lag:
                command_rate = (wanted - commands) / self.motor_time_constant
            else:
                command_rate = namespace(commands).zeros_like(commands)
            return quaternion_rate(q_xyzw, body_rate), acceleration, command_rate

        return derivative
