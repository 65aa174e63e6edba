"""Rotations: unit quaternions (x, y, z, w order, body to earth) and Euler angles (roll, pitch, yaw; Z-Y-X).

Frames follow REP-103: the body is FLU (x forward, y left, z up), the earth ENU. All functions take and give
arrays whose last axis holds the components, with any leading axes, in NumPy or another array library.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from quadftc_model import arrays
from quadftc_model.arrays import Quaternion, Scalar, Vector, clip, components, is_single, namespace, stacked

_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
MIN_COS_PITCH = 1e-6  # 1; the Euler rates of (4) are bounded by this close to +-90 deg of pitch


def wrap(angle: Scalar) -> Any:
    """Wrap angles [rad] into [-pi, pi]; angles inside already are returned unchanged, bit for bit."""
    if isinstance(angle, float):
        return math.remainder(angle, 2.0 * math.pi)
    xp = namespace(angle)
    return angle - 2.0 * math.pi * xp.rint(angle / (2.0 * math.pi))


def quaternion_from_euler(angles: Vector) -> Quaternion:
    """Unit quaternion q_xyzw (..., 4) of the Euler angles [rad] (..., 3): R = Rz(yaw) Ry(pitch) Rx(roll)."""
    xp = namespace(angles)
    half = 0.5 * angles
    cr, cp, cy = components(xp.cos(half))
    sr, sp, sy = components(xp.sin(half))
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
    xp = namespace(q_xyzw)
    arctan2, arcsin = (math.atan2, math.asin) if isinstance(x, float) else (xp.arctan2, xp.arcsin)
    return stacked(
        [
            arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            arcsin(clip(2.0 * (w * y - z * x), -1.0, 1.0)),
            arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        ]
    )


def quaternion_product(p_xyzw: Quaternion, q_xyzw: Quaternion) -> Quaternion:
    """Hamilton product p q (..., 4): first the rotation q, then p."""
    return stacked(_product(components(p_xyzw), components(q_xyzw)))


def _product(p: Sequence[Any], q: Sequence[Any]) -> list[Any]:
    px, py, pz, pw = p
    qx, qy, qz, qw = q
    return [
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    ]


def quaternion_rate(q_xyzw: Quaternion, body_rate: Vector) -> Quaternion:
    """Time derivative (..., 4) of a quaternion at body rate [rad/s] (..., 3): q' = q (omega, 0) / 2."""
    x, y, z, w = components(q_xyzw)
    p, q, r = components(body_rate)
    return 0.5 * stacked(
        [w * p + y * r - z * q, w * q - x * r + z * p, w * r + x * q - y * p, -x * p - y * q - z * r]
    )


def quaternion_from_rotation_vector(rotation_vector: Vector) -> Quaternion:
    """Unit quaternion (..., 4) of a rotation vector [rad] (..., 3); exactly (0, 0, 0, 1) for zero."""
    if is_single(rotation_vector):
        return np.array(_turned_by(rotation_vector.tolist()))
    xp = namespace(rotation_vector)
    half_angle = 0.5 * arrays.norm(rotation_vector)
    zero = half_angle == 0.0
    safe = xp.where(zero, 1.0, half_angle)
    cosine = xp.where(zero, 1.0, xp.cos(safe))
    return xp.concatenate([0.5 * rotation_vector * xp.where(zero, 1.0, xp.sin(safe) / safe), cosine], axis=-1)


def _turned_by(rotation_vector: list[float]) -> list[float]:
    x, y, z = rotation_vector
    half = 0.5 * math.sqrt(x * x + y * y + z * z)
    if not half < math.inf:  # not a number, as with arrays
        return [math.nan] * 4
    scale = 0.5 * math.sin(half) / half if half > 0.0 else 0.5
    return [x * scale, y * scale, z * scale, math.cos(half)]


def normalise(q_xyzw: Quaternion) -> Quaternion:
    """Quaternion (..., 4) scaled to unit length; it must not be zero."""
    return _normalised(q_xyzw.tolist()) if is_single(q_xyzw) else q_xyzw / arrays.norm(q_xyzw)


def _normalised(q_xyzw: list[float]) -> Quaternion:
    x, y, z, w = q_xyzw
    length = math.sqrt(x * x + y * y + z * z + w * w) or math.nan
    return np.array([x / length, y / length, z / length, w / length])


def turn(q_xyzw: Quaternion, rotation_vector: Vector) -> Quaternion:
    """Unit quaternion (..., 4) turned further by a rotation vector in body axes [rad] (..., 3)."""
    if is_single(q_xyzw) and is_single(rotation_vector):
        return _normalised(_product(q_xyzw.tolist(), _turned_by(rotation_vector.tolist())))
    return normalise(quaternion_product(q_xyzw, quaternion_from_rotation_vector(rotation_vector)))


def rotation_between(p_xyzw: Quaternion, q_xyzw: Quaternion) -> Vector:
    """Rotation vector [rad] (3,) that turns a unit quaternion (4,) into another; at most pi long."""
    difference = quaternion_product(p_xyzw * _CONJUGATE, q_xyzw)
    x, y, z, w = difference.tolist()
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2.0 * math.atan2(sine, abs(w))
    return difference[:3] * (math.copysign(angle / sine, w) if sine > 0.0 else 2.0)


def turned(q: Sequence[Any], vector: Sequence[Any]) -> list[Any]:
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
    xp = namespace(angles)
    (c_phi, c_theta, _), (s_phi, s_theta, _) = components(xp.cos(angles)), components(xp.sin(angles))
    p, q, r = components(body_rate)
    psi_dot = (s_phi * q + c_phi * r) / away_from_zero(c_theta)
    return stacked([p + s_theta * psi_dot, c_phi * q - s_phi * r, psi_dot])


def body_rates(angles: Vector, angle_rates: Vector) -> Vector:
    """Body rate [rad/s] (..., 3) of Euler angle rates (..., 3): the inverse of :func:`euler_rates`."""
    xp = namespace(angles)
    (c_phi, c_theta, _), (s_phi, s_theta, _) = components(xp.cos(angles)), components(xp.sin(angles))
    phi_dot, theta_dot, psi_dot = components(angle_rates)
    across = c_theta * psi_dot
    return stacked(
        [phi_dot - s_theta * psi_dot, c_phi * theta_dot + s_phi * across, c_phi * across - s_phi * theta_dot]
    )


def body_acceleration(angles: Vector, angle_rates: Vector, angle_accelerations: Vector) -> Vector:
    """Angular acceleration in body axes [rad/s²] (..., 3): the time derivative of :func:`body_rates`."""
    xp = namespace(angles)
    (c_phi, c_theta, _), (s_phi, s_theta, _) = components(xp.cos(angles)), components(xp.sin(angles))
    phi_dot, theta_dot, psi_dot = components(angle_rates)
    across = c_theta * psi_dot
    q = c_phi * theta_dot + s_phi * across
    r = c_phi * across - s_phi * theta_dot
    lean = s_theta * theta_dot * psi_dot
    convective = stacked(
        [-c_theta * theta_dot * psi_dot, phi_dot * r - s_phi * lean, -phi_dot * q - c_phi * lean]
    )
    return body_rates(angles, angle_accelerations) + convective


def away_from_zero(cosine: Scalar) -> Scalar:
    """Keep the cosine of pitch (...) ``MIN_COS_PITCH`` away from zero."""
    if isinstance(cosine, float):
        return (-1.0 if cosine < 0.0 else 1.0) * max(abs(cosine), MIN_COS_PITCH)
    xp = namespace(cosine)
    sign = xp.where(cosine < 0.0, -1.0, 1.0)
    return sign * xp.maximum(xp.abs(cosine), MIN_COS_PITCH)
