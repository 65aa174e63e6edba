"""Error-state Kalman filter of an IMU with an attitude sensor (Lefferts, Markley and Shuster 1982).

    omega = (I + M) g - b,   q' = q (omega, 0) / 2          g: gyro, b: its bias, M: scale and alignment
    h = x1(q) - E(x1) omega tau + noise                      Euler angles, sampled tau before the gyro

The error state has 16 elements: rotation delta in body axes, b (3), M (9, by rows), tau (1). The attitude
itself is a quaternion, so only the Euler angles of the measurement are singular.

    predict   P <- F P F' + Q,   F: `transition`
    correct   S = H P H' + R,   K = P H' S^-1,   dx = K (h - h^),   P <- P - K S K'
              H = E [I, 0, 0, -omega]

Each axis of the measurement is used or left out by itself. An axis that is left out runs on the gyro alone,
and P says how uncertain that is. Arrays have any leading axes; no branch depends on data.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.supervision import transition
from quadftc_fdi.supervision.transition import (
    BIAS,
    DELAY,
    ROTATION,
    SIZE,
    Covariance,
    Covariances,
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
    Vector,
    components,
    is_single,
    namespace,
    product,
    stacked,
)
from quadftc_model.rotations import away_from_zero, euler_from_quaternion, turn

Errors = Float[arrays.AnyArray, "*batch 16"]
MeasurementMatrix = Float[arrays.AnyArray, "*batch 3 16"]

MEASURED = (0, 1, 2, DELAY)  # columns of H that are not zero
LEFT_OUT = 1e6  # rad²; variance of a measurement that is left out


class FilterState(NamedTuple):
    """Estimate and covariance."""

    q_xyzw: Quaternion
    x: Float[arrays.AnyArray, "*batch 13"]  # b [rad/s], M by rows [1], tau [s]
    P: Covariance  # of the error state


class Prediction(NamedTuple):
    """What the attitude sensor should read, and how uncertain that is."""

    angles: Vector  # Euler angles of tau ago [rad]
    H: MeasurementMatrix
    gain: Vector  # variance of each angle for one of 1 rad² about each body axis
    PH: Float[arrays.AnyArray, "*batch 16 3"]  # P H'
    HPH: Float[arrays.AnyArray, "*batch 3 3"]  # covariance of the angles [rad²]


def start_filter(q_xyzw: Quaternion, std_devs: NDArray[np.float64]) -> FilterState:
    """Start at an attitude, with standard deviations (16,) of the error state."""
    xp, batch = namespace(q_xyzw), q_xyzw.shape[:-1]
    P = xp.zeros((*batch, SIZE, SIZE)) + np.diag(std_devs**2)
    return FilterState(q_xyzw, xp.zeros((*batch, SIZE - 3)), P)


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
    state: FilterState, earlier: Covariances, gyro: Vector, noise: ProcessNoise, dt: float
) -> tuple[FilterState, Covariances, Transition]:
    """Turn by a gyro sample [rad/s], the mean over the step ``dt`` [s].

    ``earlier`` are covariances of states that run on the gyro alone. Return them after the step, and the
    transition F, too.
    """
    omega = estimate_rate(state.x, gyro)
    F = transition.transition(omega, gyro, dt)
    P = F.around(namespace(gyro).concatenate([state.P[..., None, :, :], earlier], axis=-3), noise)
    q_xyzw = turn(state.q_xyzw, omega * dt)
    return FilterState(q_xyzw, state.x, P[..., 0, :, :]), P[..., 1:, :, :], F


def bias_variance(P: Covariance) -> Column:
    """Largest variance of the gyro bias [rad²/s²] over the axes."""
    diagonal = P.reshape(*P.shape[:-2], SIZE * SIZE)[..., :: SIZE + 1]
    if is_single(diagonal):
        return np.array([max(diagonal[BIAS].tolist())])
    return diagonal[..., BIAS].max(axis=-1, keepdims=True)


def apply_correction(state: FilterState, dx: Errors) -> FilterState:
    """Shift the estimate by a correction of the error state; the covariance stays."""
    return FilterState(turn(state.q_xyzw, dx[..., ROTATION]), state.x + dx[..., 3:], state.P)


def predict_angles(state: FilterState, omega: Vector) -> Prediction:
    """Predict the Euler angles that the attitude sensor should read, at a body rate [rad/s]."""
    angles = euler_from_quaternion(state.q_xyzw)
    H, gain, slopes = measurement_matrix(angles, omega)
    PH, HPH = _seen(state.P, H)
    return Prediction(angles + slopes * state.x[..., 12:13], H, gain, PH, HPH)


def predict_again(prediction: Prediction, P: Covariance) -> Prediction:
    """Return the prediction with another covariance of the error state."""
    PH, HPH = _seen(P, prediction.H)
    return prediction._replace(PH=PH, HPH=HPH)


def _seen(P: Covariance, H: MeasurementMatrix) -> tuple[Array, Array]:
    """P H' and H P H'."""
    PH = product(P, H.swapaxes(-1, -2), MEASURED)
    return PH, product(H, PH, MEASURED)


def angle_variances(HPH: Float[arrays.AnyArray, "*batch 3 3"]) -> Vector:
    """Variances of the predicted angles [rad²]: the diagonal of their covariance."""
    return HPH.reshape(*HPH.shape[:-2], 9)[..., ::4]


def earlier_variances(earlier: Covariances, H: MeasurementMatrix) -> Float[arrays.AnyArray, "*batch n 3"]:
    """Variances of the angles [rad²] with other covariances of the error state."""
    if type(earlier) is np.ndarray and earlier.ndim == 3:
        PH = earlier.reshape(-1, SIZE).dot(H.T).reshape(-1, SIZE, 3)
        return (PH * H.T).sum(axis=1)
    each = H[..., None, :, :]
    return (product(each, earlier, MEASURED) * each).sum(axis=-1)


def measurement_matrix(angles: Vector, omega: Vector) -> tuple[MeasurementMatrix, Vector, Vector]:
    """H = E [I, 0, 0, -omega] at Euler angles and body rate; the squares of the rows of E, and -E omega."""
    E = _euler_matrix(angles)
    p, q, r = components(omega)
    rows = E[:3], E[3:6], E[6:]
    slopes = [-(a * p + b * q + c * r) for a, b, c in rows]
    gain, slope = stacked([a * a + b * b + c * c for a, b, c in rows]), stacked(slopes)
    if is_single(omega):
        return np.array(E + slopes).dot(_PLACES).reshape(3, SIZE), gain, slope
    xp = namespace(omega)
    rotation = xp.stack(E, axis=-1).reshape(*angles.shape, 3)
    unseen = xp.zeros((*omega.shape[:-1], 3, DELAY - 3))
    return (
        xp.concatenate([rotation, unseen.astype(rotation.dtype), slope[..., None]], axis=-1),
        gain,
        slope,
    )


def _euler_matrix(angles: Vector) -> list[Array]:
    """Rows of E in (4), x1' = E(x1) omega, one after the other; the cosine of pitch is kept from zero."""
    phi, theta, _ = components(angles)
    single, xp = isinstance(phi, float), namespace(angles)
    sin, cos = (math.sin, math.cos) if single else (xp.sin, xp.cos)
    s_phi, c_phi, s_theta = sin(phi), cos(phi), sin(theta)
    secant = 1.0 / away_from_zero(cos(theta))
    tangent = s_theta * secant
    one, zero = (1.0, 0.0) if single else (xp.ones_like(s_phi), xp.zeros_like(s_phi))
    return [one, s_phi * tangent, c_phi * tangent, zero, c_phi, -s_phi, zero, s_phi * secant, c_phi * secant]


def correct(
    state: FilterState, prediction: Prediction, residual: Vector, variance: Vector, used: Mask
) -> tuple[FilterState, Errors]:
    """Correct by the axes that are used: residual h - h^ [rad], diagonal of R [rad²]; return dx, too."""
    xp, PH, HPH = namespace(residual), prediction.PH, prediction.HPH
    # With S = L L' and W = P H' L'^-1: K = W L^-1, and K S K' = W W' is symmetric to the last bit.
    a, b, c, d, e, f = _inverse_cholesky(HPH, xp.where(used, variance, LEFT_OUT))
    x, y, z = components(residual * used)
    zero = 0.0 * a
    W = product(PH, stacked([a, b, d, zero, c, e, zero, zero, f]).reshape(HPH.shape))
    white = stacked([a * x, b * x + c * y, d * x + e * y + f * z])
    dx = product(W, white[..., None])[..., 0]
    P = state.P - product(W, W.swapaxes(-1, -2))
    return apply_correction(state._replace(P=P), dx), dx


def _inverse_cholesky(HPH: Array, R: Vector) -> tuple[Array, ...]:
    """Lower triangle of L^-1, row by row, with L L' = H P H' + diag(R)."""
    a, _, _, b, d, _, c, e, f = components(HPH.reshape(*HPH.shape[:-2], 9))
    x, y, z = components(R)
    sqrt = math.sqrt if isinstance(a, float) else namespace(R).sqrt
    i00 = 1.0 / sqrt(a + x)
    l10, l20 = b * i00, c * i00
    i11 = 1.0 / sqrt(d + y - l10 * l10)
    l21 = (e - l20 * l10) * i11
    i22 = 1.0 / sqrt(f + z - l20 * l20 - l21 * l21)
    i10 = -l10 * i00 * i11
    return i00, i10, i11, -(l20 * i00 + l21 * i10) * i22, -l21 * i11 * i22, i22


def _places() -> NDArray[np.float64]:
    """H as (E by rows, -E omega) @ (12, 48)."""
    parts = np.zeros((12, 3, SIZE))
    for row in range(3):
        parts[3 * row : 3 * row + 3, row, ROTATION] = np.eye(3)
        parts[9 + row, row, DELAY] = 1.0
    return parts.reshape(12, -1)


_PLACES = _places()
