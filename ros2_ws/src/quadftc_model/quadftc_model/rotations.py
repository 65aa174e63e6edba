"""Rotations: unit quaternions (x, y, z, w order, body to earth) and Euler angles (roll, pitch, yaw; Z-Y-X).

Frames follow REP-103: the body is FLU (x forward, y left, z up), the earth ENU. All functions take and give
arrays whose last axis holds the components, with any leading axes, in NumPy or another array library.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from quadftc_model.arrays import (
    Array,
    Quaternion,
    Scalar,
    Vector,
    arcsin,
    arctan2,
    clip,
    components,
    cos,
    larger,
    namespace,
    norm,
    sin,
    stacked,
    where,
)

_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
MIN_COS_PITCH = 1e-6  # 1; the Euler rates of (4) are bounded by this close to +-90 deg of pitch


def wrap(angle: Scalar) -> Array:
    """Wrap angles [rad] into [-pi, pi]; angles inside already are returned unchanged, bit for bit."""
    return angle - 2.0 * math.pi * namespace(angle).rint(angle / (2.0 * math.pi))


def quaternion_from_euler(angles: Vector) -> Quaternion:
    """Unit quaternion q_xyzw (..., 4) of the Euler angles [rad] (..., 3): R = Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, cp, cy = components(cos(0.5 * angles))
    sr, sp, sy = components(sin(0.5 * angles))
    return stacked(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def euler_from_quaternion(q_xyzw: Quaternion) -> Vector:
    """Euler angles [rad] (..., 3) of unit quaternions (..., 4); roll and yaw within pi, pitch within pi/2."""
    x, y, z, w = components(q_xyzw)
    return stacked(
        [
            arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            arcsin(clip(2.0 * (w * y - z * x), -1.0, 1.0)),
            arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        ]
    )


def quaternion_product(p_xyzw: Quaternion, q_xyzw: Quaternion) -> Quaternion:
    """Hamilton product p q (..., 4): first the rotation q, then p."""
    px, py, pz, pw = components(p_xyzw)
    qx, qy, qz, qw = components(q_xyzw)
    return stacked(
        [
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
            pw * qw - px * qx - py * qy - pz * qz,
        ]
    )


def quaternion_rate(q_xyzw: Quaternion, body_rate: Vector) -> Quaternion:
    """Time derivative (..., 4) of a quaternion at body rate [rad/s] (..., 3): q' = q (omega, 0) / 2."""
    x, y, z, w = components(q_xyzw)
    p, q, r = components(body_rate)
    return 0.5 * stacked(
        [w * p + y * r - z * q, w * q - x * r + z * p, w * r + x * q - y * p, -x * p - y * q - z * r]
    )


def quaternion_from_rotation_vector(rotation_vector: Vector) -> Quaternion:
    """Unit quaternion (..., 4) of a rotation vector [rad] (..., 3); exactly (0, 0, 0, 1) for zero."""
    half_angle = 0.5 * norm(rotation_vector)
    zero = half_angle == 0.0
    safe = where(zero, 1.0, half_angle)
    vector = 0.5 * rotation_vector * where(zero, 1.0, sin(safe) / safe)
    return namespace(vector).concatenate([vector, where(zero, 1.0, cos(safe))], axis=-1)


def normalise(q_xyzw: Quaternion) -> Quaternion:
    """Quaternion (..., 4) scaled to unit length; it must not be zero."""
    return q_xyzw / norm(q_xyzw)


def turn(q_xyzw: Quaternion, rotation_vector: Vector) -> Quaternion:
    """Unit quaternion (..., 4) turned further by a rotation vector in body axes [rad] (..., 3)."""
    return normalise(quaternion_product(q_xyzw, quaternion_from_rotation_vector(rotation_vector)))


def rotation_between(p_xyzw: Quaternion, q_xyzw: Quaternion) -> Vector:
    """Rotation vector [rad] (..., 3) that turns a unit quaternion (..., 4) into another; at most pi long."""
    difference = quaternion_product(p_xyzw * _CONJUGATE, q_xyzw)
    vector, w = difference[..., :3], difference[..., 3:]
    sine = norm(vector)
    zero = sine == 0.0
    angle = 2.0 * arctan2(sine, abs(w))
    return vector * where(zero, 2.0, where(w < 0.0, -angle, angle) / where(zero, 1.0, sine))


def turned(q: Sequence[Array], vector: Sequence[Array]) -> list[Array]:
    """Components of a vector turned by a unit quaternion (a, w): v + 2 w a x v + 2 a x (a x v)."""
    x, y, z, w = q
    a, b, c = vector
    p, r, s = y * c - z * b, z * a - x * c, x * b - y * a
    return [
        a + 2.0 * (w * p + (y * s - z * r)),
        b + 2.0 * (w * r + (z * p - x * s)),
        c + 2.0 * (w * s + (x * r - y * p)),
    ]


def earth_z_in_body(q_xyzw: Quaternion) -> Vector:
    """The earth's vertical in body axes (..., 3): the third row of the rotation matrix body to earth."""
    x, y, z, w = components(q_xyzw)
    return stacked([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])


def to_earth(q_xyzw: Quaternion, vector: Vector) -> Vector:
    """Turn a vector (..., 3) from body to earth axes."""
    return stacked(turned(components(q_xyzw), components(vector)))


def to_body(q_xyzw: Quaternion, vector: Vector) -> Vector:
    """Turn a vector (..., 3) from earth to body axes."""
    x, y, z, w = components(q_xyzw)
    return stacked(turned((x, y, z, -w), components(vector)))


def euler_rates(angles: Vector, body_rate: Vector) -> Vector:
    """Euler angle rates [rad/s] (..., 3) of a body rate [rad/s] (..., 3): (4) of Wang et al. (2021).

    Finite at every attitude: the cosine of pitch is kept ``MIN_COS_PITCH`` away from zero.
    """
    (c_phi, c_theta, _), (s_phi, s_theta, _) = components(cos(angles)), components(sin(angles))
    p, q, r = components(body_rate)
    bounded = where(c_theta < 0.0, -1.0, 1.0) * larger(abs(c_theta), MIN_COS_PITCH)
    psi_dot = (s_phi * q + c_phi * r) / bounded
    return stacked([p + s_theta * psi_dot, c_phi * q - s_phi * r, psi_dot])


def body_rates(angles: Vector, angle_rates: Vector) -> Vector:
    """Body rate [rad/s] (..., 3) of Euler angle rates (..., 3): the inverse of :func:`euler_rates`."""
    (c_phi, c_theta, _), (s_phi, s_theta, _) = components(cos(angles)), components(sin(angles))
    phi_dot, theta_dot, psi_dot = components(angle_rates)
    across = c_theta * psi_dot
    return stacked(
        [phi_dot - s_theta * psi_dot, c_phi * theta_dot + s_phi * across, c_phi * across - s_phi * theta_dot]
    )


def body_acceleration(angles: Vector, angle_rates: Vector, angle_accelerations: Vector) -> Vector:
    """Angular acceleration in body axes [rad/s²] (..., 3): the time derivative of :func:`body_rates`."""
    (c_phi, c_theta, _), (s_phi, s_theta, _) = components(cos(angles)), components(sin(angles))
    phi_dot, theta_dot, psi_dot = components(angle_rates)
    across = c_theta * psi_dot
    q = c_phi * theta_dot + s_phi * across
    r = c_phi * across - s_phi * theta_dot
    lean = s_theta * theta_dot * psi_dot
    convective = stacked(
        [-c_theta * theta_dot * psi_dot, phi_dot * r - s_phi * lean, -phi_dot * q - c_phi * lean]
    )
    return body_rates(angles, angle_accelerations) + convective
