"""Attitude carried on by the gyro, and its difference from the measured one in Euler angles."""

from __future__ import annotations

import math

import numpy as np

from quadftc_model.arrays import Array, components, is_single, namespace
from quadftc_model.rotations import normalise, quaternion_from_rotation_vector, quaternion_product

MAX_PITCH = math.radians(80.0)  # rad; steeper, roll and yaw are not defined well enough to be compared


def dead_reckoned(q_xyzw: Array, rate: Array, next_rate: Array, dt: float) -> Array:
    """Attitude (..., 4) after ``dt`` [s] on the mean of two body rates [rad/s]; of order 2."""
    turn = quaternion_from_rotation_vector(0.5 * dt * (rate + next_rate))
    return normalise(quaternion_product(q_xyzw, turn))


def comparable(angles: Array, others: Array) -> Array:
    """Whether two attitudes, Euler angles (..., 3), are both away from 90 deg of pitch: bool (..., 1)."""
    if is_single(angles) and is_single(others):
        (_, pitch, _), (_, other, _) = angles.tolist(), others.tolist()
        return np.array([abs(pitch) < MAX_PITCH and abs(other) < MAX_PITCH])
    xp = namespace(angles)
    steeper = xp.maximum(xp.abs(angles[..., 1:2]), xp.abs(others[..., 1:2]))
    return steeper < MAX_PITCH


def kinematic_matrices(angles: Array, body_rate: Array) -> tuple[Array, Array]:
    """E of (4) of Wang et al. (2021), x' = E(x) omega, and the Jacobian of E(x) omega by x.

    With pitch kept within ``MAX_PITCH``, so that both are bounded.

    Parameters
    ----------
    angles, body_rate : array (..., 3)
        [rad], [rad/s].

    Returns
    -------
    E, Jacobian : array (..., 3, 3)
        [1], [1/s].
    """
    xp = namespace(angles)
    phi, theta, _ = components(xp.minimum(xp.maximum(angles, -MAX_PITCH), MAX_PITCH))
    phi = components(angles)[0]
    _, q, r = components(body_rate)
    s, c, t, sec = xp.sin(phi), xp.cos(phi), xp.tan(theta), 1.0 / xp.cos(theta)
    across = s * q + c * r  # cos(theta) psi'
    theta_dot = c * q - s * r
    one, zero = xp.ones_like(s), xp.zeros_like(s)
    E = [one, s * t, c * t, zero, c, -s, zero, s * sec, c * sec]
    J = [
        t * theta_dot,
        sec * sec * across,
        zero,
        -across,
        zero,
        zero,
        sec * theta_dot,
        sec * t * across,
        zero,
    ]
    shape = (*angles.shape[:-1], 3, 3)
    return xp.stack(E, axis=-1).reshape(shape), xp.stack(J, axis=-1).reshape(shape)
