"""A multirotor in free flight: six degrees of freedom, rotors with lag and limits, drag, wind and ground.

    p' = v,    m v' = R F - m g e3,    q' = q (omega, 0) / 2
    J omega' = -omega x (J omega + h e3) - k_d omega + M,    T_m speed' = wanted - speed

F and M are the sums of

- the rotors i, at (x_i, y_i): thrust k speed², its torque about x and y, and the reaction torque;
- the rotor drag (Furrer et al. 2016, RotorS) and the drag of the body;
- of rotors that spin up, the torque -J_r sum_i +-speed_i' about z;
- the ground on the feet, in body axes;
- the disturbance torques.

h = J_r sum_i +-speed_i. Rotor drag acts at the centre of mass; its torque is part of ``rotational_drag``.
Earth axes are east, north, up. Runge-Kutta of order 4.

The effectiveness of a faulty rotor (`quadftc_sim.rotor_fault`) multiplies its thrust, its reaction torque and
its drag. Its unbalance adds a force unbalance * speed² that turns with it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import (
    Array,
    Components,
    Vector,
    branch,
    components,
    cross,
    larger,
    namespace,
    sqrt,
    stacked,
)
from quadftc_model.numbers import prepared
from quadftc_model.rigid_body import Derivative, angular_acceleration, rk4
from quadftc_model.rotations import normalise, quaternion_rate, to_body, to_earth
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import STANDARD_GRAVITY, RotorCondition
from quadftc_sim.flying_plant import FlightState, FlyingPlant, RotorState
from quadftc_sim.plant import register

SINKING = 0.01  # m; how far the feet sink under the weight
DAMPING = 0.7  # 1; damping ratio of the ground
FRICTION, SLIDING = 0.6, 0.05  # 1; Coulomb friction, full from this speed [m/s] on
GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY])  # m/s²; upwards


class Loads(NamedTuple):
    """What acts on the vehicle at an instant."""

    force: Vector  # F [N], body axes
    angular_acceleration: Vector  # omega' [rad/s²], body axes


@register("free_flight")
class FreeFlight(FlyingPlant):
    """A vehicle that flies through air and wind."""

    @prepared
    def height_of_feet(self) -> float:
        """Height above which no foot touches the ground, however the vehicle is turned [m]."""
        return float(np.max(np.sqrt(np.sum(self.feet**2, axis=1))))

    def step(self, state: FlightState, command: Components, time: float, dt: float) -> FlightState:
        """Advance by ``dt`` [s] from scenario time ``time`` [s] under rotor speeds [rad/s] (..., n), held."""
        wanted = self.speeds_wanted(state, command)
        derivative = self._derivative(wanted, state.rotors.condition)
        arrays = (*state[:4], state.speeds if self.motor_lag else wanted, state.rotors.angle)
        step = dt / self.substeps
        for index in range(self.substeps):
            arrays = rk4(derivative, time + index * step, arrays, step)
        position, velocity, q_xyzw, body_rate, speeds, angle = arrays
        rotors = state.rotors._replace(angle=angle)
        return FlightState(position, velocity, normalise(q_xyzw), body_rate, speeds, rotors)

    def specific_force(self, state: FlightState, time: float) -> Vector:
        """What an ideal accelerometer measures at the place r of the IMU [m/s²].

        F / m + omega' x r + omega x (omega x r), with rotors that keep their speeds
        """
        loads = self._loads(state, namespace(state.speeds).zeros_like(state.speeds), time)
        omega, arm = state.body_rate, self.vehicle.aerodynamics.imu_position
        turning = cross(loads.angular_acceleration, arm) + cross(omega, cross(omega, arm))
        return loads.force / self.vehicle.mass + turning

    def _derivative(self, wanted: Components, condition: RotorCondition) -> Derivative:
        """Derivative of position, velocity, attitude, body rate, and of speeds and angles of the rotors."""

        def derivative(time: float, arrays: tuple[Array, ...]) -> tuple[Array, ...]:
            position, velocity, q_xyzw, omega, speeds, angle = arrays
            state = FlightState(position, velocity, q_xyzw, omega, speeds, RotorState(condition, angle))
            if self.motor_lag:
                spin_up = (wanted - speeds) / self.motor_time_constant
            else:
                spin_up = namespace(speeds).zeros_like(speeds)
            loads = self._loads(state, spin_up, time)
            acceleration = to_earth(q_xyzw, loads.force) / self.vehicle.mass - GRAVITY
            turning = self.vehicle.rotors.spin_sign * speeds
            q_rate = quaternion_rate(q_xyzw, omega)
            return velocity, acceleration, q_rate, loads.angular_acceleration, spin_up, turning

        return derivative

    def _loads(self, state: FlightState, spin_up: Components, time: float) -> Loads:
        """What acts at an instant, where the rotors gain ``spin_up`` [rad/s²] (..., n)."""
        rotors, omega = self.vehicle.rotors, state.body_rate
        torque, thrust = wrench_from_speeds(self.vehicle, state.speeds, state.rotors.condition.effectiveness)
        shake_x, shake_y, yaw = self.shaking(state)
        spinning_up = rotors.rotor_inertia * (spin_up @ rotors.spin_sign)
        force = stacked([shake_x, shake_y, thrust]) + self.drag(state, time)
        torque = torque + stacked([0.0, 0.0, yaw - spinning_up]) + self.disturbance(time, omega)
        if self.ground:
            carried, carried_torque = self._carry(state)
            force, torque = force + carried, torque + carried_torque
        momentum = rotors.rotor_inertia * (state.speeds @ rotors.spin_sign)
        acceleration = angular_acceleration(self.vehicle, omega, torque, momentum, self.inertia)
        return Loads(force, acceleration)

    def _carry(self, state: FlightState) -> tuple[Vector, Vector]:
        """Force [N] and torque [N m] of the ground, body axes; most of the time no foot touches it."""
        zeros = namespace(state.body_rate).zeros_like(state.body_rate)
        flies = state.position[..., 2] > self.height_of_feet
        return branch(flies, lambda: (zeros, zeros), lambda: self._load_feet(state))

    def _load_feet(self, state: FlightState) -> tuple[Vector, Vector]:
        """Force [N] and torque [N m] of the ground on the feet: where a foot is ``sunk`` by s,

        load = max(k s - d s', 0) upwards,    -mu load v / max(|v|, v_0) along the ground
        """
        # of each foot (..., feet, 3): its height and velocity in earth axes
        q_xyzw, feet = state.q_xyzw[..., None, :], self.feet
        sunk = -state.position[..., None, 2] - to_earth(q_xyzw, feet)[..., 2]
        moving = state.velocity[..., None, :] + to_earth(q_xyzw, cross(state.body_rate[..., None, :], feet))
        x, y, z = components(moving)
        # a spring and a damper push it up, friction holds it
        share = self.vehicle.mass / len(feet)
        stiffness = share * STANDARD_GRAVITY / SINKING
        damping = 2.0 * DAMPING * sqrt(share * stiffness)
        load = larger(stiffness * larger(sunk, 0.0) - damping * z * (sunk > 0.0), 0.0)
        hold = -FRICTION * load / sqrt(larger(x * x + y * y, SLIDING**2))
        force = to_body(q_xyzw, stacked([hold * x, hold * y, load]))
        return force.sum(axis=-2), cross(feet, force).sum(axis=-2)
