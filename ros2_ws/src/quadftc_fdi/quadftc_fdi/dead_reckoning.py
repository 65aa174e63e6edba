"""Dead reckoning: the gyro carries the attitude on; where it can be compared in Euler angles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quadftc_model.arrays import AnyArray, Quaternion, Vector, is_single, namespace
from quadftc_model.rotations import normalise, quaternion_from_rotation_vector, quaternion_product

if TYPE_CHECKING:
    from jaxtyping import Bool

MAX_PITCH = math.radians(80.0)  # rad; steeper, roll and yaw are not defined well enough to be compared


def dead_reckon(q_xyzw: Quaternion, rate: Vector, next_rate: Vector, dt: float) -> Quaternion:
    """Attitude after ``dt`` [s] on the mean of two body rates [rad/s]; of order 2."""
    turn = quaternion_from_rotation_vector(0.5 * dt * (rate + next_rate))
    return normalise(quaternion_product(q_xyzw, turn))


def comparable(angles: Vector, others: Vector) -> Bool[AnyArray, "*batch 1"]:
    """Whether two attitudes, in Euler angles [rad], are both away from 90 deg of pitch."""
    if is_single(angles) and is_single(others):
        (_, pitch, _), (_, other, _) = angles.tolist(), others.tolist()
        return np.array([abs(pitch) < MAX_PITCH and abs(other) < MAX_PITCH])
    xp = namespace(angles)
    steeper = xp.maximum(xp.abs(angles[..., 1:2]), xp.abs(others[..., 1:2]))
    return steeper < MAX_PITCH
