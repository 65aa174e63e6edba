r"""The accelerometer as a witness of the tilt, where the attitude sensor is faulty.

Turned to earth axes, the specific force f is gravity and the acceleration of the vehicle. A tilt that is off
by a rotation delta (body axes) adds to it:

    (R f)_xy / g = u' + H delta,   H = (-r_y, r_x)         u = v / g, velocity; r_x, r_y: rows of R

At an instant u' hides any tilt. Over seconds it does not, as a velocity is bounded (Laidig and Seel 2023
average the specific force in earth axes for the same reason). So while roll or pitch is faulty, the filter
has two more states, u, which are measured to be zero:

    predict   u <- u + (R f)_xy / g dt,   error e_u <- e_u - H delta dt
    correct   0 = u + white noise of density `LASTING` E[u²]

E[u²] is followed all the time. While the attitude is healthy it shows how far gravity is off over seconds:
by the bias of the accelerometer, or by a vehicle that accelerates for long. Gravity does not make the tilt
better known than that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_fdi.supervision import inertial_filter
from quadftc_fdi.supervision.measurement import Prediction
from quadftc_fdi.supervision.transition import SIZE, Errors, FilterState, Transition
from quadftc_model import arrays
from quadftc_model.arrays import (
    Array,
    Flag,
    Float,
    Mask,
    Quaternion,
    Scalar,
    Vector,
    cache_numbers,
    changed_where,
    chosen,
    column,
    components,
    exp,
    larger,
    namespace,
    pick,
    product,
    stacked,
)
from quadftc_model.rotations import turned
from quadftc_model.samples import STANDARD_GRAVITY

LEAK = 0.5  # s; changes of velocity that are faster count as motion
RISE, FADE = 0.1, 5.0  # s; how fast their mean square grows and falls
LEAST = 0.1 / STANDARD_GRAVITY  # s; of u, 1 sigma at least: 0.1 m/s
LASTING = 0.1  # s; density of u over its mean square: how long a velocity lasts
SLOW, LEARNED = 5.0, 10.0  # s; averaging time of what gravity is off by (twice), and of its mean square
CLOSE, DOUBTED = math.radians(0.2), math.radians(0.5)  # rad; off by this at least, and at the start
SOON, SMALLEST = 1e-9, 1e-30  # s, rad²; no less, as it divides
WEIGHTLESS = 0.1  # 1; share of gravity below which a specific force says nothing of the tilt
EYE = np.eye(2)

Pair = Float[arrays.AnyArray, "*batch 2"]
Horizontal = tuple[Scalar, Scalar]  # components along the earth's x and y axes


class Velocity(NamedTuple):
    """u, as two more states of the filter."""

    u: Pair  # [s]
    cross: Float[arrays.AnyArray, "*batch 16 2"]  # covariance of the filter's errors and that of u
    uu: Float[arrays.AnyArray, "*batch 2 2"]  # covariance of u [s²]


class Gravity(NamedTuple):
    """What is known of the specific force."""

    moving: Horizontal  # u without its slow changes [s]
    motion: Scalar  # its mean square [s²]
    mean: Horizontal  # average of u', and its average: what gravity is off by [rad]
    smooth: Horizontal
    off: Scalar  # its mean square [rad²]
    velocity: Velocity


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
    zero, pair = components(zeros)[0], zeros[..., :2]
    cross = namespace(zeros).zeros((*zeros.shape[:-1], SIZE, 2))
    none, nothing = (zero, zero), Velocity(pair, cross, cross[..., :2, :])
    return Gravity(none, zero + LEAST**2, none, none, zero + DOUBTED**2, nothing)


def feel(
    state: Gravity, q_xyzw: Quaternion, force: Vector, there: Flag, trusted: Flag, dt: float
) -> tuple[Gravity, Horizontal]:
    """Turn a specific force [m/s²] to earth axes; learn what it is while the tilt is ``trusted``.

    Also return its horizontal part over g, 0 where it is not ``there``.
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
    return Gravity((u, v), motion, (a, b), (c, d), off, state.velocity), (x, y)


def correct_tilt(
    state: Gravity,
    estimate: FilterState,
    dx: Errors,
    horizontal: Horizontal,
    transition: Transition,
    prediction: Prediction,
    factors: inertial_filter.Factors,
    active: Flag,
    begins: Mask,
    dt: float,
) -> tuple[Gravity, FilterState, Errors]:
    """Correct the tilt where ``active``. There ``begins`` (..., 1) says whether u begins at this sample.

    ``dx`` and ``factors`` are those of the attitude's correction in this sample (`inertial_filter.correct`).
    Return dx with what is corrected here.
    """

    def follow(bounded: Array) -> Velocity:
        """Follow the attitude's correction, or begin."""
        xp, before = namespace(factors), state.velocity
        cross = transition.of(before.cross)
        seen = product(product(_t(cross), _t(prediction.H)), factors)
        W, W_u = product(prediction.PH, factors[..., :3]), seen[..., :3]
        return Velocity(
            xp.where(begins, 0.0, before.u + seen[..., 3]),
            xp.where(begins[..., None], 0.0, cross - product(W, _t(W_u))),
            xp.where(begins[..., None], bounded, before.uu - product(W_u, _t(W_u))),
        )

    def correct() -> tuple[Gravity, FilterState, Errors]:
        before, H, bounded = estimate.P, tilt_matrix(estimate.q_xyzw), column(column(state.motion)) * EYE
        u, cross, uu = follow(bounded)
        # predict
        u = (u + dt * stacked(horizontal))[..., None]
        PH, HC = product(before[..., :, :3], _t(H)), product(H, cross[..., :3, :])
        HPH = product(H, PH[..., :3, :])
        uu, cross = uu + dt * (dt * HPH - HC - _t(HC)), cross - dt * PH
        # correct: u is bounded. The filter takes a share that leaves the tilt as well known as ``off``
        inverse = _inverse(uu + bounded * (LASTING / larger(dt, SOON)))
        K, K_u = product(cross, inverse), product(uu, inverse)
        known = larger(HPH[..., 0, 0] + HPH[..., 1, 1], SMALLEST)
        share = column(larger(1.0 - 2.0 * larger(state.off, CLOSE**2) / known, 0.0 * known))
        more = -share * product(K, u)[..., 0]
        P = before - column(share * (2.0 - share)) * product(K, _t(cross))
        velocity = Velocity((u - product(K_u, u))[..., 0], cross - product(K, uu), uu - product(K_u, uu))
        corrected = inertial_filter.apply_correction(estimate._replace(P=0.5 * (P + _t(P))), more)
        return chosen(active, (state._replace(velocity=velocity), corrected, dx + more), idle)

    idle = state, estimate, dx
    return changed_where(active, correct, idle)


def _t(matrix: Array) -> Array:
    return matrix.swapaxes(-1, -2)


def tilt_matrix(q_xyzw: Quaternion) -> Float[arrays.AnyArray, "*batch 2 3"]:
    """H: what a rotation about the body axes adds to the horizontal specific force over g."""
    x, y, z, w = components(q_xyzw)
    r_x = stacked([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)])
    r_y = stacked([2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)])
    return namespace(q_xyzw).stack([-r_y, r_x], axis=-2)


def _inverse(matrix: Array) -> Array:
    """Inverse of symmetric matrices (..., 2, 2)."""
    a, b, c, d = components(matrix.reshape(*matrix.shape[:-2], 4))
    b = 0.5 * (b + c)
    return stacked([d, -b, -b, a]).reshape(matrix.shape) / column(column(a * d - b * b))
