r"""What the accelerometer knows of the tilt.

Turned to earth axes, the specific force f is gravity and the acceleration of the vehicle. A tilt that is off
by a rotation delta (body axes) adds to it:

    (R f)_xy / g = u' + H delta,   H = (-r_y, r_x)         u = v / g, velocity; r_x, r_y: rows of R

At an instant u' hides any tilt. Over seconds it does not, as a velocity is bounded (Laidig and Seel 2023
average the specific force in earth axes for the same reason). `coasting` uses it while roll or pitch is
faulty. Here E[u²] is followed all the time; and while the attitude is healthy, by how much gravity is off
over seconds: by the bias of the accelerometer, or as the vehicle accelerates for long.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_model import arrays
from quadftc_model.arrays import (
    Column,
    Flag,
    Float,
    Quaternion,
    Scalar,
    Vector,
    column,
    exp,
    larger,
    namespace,
    where,
)
from quadftc_model.rotations import to_body, to_earth
from quadftc_model.samples import STANDARD_GRAVITY

LEAK = 0.5  # s; changes of velocity that are faster count as motion
RISE, FADE = 0.1, 5.0  # s; how fast their mean square grows and falls
LEAST = 0.1 / STANDARD_GRAVITY  # s; of u, 1 sigma at least: 0.1 m/s
SLOW, LEARNED = 5.0, 10.0  # s; averaging time of what gravity is off by (twice), and of its mean square
DOUBTED = math.radians(0.5)  # rad; what it is off by, at the start
WEIGHTLESS = 0.1  # 1; share of gravity below which a specific force says nothing of the tilt
X, Y = np.eye(3)[:2]  # axes of the earth

Horizontal = Float[arrays.AnyArray, "*batch 2"]  # components along the earth's x and y axes


class Gravity(NamedTuple):
    """What is known of the specific force."""

    moving: Horizontal  # u without its slow changes [s]
    motion: Column  # its mean square [s²]
    mean: Horizontal  # average of u', and its average: what gravity is off by [rad]
    smooth: Horizontal
    off: Column  # its mean square [rad²]


def start_gravity(zeros: Vector) -> Gravity:
    """Start with nothing known."""
    zero, none = zeros[..., :1], zeros[..., :2]
    return Gravity(none, zero + LEAST**2, none, none, zero + DOUBTED**2)


def feel(
    state: Gravity, q_xyzw: Quaternion, force: Vector, there: Flag, trusted: Flag, dt: Scalar
) -> tuple[Gravity, Horizontal, Flag]:
    """Turn a specific force [m/s²] to earth axes; learn what it is while the tilt is ``trusted``.

    Also return its horizontal part over g, and whether it is ``there`` and says something of the tilt.
    """
    there = there & ((force * force).sum(axis=-1) > (WEIGHTLESS * STANDARD_GRAVITY) ** 2)
    felt = where(column(there), to_earth(q_xyzw, force)[..., :2] / STANDARD_GRAVITY, 0.0)
    moving = exp(-dt / LEAK) * (state.moving + dt * felt)
    change = (moving * moving).sum(axis=-1, keepdims=True) - state.motion
    gain = 1.0 - exp(-dt / where(change > 0.0, RISE, FADE))
    motion = larger(state.motion + gain * change, LEAST**2)
    learns = column(there & trusted)
    slow, learned = learns * (1.0 - exp(-dt / SLOW)), learns * (1.0 - exp(-dt / LEARNED))
    mean = state.mean + slow * (felt - state.mean)
    smooth = state.smooth + slow * (mean - state.smooth)
    off = state.off + learned * (0.5 * (smooth * smooth).sum(axis=-1, keepdims=True) - state.off)
    return Gravity(moving, motion, mean, smooth, off), felt, there


def tilt_matrix(q_xyzw: Quaternion) -> Float[arrays.AnyArray, "*batch 2 3"]:
    """H: what a rotation about the body axes adds to the horizontal specific force over g."""
    r_x, r_y = to_body(q_xyzw, X), to_body(q_xyzw, Y)
    return namespace(q_xyzw).stack([-r_y, r_x], axis=-2)
