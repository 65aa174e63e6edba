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
    Flag,
    Float,
    Quaternion,
    Scalar,
    Vector,
    cache_numbers,
    components,
    exp,
    larger,
    namespace,
    pick,
)
from quadftc_model.rotations import to_body, turned
from quadftc_model.samples import STANDARD_GRAVITY

LEAK = 0.5  # s; changes of velocity that are faster count as motion
RISE, FADE = 0.1, 5.0  # s; how fast their mean square grows and falls
LEAST = 0.1 / STANDARD_GRAVITY  # s; of u, 1 sigma at least: 0.1 m/s
SLOW, LEARNED = 5.0, 10.0  # s; averaging time of what gravity is off by (twice), and of its mean square
DOUBTED = math.radians(0.5)  # rad; what it is off by, at the start
WEIGHTLESS = 0.1  # 1; share of gravity below which a specific force says nothing of the tilt
X, Y = np.eye(3)[:2]  # axes of the earth

Horizontal = tuple[Scalar, Scalar]  # components along the earth's x and y axes


class Gravity(NamedTuple):
    """What is known of the specific force."""

    moving: Horizontal  # u without its slow changes [s]
    motion: Scalar  # its mean square [s²]
    mean: Horizontal  # average of u', and its average: what gravity is off by [rad]
    smooth: Horizontal
    off: Scalar  # its mean square [rad²]


class AveragingGains(NamedTuple):
    """Gains of one step."""

    leak: float  # what is left of u
    rise: float  # of a square in `motion`
    fade: float
    slow: float  # of a sample in `mean` and `smooth`
    learned: float  # of a square in `off`


@cache_numbers
def averaging_gains(dt: float) -> AveragingGains:
    """Gains for a step ``dt`` [s]."""
    return AveragingGains(exp(-dt / LEAK), *(1.0 - exp(-dt / time) for time in (RISE, FADE, SLOW, LEARNED)))


def start_gravity(zeros: Vector) -> Gravity:
    """Start with nothing known."""
    zero = components(zeros)[0]
    none = zero, zero
    return Gravity(none, zero + LEAST**2, none, none, zero + DOUBTED**2)


def feel(
    state: Gravity, q_xyzw: Quaternion, force: Vector, there: Flag, trusted: Flag, dt: float
) -> tuple[Gravity, Horizontal, Flag]:
    """Turn a specific force [m/s²] to earth axes; learn what it is while the tilt is ``trusted``.

    Also return its horizontal part over g, and whether it is ``there`` and says something of the tilt.
    """
    x, y, z = turned(components(q_xyzw), components(force))
    there = there & (x * x + y * y + z * z > (WEIGHTLESS * STANDARD_GRAVITY) ** 2)
    unit = pick(there, 1.0 / STANDARD_GRAVITY, 0.0)
    x, y, gains = unit * x, unit * y, averaging_gains(dt)
    u, v = gains.leak * (state.moving[0] + dt * x), gains.leak * (state.moving[1] + dt * y)
    change = u * u + v * v - state.motion
    motion = larger(state.motion + pick(change > 0.0, gains.rise, gains.fade) * change, LEAST**2)
    learns = pick(there & trusted, 1.0, 0.0)
    slow, learned = learns * gains.slow, learns * gains.learned
    (a, b), (c, d) = state.mean, state.smooth
    a, b = a + slow * (x - a), b + slow * (y - b)
    c, d = c + slow * (a - c), d + slow * (b - d)
    off = state.off + learned * (0.5 * (c * c + d * d) - state.off)
    return Gravity((u, v), motion, (a, b), (c, d), off), (x, y), there


def tilt_matrix(q_xyzw: Quaternion) -> Float[arrays.AnyArray, "*batch 2 3"]:
    """H: what a rotation about the body axes adds to the horizontal specific force over g."""
    r_x, r_y = to_body(q_xyzw, X), to_body(q_xyzw, Y)
    return namespace(q_xyzw).stack([-r_y, r_x], axis=-2)
