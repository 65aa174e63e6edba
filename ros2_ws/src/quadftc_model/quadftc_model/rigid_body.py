"""The rigid body of the multirotor: rotor torques, propeller gyroscopics, drag and disturbances turn it.

Equations (1) and (2) of Wang et al. (2021), derived again with every torque divided by the inertia (their (3)
leaves two of them undivided); and the integrator of such equations.
"""

from __future__ import annotations

from collections.abc import Callable

from quadftc_model.arrays import Array, Components, Scalar, Vector, components, stacked
from quadftc_model.rotors import propeller_speeds
from quadftc_model.vehicle import Vehicle

State = tuple[Array, ...]
Derivative = Callable[[float, State], State]  # of (time, state)


def gyroscopic_acceleration(inertia: Vector, body_rate: Vector) -> Vector:
    """Acceleration by the body's own rotation, -J^-1 (omega x J omega) [rad/s²] (..., 3).

    It is D f(x) of (6), and f(x2) of (36), at principal moments (3,) [kg m²] and a body rate [rad/s].
    """
    jx, jy, jz = components(inertia)
    p, q, r = components(body_rate)
    return stacked([(jy - jz) / jx * q * r, (jz - jx) / jy * p * r, (jx - jy) / jz * p * q])


def propeller_momentum(vehicle: Vehicle, commands: Components) -> Scalar:
    """Angular momentum of the propellers about their common axis [N m s] (...), of rotor commands (..., n).

    The sum of the second term of (2). It takes each rotor's sign from the sense in which it spins. With the
    paper's (-1)^(i+1) rotors 1 and 2 would spin in opposite senses, against its text and its yaw torque.
    """
    rotors = vehicle.rotors
    return rotors.rotor_inertia * (propeller_speeds(vehicle, commands) @ rotors.spin_sign)


def propeller_torque(body_rate: Vector, momentum: Scalar) -> Vector:
    """Gyroscopic torque [N m] (..., 3) of propellers of a momentum [N m s] (...): second term of (2)."""
    p, q, _ = components(body_rate)
    return stacked([-q * momentum, p * momentum, 0.0 * momentum])


def angular_acceleration(
    vehicle: Vehicle, body_rate: Vector, torque: Vector, momentum: Scalar, inertia: Vector | None = None
) -> Vector:
    """Angular acceleration [rad/s²] (..., 3), body frame: (1) with the torques of (2) and a disturbance.

    The drag acts on the body rate. The paper's (2) writes Euler angle rates, the same under its (5); those
    would drive a vehicle that is upside down, and have no bound at 90 deg of pitch.

    ``torque`` [N m] is that of the rotors, by the mixer, and the disturbance. ``momentum`` [N m s] (...) is
    that of the propellers. ``inertia`` [kg m²] (3,) has the principal moments, by default the vehicle's.
    """
    inertia = vehicle.inertia if inertia is None else inertia
    total = torque + propeller_torque(body_rate, momentum) - vehicle.rotational_drag * body_rate
    return gyroscopic_acceleration(inertia, body_rate) + total / inertia


def rk4(derivative: Derivative, time: float, state: State, dt: float) -> State:
    """One step ``dt`` [s] of the classical Runge-Kutta method of order 4, from ``time`` [s] on."""
    half = 0.5 * dt
    k1 = derivative(time, state)
    k2 = derivative(time + half, _shifted(state, k1, half))
    k3 = derivative(time + half, _shifted(state, k2, half))
    k4 = derivative(time + dt, _shifted(state, k3, dt))
    sixth = dt / 6.0
    return tuple(
        x + sixth * (a + 2.0 * (b + c) + d) for x, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)
    )


def _shifted(state: State, slope: State, step: float) -> State:
    return tuple(x + step * k for x, k in zip(state, slope, strict=True))
