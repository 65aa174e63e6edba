r"""What the filter knows without the attitude: more states, while an axis is faulty.

Without its attitude an axis runs on the gyro, which may err in scale and alignment by degrees a second. Two
things are known all the same. A velocity is bounded, so that gravity shows the tilt over seconds. And a
fault f moves smoothly, while the errors of the gyro go with the rotation: what swings with the vehicle in
measured minus predicted angle r is no fault. So the filter has the states a = (u, f, s) besides,

    u <- u + (R f)_xy / g dt     velocity over g (`gravity`), about the earth's x and y axes
    f <- f + s dt,  s <- s + white noise of density `MANOEUVRE`      of each faulty axis

and is corrected by 0 = u + white noise of density `LASTING` E[u²], and by r = f + noise. With e the error of
the filter, a has the error e_a <- A e_a + G e, where G = -H dt for u. Each correction acts on both, also that
by the healthy axes. A fault that jumps begins anew.

Gravity does not make the tilt better known than what it is off by, nor than `CLOSE`: of its correction the
filter takes a share (consider filter, Schmidt 1966). The residual of an
ambiguous fault does not correct the delay, as a gyro that is late passes for an attitude that is early.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_fdi.supervision import inertial_filter
from quadftc_fdi.supervision.gravity import LEAST, Gravity, Horizontal, tilt_matrix
from quadftc_fdi.supervision.measurement import Prediction
from quadftc_fdi.supervision.transition import DELAY, ROTATION, SIZE, Errors, FilterState, Transition
from quadftc_model import arrays
from quadftc_model.arrays import (
    Array,
    Column,
    Float,
    Mask,
    Vector,
    any_of,
    chosen,
    column,
    larger,
    namespace,
    product,
    stacked,
)

LASTING = 0.1  # s; density of u over its mean square: how long a velocity lasts
CLOSE = math.radians(0.2)  # rad; what gravity is off by at least
MANOEUVRE = 30.0 * math.radians(1.0) ** 2  # rad²/s³; how a fault bends
ANYWHERE = 0.3  # rad; of a fault at its beginning, 1 sigma
DRIFTS = math.radians(3.0)  # rad/s; of its slope
SOON, SMALLEST = 1e-9, 1e-30  # s, rad²; no less, as it divides
MORE = 8  # states: u (2), f (3), s (3)
ALL = SIZE + MORE
U, FAULT, SLOPE = slice(SIZE, SIZE + 2), slice(SIZE + 2, SIZE + 5), slice(SIZE + 5, ALL)
EYE, OF_FILTER = np.eye(ALL), np.arange(ALL) < SIZE
OF_U, OF_FAULT, OF_SLOPE = (np.diag(EYE[which].sum(axis=0)) for which in (U, FAULT, SLOPE))
START = ANYWHERE**2 * OF_FAULT + DRIFTS**2 * OF_SLOPE


class Coasting(NamedTuple):
    """The states a besides, which mean something only while an axis is faulty."""

    a: Float[arrays.AnyArray, "*batch 8"]  # u [s], f [rad], s [rad/s]
    rows: Float[arrays.AnyArray, "*batch 8 24"]  # covariances with the filter's errors and one another


class Known(NamedTuple):
    """What a sample says where axes are faulty."""

    gravity: Gravity
    horizontal: Horizontal  # specific force over g [1]
    felt: Mask  # (..., 1) it is there, and counts
    residual: Vector  # measured minus predicted angle before this sample's corrections [rad]
    variance: Vector  # of its noise [rad²]
    valid: Mask  # it is measured
    faulty: Mask
    fresh: Mask  # the fault begins at this sample, or jumps
    begins: Mask  # (..., 1) neither roll nor pitch was faulty before, or no specific force counts
    ambiguous: Column | bool  # (..., 1) a fault may be the gyro's: then the delay is not learned


def start_coasting(zeros: Vector) -> Coasting:
    """Start with nothing known of them."""
    rows = namespace(zeros).zeros((*zeros.shape[:-1], MORE, ALL))
    return Coasting(rows[..., 0], rows + (START + LEAST**2 * OF_U)[SIZE:])


def coast(
    state: Coasting,
    estimate: FilterState,
    dx: Errors,
    factors: inertial_filter.Factors,
    transition: Transition,
    prediction: Prediction,
    known: Known,
    dt: float,
) -> tuple[Coasting, FilterState, Errors]:
    """Correct the filter where an axis is faulty.

    ``dx`` and ``factors`` are those of the correction by healthy axes (`inertial_filter.correct`). Return dx
    with what is corrected here.
    """
    xp, tilted = namespace(dx), known.felt & any_of(known.faulty[..., :2])
    begun = _begin(_follow(state, transition, prediction, factors), known)
    mean, joint = _predict(begun, estimate, dx, known.horizontal, dt)
    # u is bounded
    share = _share(estimate, joint, known.gravity)
    bounded = LASTING / larger(dt, SOON) * known.gravity.motion
    for h in EYE[U]:
        mean, joint = _correct(mean, joint, h, 0.0, bounded, tilted[..., 0], share)
    # the residual is the fault
    used, share = known.faulty & known.valid, 1.0 - known.ambiguous * EYE[DELAY]
    faults = np.broadcast_to(EYE[FAULT, SIZE:], (*prediction.H.shape[:-1], MORE))
    H = xp.concatenate([prediction.H, faults], axis=-1)
    for k in range(3):
        seen = H[..., k, :], known.residual[..., k], known.variance[..., k], used[..., k]
        mean, joint = _correct(mean, joint, *seen, share)
    total = mean[..., :SIZE]
    corrected = inertial_filter.apply_correction(estimate._replace(P=joint[..., :SIZE, :SIZE]), total - dx)
    after = Coasting(mean[..., SIZE:], joint[..., SIZE:, :]), corrected, total
    return chosen(any_of(known.faulty)[..., 0], after, (state, estimate, dx))


def _t(matrix: Array) -> Array:
    return matrix.swapaxes(-1, -2)


def _follow(
    state: Coasting, transition: Transition, prediction: Prediction, factors: inertial_filter.Factors
) -> Coasting:
    """Follow the filter's prediction, and its correction by the healthy axes."""
    cross, aa = transition.of(_t(state.rows[..., :SIZE])), state.rows[..., SIZE:]
    W_a = product(product(_t(cross), _t(prediction.H)), factors)
    W, W_a, more = product(prediction.PH, factors[..., :3]), W_a[..., :3], W_a[..., 3]
    cross, aa = cross - product(W, _t(W_a)), aa - product(W_a, _t(W_a))
    return Coasting(state.a + more, namespace(aa).concatenate([_t(cross), aa], axis=-1))


def _begin(state: Coasting, known: Known) -> Coasting:
    """Begin anew what begins in this sample."""
    xp = namespace(state.a)
    new = xp.concatenate([known.begins, known.begins, known.fresh, known.fresh], axis=-1)
    start = (START + column(column(known.gravity.motion)) * OF_U)[..., SIZE:, :]
    either = new[..., :, None] | xp.concatenate([new, new, new], axis=-1)[..., None, :] & ~OF_FILTER
    return Coasting(xp.where(new, 0.0, state.a), xp.where(either, start, state.rows))


def _predict(
    state: Coasting, estimate: FilterState, dx: Errors, horizontal: Horizontal, dt: float
) -> tuple[Array, Array]:
    """Return all states and their covariance, the filter's and a; the former are its correction dx so far."""
    xp, H = namespace(dx), tilt_matrix(estimate.q_xyzw)

    def move(x: Array) -> Array:
        """Turn errors (..., 24, n) of before into those after the step; the filter has made it."""
        u, s = x[..., U, :] - dt * product(H, x[..., ROTATION, :]), x[..., SLOPE, :]
        return xp.concatenate([x[..., :SIZE, :], u, x[..., FAULT, :] + dt * s, s], axis=-2)

    above = xp.concatenate([estimate.P, _t(state.rows[..., :SIZE])], axis=-1)
    P = xp.concatenate([above, state.rows], axis=-2)
    u, f, s = state.a[..., :2], state.a[..., 2:5], state.a[..., 5:]
    mean = xp.concatenate([dx, u + dt * stacked(horizontal), f + dt * s, s], axis=-1)
    return mean, _t(move(_t(move(P)))) + (MANOEUVRE * dt) * OF_SLOPE


def _share(estimate: FilterState, P: Array, gravity: Gravity) -> Array:
    """Share of gravity's correction that each state takes: (..., 24)."""
    H = tilt_matrix(estimate.q_xyzw)
    HPH = product(product(H, P[..., ROTATION, ROTATION]), _t(H))
    known = larger(HPH[..., 0, 0] + HPH[..., 1, 1], SMALLEST)
    share = larger(1.0 - 2.0 * larger(gravity.off, CLOSE**2) / known, 0.0 * known)
    return namespace(P).where(OF_FILTER, column(share), 1.0)


def _correct(
    mean: Array, P: Array, h: Array, measured: Array, variance: Array, used: Array, share: Array
) -> tuple[Array, Array]:
    """Correct all states by h x = measured + noise, where ``used``: each by its ``share`` (..., 24)."""
    Ph = product(P, h[..., None])[..., 0]
    gain = used / ((h * Ph).sum(axis=-1) + variance)
    error = measured - (h * mean).sum(axis=-1)
    mean = mean + share * Ph * column(gain * error)
    i, j = share[..., :, None], share[..., None, :]
    return mean, P - (i + j - i * j) * column(column(gain)) * Ph[..., :, None] * Ph[..., None, :]
