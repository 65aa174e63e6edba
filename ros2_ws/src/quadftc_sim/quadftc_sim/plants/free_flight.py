"""A multirotor in free flight: six degrees of freedom, rotors with lag and limits, drag, wind and ground.

    p' = v,    m v' = R F - m g e3 + F_ground,    q' = q (omega, 0) / 2
    J omega' = -omega x (J omega + h e3) - k_d omega + M + tau_d,    T_m speed' = wanted - speed

F and M are the sums over the rotors i, at (x_i, y_i), of thrust k speed², of its torque about x and y, of the
reaction torque, of J_r speed', and of the rotor drag (Furrer et al. 2016, RotorS), and the drag of the body:

    F_x,y = -c_r sum_i speed_i u_x,y - rho/2 A_x,y |u_x,y| u_x,y,    u = R^T (v - wind)

and h = J_r sum_i +-speed_i. Rotor drag acts at the centre of mass; its torque is part of ``rotational_drag``.
Earth axes are east, north, up. Runge-Kutta of order 4 over floats for one vehicle: many times faster than
over arrays of three.

The effectiveness of a faulty rotor (`quadftc_sim.rotor_fault`) multiplies its thrust, its reaction torque and
its drag. Its unbalance adds a force unbalance * speed² that turns with it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import (
    Array,
    Components,
    Vector,
    column,
    components,
    larger,
    namespace,
    stacked,
)
from quadftc_model.rigid_body import rk4
from quadftc_model.rotations import normalise, turned
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_sim.flying_plant import FaultyRotors, FlightState, FlyingPlant, Parts, inverse, sum_of, total
from quadftc_sim.plant import register

SINKING = 0.01  # m; how far the feet sink under the weight
DAMPING = 0.7  # 1; damping ratio of the ground
FRICTION, SLIDING = 0.6, 0.05  # 1; Coulomb friction, full from this speed [m/s] on


class _Loads(NamedTuple):
    """What acts on the vehicle at an instant."""

    force: Parts  # without gravity [N], body axes
    angular_acceleration: Parts  # [rad/s²], body axes


class _RotorFaults(NamedTuple):
    """What is wrong with the rotors, rotor by rotor."""

    effectiveness: Parts  # [1]
    unbalance: Parts  # [kg m]
    angles: Parts  # [rad]


@register("free_flight")
class FreeFlight(FlyingPlant):
    """A vehicle that flies through air and wind."""

    @functools.cached_property
    def _arms(self) -> Array:
        """Places of the rotors by axis, (2, n) [m]."""
        return np.ascontiguousarray(self.vehicle.rotors.positions.T)

    @functools.cached_property
    def _reach(self) -> float:
        """Height above which no foot touches the ground [m]."""
        return float(np.max(np.sqrt(np.sum(self.feet**2, axis=1))))

    def step(self, state: FlightState, command: Components, time: float, dt: float) -> FlightState:
        """Advance by ``dt`` [s] from scenario time ``time`` [s] under rotor speeds [rad/s] (..., n), held."""
        wanted = components(self.speeds_wanted(state, command))
        motion: list[Any] = [part for array in state[:4] for part in components(array)]
        speeds = components(state.speeds) if self.motor_lag else wanted
        derivative = self._derivative(wanted, len(motion), state.rotors)
        step, parts = dt / self.substeps, (*motion, *speeds)
        if (rotors := state.rotors) is not None:
            parts = (*parts, *components(rotors.angle))
        for index in range(self.substeps):
            parts = rk4(derivative, time + index * step, parts, step)
        position, velocity, q, rate = (stacked(parts[a:b]) for a, b in ((0, 3), (3, 6), (6, 10), (10, 13)))
        end = 13 + len(wanted)
        if rotors is not None:
            rotors = rotors._replace(angle=stacked(parts[end:]))
        return FlightState(position, velocity, normalise(q), rate, stacked(parts[13:end]), rotors)

    def specific_force(self, state: FlightState, time: float) -> Vector:
        """What an ideal accelerometer measures at the place of the IMU [m/s²]."""
        parts = tuple(components(array) for array in state[:5])
        still = [0.0 * speed for speed in parts[4]]
        faults = None if state.rotors is None else _faults_of(state.rotors)
        loads = self._loads(parts, still, *self._weather(time), faults)
        force = [each / self.vehicle.mass for each in loads.force]
        place, omega = self.vehicle.aerodynamics.imu_position, parts[3]
        if namespace(place) is not np or place.any():  # in a batch its numbers may not be known yet
            arm = components(place)
            turning = _cross(loads.angular_acceleration, arm)
            inward = _cross(omega, _cross(omega, arm))
            force = [f + a + b for f, a, b in zip(force, turning, inward, strict=True)]
        return stacked(force)

    def _derivative(
        self, wanted: Parts, first: int, rotors: FaultyRotors | None
    ) -> Callable[[float, tuple[Any, ...]], tuple[Any, ...]]:
        """Derivative of all components of the motion (``first`` of them), and of the rotors.

        Those are the speeds and, of rotors that may be faulty, the angles.
        """
        end = first + len(wanted)
        faults = None if rotors is None else _faults_of(rotors)
        spins = components(self.vehicle.rotors.spin_sign)

        def derivative(time: float, parts: tuple[Any, ...]) -> tuple[Any, ...]:
            velocity, q, omega, speeds = parts[3:6], parts[6:10], parts[10:13], parts[first:end]
            if self.motor_lag:
                spin_up = [(w - s) / self.motor_time_constant for w, s in zip(wanted, speeds, strict=True)]
            else:
                spin_up = [0.0 * s for s in speeds]
            now = None if faults is None else faults._replace(angles=parts[end:])
            turning = [] if faults is None else [a * b for a, b in zip(spins, speeds, strict=True)]
            loads = self._loads((parts[:3], velocity, q, omega, speeds), spin_up, *self._weather(time), now)
            ax, ay, az = (each / self.vehicle.mass for each in turned(q, loads.force))
            x, y, z, w = q
            p, r, s = omega
            q_rate = (
                0.5 * (w * p + y * s - z * r),
                0.5 * (w * r + z * p - x * s),
                0.5 * (w * s + x * r - y * p),
                -0.5 * (x * p + y * r + z * s),
            )
            acceleration = (ax, ay, az - STANDARD_GRAVITY)
            return (*velocity, *acceleration, *q_rate, *loads.angular_acceleration, *spin_up, *turning)

        return derivative

    def _loads(
        self,
        parts: Sequence[Parts],
        spin_up: Parts,
        air: Parts,
        disturbance: Parts,
        faults: _RotorFaults | None = None,
    ) -> _Loads:
        """Force and angular acceleration at an instant; ``parts`` are those of `FlightState`."""
        position, velocity, q, omega, speeds = parts
        effectiveness = None if faults is None else faults.effectiveness
        thrust, *turning, momentum = self._rotors(speeds, spin_up, effectiveness)
        dragging = speeds if effectiveness is None else _times(effectiveness, speeds)
        fx, fy, fz = self._drag(q, velocity, air, total(dragging))
        damping = [-k * w for k, w in zip(components(self.vehicle.rotational_drag), omega, strict=True)]
        forces, torques = [(fx, fy, fz + thrust)], [turning, damping, disturbance]
        if faults is not None:
            shaking, yawing = self._shaking(speeds, faults.unbalance, faults.angles)
            forces, torques = [*forces, shaking], [*torques, (0.0, 0.0, yawing)]
        height = position[2]
        if self.ground and not (isinstance(height, float) and height > self._reach):
            carried = self._carry(position, velocity, q, omega)
            forces, torques = [*forces, carried[0]], [*torques, carried[1]]
        (jx, jy, jz), (p, r, s) = components(self.inertia), omega
        force, (tx, ty, tz) = sum_of(forces), sum_of(torques)
        accelerations = (
            (tx + (jy - jz) * r * s - r * momentum) / jx,
            (ty + (jz - jx) * p * s + p * momentum) / jy,
            (tz + (jx - jy) * p * r) / jz,
        )
        return _Loads(force, accelerations)

    def _rotors(self, speeds: Parts, spin_up: Parts, effectiveness: Parts | None) -> Parts:
        """Thrust [N], torque (3) [N m] and angular momentum [N m s] of the rotors, body axes."""
        rotors = self.vehicle.rotors
        thrusts = [rotors.thrust_coefficient * speed * speed for speed in speeds]
        if effectiveness is not None:
            thrusts = _times(effectiveness, thrusts)
        x, y, spin = components(self._arms[0]), components(self._arms[1]), components(rotors.spin_sign)
        reaction = rotors.torque_to_thrust * _weighted(components(rotors.yaw_sign), thrusts)
        return (
            total(thrusts),
            _weighted(y, thrusts),
            -_weighted(x, thrusts),
            reaction - rotors.rotor_inertia * _weighted(spin, spin_up),
            rotors.rotor_inertia * _weighted(spin, speeds),
        )

    def _carry(self, position: Parts, velocity: Parts, q: Parts, omega: Parts) -> tuple[Parts, Parts]:
        """Force [N] and torque [N m] of the ground on the feet, body axes."""
        # a foot that is `sunk` is pushed up by a spring and a damper, and held by friction; (..., feet)
        share = self.vehicle.mass / len(self.feet)
        stiffness = share * STANDARD_GRAVITY / SINKING
        damping = 2.0 * DAMPING * (share * stiffness) ** 0.5
        foot = [self.feet[:, axis] for axis in range(3)]
        q, omega, velocity = ([column(each) for each in parts] for parts in (q, omega, velocity))
        sunk = -column(position[2]) - turned(q, foot)[2]
        moving = [v + w for v, w in zip(velocity, turned(q, _cross(omega, foot)), strict=True)]
        load = larger(stiffness * larger(sunk, 0.0) - damping * moving[2] * (sunk > 0.0), 0.0)
        sliding = namespace(sunk).sqrt(larger(moving[0] ** 2 + moving[1] ** 2, SLIDING**2))
        hold = -FRICTION * load / sliding
        force = turned(inverse(q), (hold * moving[0], hold * moving[1], load))
        return [each.sum(axis=-1) for each in force], [each.sum(axis=-1) for each in _cross(foot, force)]


def _faults_of(rotors: FaultyRotors) -> _RotorFaults:
    condition = rotors.condition
    return _RotorFaults(
        components(condition.effectiveness), components(condition.unbalance), components(rotors.angle)
    )


def _times(weights: Parts, parts: Parts) -> Parts:
    return [weight * part for weight, part in zip(weights, parts, strict=True)]


def _weighted(weights: Parts, parts: Parts) -> Any:
    return total(_times(weights, parts))


def _cross(a: Parts, b: Parts) -> Parts:
    (ax, ay, az), (bx, by, bz) = a, b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
