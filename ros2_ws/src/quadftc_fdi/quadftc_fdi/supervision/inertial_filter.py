"""Error-state Kalman filter of an IMU with an attitude sensor (Lefferts, Markley and Shuster 1982).

    omega = (I + M) g - b,   q' = q (omega, 0) / 2          g: gyro, b: its bias, M: scale and alignment
    h = x1(q exp(-omega tau)) + noise                        Euler angles, sampled tau before the gyro

The error state has 16 elements: rotation delta in body axes, b (3), M (9, by rows), tau (1). The attitude
itself is a quaternion, so only the Euler angles of the measurement are singular.

    predict   P <- F P F' + Q,   F: `transition`
    correct   S = H P H' + R,   K = P H' S^-1,   dx = K (h - h^),   P <- P - K S K'
              R = D [[1, 0, s], [0, 1, 0], [s, 0, 1]] D

H and the angles are those of `measurement`, s is the sine of pitch, and D has the standard deviations of the
angles on its diagonal.

Each axis of the measurement is used or left out by itself. An axis that is left out runs on the gyro alone,
and P says how uncertain that is. Arrays have any leading axes; no branch depends on data.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.supervision import transition
from quadftc_fdi.supervision.measurement import Prediction
from quadftc_fdi.supervision.transition import (
    BIAS,
    ROTATION,
    SCALE,
    SIZE,
    Covariance,
    Covariances,
    Errors,
    FilterState,
    ProcessNoise,
    Transition,
)
from quadftc_model import arrays
from quadftc_model.arrays import (
    Array,
    Column,
    Float,
    Mask,
    Quaternion,
    Scalar,
    Vector,
    branch,
    components,
    diagonal,
    larger,
    largest,
    namespace,
    product,
    sqrt,
    stacked,
    where,
)
from quadftc_model.rotations import turn

Factors = Float[arrays.AnyArray, "*batch 3 4"]

GAP = 0.15  # s; longer than the period of any IMU: the rate in a gap is a guess
_OF_GYRO = np.outer(np.arange(SIZE) >= BIAS.start, np.arange(SIZE) >= BIAS.start)
LEFT_OUT = 1e6  # rad²; variance of a measurement that is left out


def start_covariance(
    attitude: float, bias: float, scale: float, alignment: float, delay: float
) -> NDArray[np.float64]:
    """Covariance (16, 16) of the error state for standard deviations [rad, rad/s, 1, rad, s].

    M is the sum of a symmetric part (``scale`` errors, and axes that are not square to each other) and of a
    skew part: by ``alignment``, the attitude sensor's axes are turned against the gyro's. Only the symmetric
    part makes an attitude drift.
    """
    P = np.diag(np.array([attitude] * 3 + [bias] * 3 + [scale] * 9 + [delay]) ** 2)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        pair = SCALE.start + np.array([3 * i + j, 3 * j + i])
        P[np.ix_(pair, pair)] = 0.5 * scale**2 + alignment**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return P


def start_filter(q_xyzw: Quaternion, P: NDArray[np.float64]) -> FilterState:
    """Start at an attitude, with a covariance (16, 16) of the error state."""
    xp, batch = namespace(q_xyzw), q_xyzw.shape[:-1]
    return FilterState(q_xyzw, xp.zeros((*batch, SIZE - 3)), xp.zeros((*batch, SIZE, SIZE)) + P)


def estimate_rate(x: Float[arrays.AnyArray, "*batch 13"], gyro: Vector) -> Vector:
    """Body rate omega = (I + M) g - b [rad/s] of a gyro sample."""
    x0, x1, x2, xx, xy, xz, yx, yy, yz, zx, zy, zz, _ = components(x)
    p, q, r = components(gyro)
    return stacked(
        [
            p + (xx * p + xy * q + xz * r) - x0,
            q + (yx * p + yy * q + yz * r) - x1,
            r + (zx * p + zy * q + zz * r) - x2,
        ]
    )


def predict(
    state: FilterState, earlier: Covariances, gyro: Vector, change: Vector, noise: ProcessNoise, dt: Scalar
) -> tuple[FilterState, Covariances, Transition]:
    """Turn by the mean of two gyro samples [rad/s], ``dt`` [s] apart, and their difference.

    ``earlier`` are covariances of states that run on the gyro alone; those after the step are returned, too,
    and the transition F.
    """
    xp, omega = namespace(gyro), estimate_rate(state.x, gyro)
    F = transition.transition(omega, gyro, dt)
    P = F.around(xp.concatenate([state.P[..., None, :, :], earlier], axis=-3), noise)
    # if the rate is linear in time: the axis turns, too (coning, of third order in dt)
    turned = dt * omega + where(dt < GAP, dt**2 / 12.0, 0.0) * xp.cross(omega, change)
    return FilterState(turn(state.q_xyzw, turned), state.x, P[..., 0, :, :]), P[..., 1:, :, :], F


def bias_variance(P: Covariance) -> Column:
    """Largest variance of the gyro bias [rad²/s²] over the axes."""
    return diagonal(P)[..., BIAS].max(axis=-1, keepdims=True)


def apply_correction(state: FilterState, dx: Errors) -> FilterState:
    """Shift the estimate by a correction of the error state; the covariance stays."""
    return FilterState(turn(state.q_xyzw, dx[..., ROTATION]), state.x + dx[..., 3:], state.P)


def correct(
    state: FilterState, prediction: Prediction, residual: Vector, variance: Vector, used: Mask
) -> tuple[FilterState, Errors, Factors]:
    """Correct by the axes that are used: residual h - h^ [rad], diagonal of R [rad²]; return dx, too.

    The factors are those of `correction_factors`, for what else is correlated with the angles.
    """
    # With W = P H' L'^-1: K = W L^-1, and K S K' = W W' is symmetric to the last bit.
    (u, v, w), (bent, bent_pitch) = components(variance), _second_order(prediction, state.P)
    R = u + bent, v + bent_pitch, w + bent
    factors = correction_factors(prediction.HPH, R, prediction.lean, residual, used)
    W_dx = product(prediction.PH, factors)
    W, dx = W_dx[..., :3], W_dx[..., 3]
    P = state.P - product(W, W.swapaxes(-1, -2))
    return apply_correction(FilterState(state.q_xyzw, state.x, P), dx), dx, factors


def correction_factors(
    HPH: Array, variance: Sequence[Scalar], lean: Scalar, residual: Vector, used: Mask
) -> Factors:
    """L'^-1 and S^-1 (h - h^), with S = L L' = H P H' + R, of the residual h - h^ where it is used.

    R is given by its diagonal, ``variance``, and the sine s of pitch, ``lean``.
    """
    R = [where(flag, each, LEFT_OUT) for flag, each in zip(components(used), variance, strict=True)]
    x, y, z = components(where(used, residual, 0.0))
    a, b, c, d, e, f = _inverse_cholesky(HPH, R, lean)
    zero, u, v, w = 0.0 * a, a * x, b * x + c * y, d * x + e * y + f * z
    rows = [a, b, d, a * u + b * v + d * w, zero, c, e, c * v + e * w, zero, zero, f, f * w]
    return stacked(rows).reshape(*residual.shape, 4)


def keep_gyro(before: FilterState, after: FilterState, dx: Errors, kept: Mask) -> tuple[FilterState, Errors]:
    """Undo what a correction has taught of the gyro, where it is not the gyro that was compared.

    The attitude keeps its correction: Schmidt's (1966) filter, which considers errors that it does not
    estimate. ``kept`` (..., 1) says where.
    """

    def undo() -> tuple[FilterState, Errors]:
        P = where(kept[..., None] & _OF_GYRO, before.P, after.P)
        rotation = where(kept & (np.arange(SIZE) >= BIAS.start), 0.0, dx)
        return FilterState(after.q_xyzw, where(kept, before.x, after.x), P), rotation

    return branch(kept[..., 0], undo, lambda: (after, dx))


def _second_order(prediction: Prediction, P: Covariance) -> tuple[Array, Array]:
    """Variance of roll and yaw, and of pitch [rad²], that H leaves out: near a pole they are not linear."""
    (gain, _, _), known = components(prediction.gain), largest(diagonal(P)[..., ROTATION])
    bent = (gain - 1.0) * known
    return 0.5 * bent * bent, 0.25 * bent * known


def _inverse_cholesky(HPH: Array, R: Sequence[Scalar], lean: Scalar) -> tuple[Array, ...]:
    """Lower triangle of L^-1, row by row, with L L' = H P H' + R, of the diagonal and the sine of pitch."""
    a, _, _, b, d, _, c, e, f = components(HPH.reshape(*HPH.shape[:-2], 9))
    x, y, z = R
    c = c + where(larger(x, z) < LEFT_OUT, lean * sqrt(x * z), 0.0)
    # each pivot is that of R at least: rounding must not make it less
    i00 = 1.0 / sqrt(larger(a + x, x))
    l10, l20 = b * i00, c * i00
    i11 = 1.0 / sqrt(larger(d + y - l10 * l10, y))
    l21 = (e - l20 * l10) * i11
    i22 = 1.0 / sqrt(larger(f + z - l20 * l20 - l21 * l21, z * (1.0 - lean * lean)))
    i10 = -l10 * i00 * i11
    return i00, i10, i11, -(l20 * i00 + l21 * i10) * i22, -l21 * i11 * i22, i22
