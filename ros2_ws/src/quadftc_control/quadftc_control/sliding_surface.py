"""What the sliding-mode controllers share: tracking errors, the sat function, and the inverse dynamics.

Equations (36)-(45) of Wang, Huang and Zhang (2021) with x1 = Euler angles. The paper takes x1' = x2 = body
rate, its small-angle kinematics (5). Here x1' = E(x1) x2 is the full kinematics (4), and the law asks for
x1''; the body acceleration that gives it follows from differentiating (4). At zero angles this is the paper's
law, term by term.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_model.arrays import Vector, clip
from quadftc_model.rigid_body import gyroscopic_acceleration
from quadftc_model.rotations import body_acceleration, euler_from_quaternion, euler_rates, wrap
from quadftc_model.samples import ControllerInputs
from quadftc_model.vehicle import Vehicle


class Tracking(NamedTuple):
    """Where the attitude is, and how far off."""

    x1: Vector  # Euler angles [rad]
    x1_dot: Vector  # [rad/s]
    x1e: Vector  # error (37) [rad]
    x1e_dot: Vector  # [rad/s]


def tracking(inputs: ControllerInputs) -> Tracking:
    """Tracking error (37) and its derivative."""
    x1 = euler_from_quaternion(inputs.imu.q_xyzw)
    x1_dot = euler_rates(x1, inputs.imu.body_rate)
    return Tracking(x1, x1_dot, wrap(x1 - inputs.reference.angles), x1_dot - inputs.reference.rates)


def sat(S: Vector, phi: Vector) -> Vector:
    """Saturation (41) of each component of S (..., 3) with boundary layers phi (3,).

    S / phi inside, sign(S) outside.
    """
    return clip(S / phi, -1.0, 1.0)


def torque_for(
    vehicle: Vehicle, inputs: ControllerInputs, track: Tracking, x1_ddot: Vector, d_hat: Vector
) -> Vector:
    """Torque [N m] (..., 3) that gives x1'' [rad/s²]: B_u^-1 (x1'' - f(x2) - d^) of (45)."""
    omega_dot = body_acceleration(track.x1, track.x1_dot, x1_ddot)
    f_x2 = gyroscopic_acceleration(vehicle.inertia, inputs.imu.body_rate)
    return vehicle.inertia * (omega_dot - f_x2 - d_hat)
