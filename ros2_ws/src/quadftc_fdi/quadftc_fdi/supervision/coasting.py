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
filter takes a share (consider filter, Schmidt 1966). The residual of an ambiguous fault does not correct the
delay, as a gyro that is late passes for an attitude that is early.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_fdi.fault_observer import SHORTEST
from quadftc_fdi.supervision import inertial_filter, measurement
from quadftc_fdi.supervision.gravity import LEAST, Gravity, Horizontal, tilt_matrix
from quadftc_fdi.supervision.measurement import MEASURED, Prediction
from quadftc_fdi.supervision.transition import (
    DELAY,
    ROTATION,
    SIZE,
    Covariance,
    Errors,
    FilterState,
    Transition,
)
from quadftc_model import arrays
from quadftc_model.arrays import (
    Array,
    Column,
    Float,
    Mask,
    Scalar,
    Vector,
    any_of,
    components,
    diagonal,
    larger,
    namespace,
    product,
    sqrt,
    stacked,
    where,
)

LASTING = 0.1  # s; density of u over its mean square: how long a velocity lasts
CLOSE = math.radians(0.2)  # rad; what gravity is off by at least
MANOEUVRE = 30.0 * math.radians(1.0) ** 2  # rad²/s³; how a fault bends
ANYWHERE = 0.3  # rad; of a fault at its beginning, 1 sigma
DRIFTS = math.radians(3.0)  # rad/s; of its slope
SMALLEST = 1e-30  # rad²; no less, as it divides
MORE = 8  # states: u (2), f (3), s (3)
U, FAULT, SLOPE = slice(0, 2), slice(2, 5), slice(5, MORE)
OF_U, OF_FAULT, OF_SLOPE = (np.diag(np.eye(MORE)[which].sum(axis=0)) for which in (U, FAULT, SLOPE))
START = ANYWHERE**2 * OF_FAULT + DRIFTS**2 * OF_SLOPE
OF_DELAY = np.eye(SIZE)[DELAY]


class Coasting(NamedTuple):
    """The states a besides, which mean something only while an axis is faulty."""

    a: Float[arrays.AnyArray, "*batch 8"]  # u [s], f [rad], s [rad/s]
    cross: Float[arrays.AnyArray, "*batch 8 16"]  # covariance of their errors with those of the filter
    own: Float[arrays.AnyArray, "*batch 8 8"]  # and with one another


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
    ambiguous: Mask  # (..., 1) a fault may be the gyro's: then the delay is not learned


class Joint(NamedTuple):
    """All states: those of the filter by their correction so far, and a."""

    dx: Errors
    P: Covariance
    more: Coasting


def start_coasting(zeros: Vector) -> Coasting:
    """Start with nothing known of them."""
    cross = namespace(zeros).zeros((*zeros.shape[:-1], MORE, SIZE))
    return Coasting(cross[..., 0], cross, cross[..., :MORE] + (START + LEAST**2 * OF_U))


def coast(
    state: Coasting,
    estimate: FilterState,
    dx: Errors,
    factors: inertial_filter.Factors,
    transition: Transition,
    prediction: Prediction,
    known: Known,
    dt: Scalar,
) -> tuple[Coasting, FilterState, Errors]:
    """Correct the filter of a vehicle of which an axis is faulty.

    ``dx`` and ``factors`` are those of the correction by healthy axes (`inertial_filter.correct`). Return dx
    with what is corrected here.
    """
    H = tilt_matrix(estimate.q_xyzw)
    begun = _begin(_follow(state, transition, prediction, factors), known)
    joint = Joint(dx, estimate.P, _predict(begun, estimate.P, H, known.horizontal, dt))
    joint = _correct_by_gravity(joint, H, known, dt)
    joint = _correct_by_faults(joint, prediction, known)
    corrected = inertial_filter.apply_correction(estimate._replace(P=joint.P), joint.dx - dx)
    return joint.more, corrected, joint.dx


def _t(matrix: Array) -> Array:
    return matrix.swapaxes(-1, -2)


def _follow(
    state: Coasting, transition: Transition, prediction: Prediction, factors: inertial_filter.Factors
) -> Coasting:
    """Follow the filter's prediction, and its correction by the healthy axes."""
    cross = _t(transition.of(_t(state.cross)))
    W_more = product(product(cross, _t(prediction.H), MEASURED), factors)
    W, W_a, more = product(prediction.PH, factors[..., :3]), W_more[..., :3], W_more[..., 3]
    return Coasting(state.a + more, cross - product(W_a, _t(W)), state.own - product(W_a, _t(W_a)))


def _begin(state: Coasting, known: Known) -> Coasting:
    """Begin anew what begins in this sample."""
    xp = namespace(state.a)
    new = xp.concatenate([known.begins, known.begins, known.fresh, known.fresh], axis=-1)
    start, rows = START + known.gravity.motion[..., None] * OF_U, new[..., :, None]
    return Coasting(
        where(new, 0.0, state.a),
        where(rows, 0.0, state.cross),
        where(rows | new[..., None, :], start, state.own),
    )


def _predict(state: Coasting, P: Covariance, H: Array, horizontal: Horizontal, dt: Scalar) -> Coasting:
    """Move a; the filter has made its step. E[a e'] <- A E[a e'] + G P, and E[a a'] likewise."""
    xp, G = namespace(state.a), -dt * H

    def move(x: Array) -> Array:  # A x of columns (..., 8, n)
        return xp.concatenate(
            [x[..., U, :], x[..., FAULT, :] + dt * x[..., SLOPE, :], x[..., SLOPE, :]], axis=-2
        )

    def add(x: Array, to_u: Array) -> Array:
        return xp.concatenate([x[..., U, :] + to_u, x[..., U.stop :, :]], axis=-2)

    moved = move(state.cross)
    cross = add(moved, product(G, P[..., ROTATION, :]))
    # rows, then columns: E[a a'] is symmetric
    own = add(move(_t(move(state.own))), product(G, _t(moved[..., ROTATION])))
    own = add(_t(own), product(G, _t(cross[..., ROTATION]))) + (MANOEUVRE * dt) * OF_SLOPE
    driven = xp.concatenate([dt * horizontal, xp.zeros_like(state.a[..., U.stop :])], axis=-1)
    return Coasting(move(state.a[..., None])[..., 0] + driven, cross, own)


def _correct_by_gravity(joint: Joint, H: Array, known: Known, dt: Scalar) -> Joint:
    """Correct by what is known of u: it is bounded."""
    tilted = (known.felt & any_of(known.faulty[..., :2]))[..., 0]
    bounded = LASTING / larger(dt, SHORTEST) * known.gravity.motion[..., 0]
    share = _share(joint.P, H, known.gravity)
    for k in range(U.stop):
        a, cross, own = joint.more
        variance = own[..., k, k] + bounded
        factors = stacked([tilted / sqrt(variance), tilted * -a[..., k] / variance])[..., None, :]
        joint = _correct(joint, cross[..., k, :, None], own[..., k, None], factors, share)
    return joint


def _share(P: Covariance, H: Array, gravity: Gravity) -> Column:
    """Share of gravity's correction that the filter takes."""
    HPH = product(product(H, P[..., ROTATION, ROTATION]), _t(H))
    known = larger(diagonal(HPH).sum(axis=-1, keepdims=True), SMALLEST)
    return larger(1.0 - 2.0 * larger(gravity.off, CLOSE**2) / known, 0.0)


def _correct_by_faults(joint: Joint, prediction: Prediction, known: Known) -> Joint:
    """Correct by the residuals of faulty axes: each is the fault."""
    H, (a, cross, own), used = prediction.H, joint.more, known.faulty & known.valid
    PH = product(joint.P, _t(H), MEASURED) + _t(cross[..., FAULT, :])
    own_H = product(cross, _t(H), MEASURED) + own[..., FAULT]
    HPH = product(H, PH, MEASURED) + own_H[..., FAULT, :]
    error = known.residual - measurement.turned_angles(prediction, joint.dx) - a[..., FAULT]
    factors = inertial_filter.correction_factors(HPH, components(known.variance), 0.0, error, used)
    return _correct(joint, PH, own_H, factors, 1.0 - known.ambiguous * OF_DELAY)


def _correct(joint: Joint, PH: Array, own_H: Array, factors: Array, share: Array) -> Joint:
    """Correct all states by n measurements: the filter's by a ``share`` (..., 16) or (..., 1).

    ``PH`` (..., 16, n) and ``own_H`` (..., 8, n) are their covariances with what is measured, ``factors``
    (..., n, n + 1) those of `inertial_filter.correction_factors`.
    """
    W_dx, W_da, (a, cross, own) = product(PH, factors), product(own_H, factors), joint.more
    W, W_a = W_dx[..., :-1], W_da[..., :-1]
    i, j = share[..., :, None], share[..., None, :]
    return Joint(
        joint.dx + share * W_dx[..., -1],
        joint.P - (i + j - i * j) * product(W, _t(W)),
        Coasting(a + W_da[..., -1], cross - product(W_a, _t(W)), own - product(W_a, _t(W_a))),
    )
