"""Error-state Kalman filter of an IMU with an attitude sensor (Lefferts, Markley and Shuster 1982).

    omega = (I + M) g - b,   q' = q (omega, 0) / 2          g: gyro, b: its bias, M: scale and alignment
    h = x1(q) - E(x1) omega tau + noise                      Euler angles, sampled tau before the gyro

The error state has 16 elements: rotation delta in body axes, b (3), M (9, by rows), tau (1). The attitude
itself is a quaternion, so only the Euler angles of the measurement are singular.

    delta' = -omega x delta + delta_M g - delta_b
    F = [[A, G], [0, I]],   A = I - [omega]x dt,   G = dt [-I, I (x) g', 0]
    predict   P <- F P F' + Q
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

from quadftc_model import arrays
from quadftc_model.arrays import Array, Column, Float, Mask, Quaternion, Vector, is_single, namespace, product
from quadftc_model.rotations import away_from_zero, turn

Errors = Float[arrays.AnyArray, "*batch 16"]
Covariance = Float[arrays.AnyArray, "*batch 16 16"]  # of the error state
MeasurementMatrix = Float[arrays.AnyArray, "*batch 3 16"]

SIZE = 16  # of the error state
ROTATION, BIAS, DELAY = slice(0, 3), slice(3, 6), 15
MEASURED = (0, 1, 2, DELAY)  # columns of H that are not zero
LEFT_OUT = 1e6  # rad²; variance of a measurement that is left out


class FilterState(NamedTuple):
    """Estimate and covariance."""

    q_xyzw: Quaternion
    x: Float[arrays.AnyArray, "*batch 13"]  # b [rad/s], M by rows [1], tau [s]
    P: Covariance  # covariance of the error state


def start_filter(q_xyzw: Quaternion, std_devs: NDArray[np.float64]) -> FilterState:
    """Start at an attitude, with standard deviations (16,) of the error state."""
    xp, batch = namespace(q_xyzw), q_xyzw.shape[:-1]
    P = xp.zeros((*batch, SIZE, SIZE)) + np.diag(std_devs**2)
    return FilterState(q_xyzw, xp.zeros((*batch, SIZE - 3)), P)


def estimate_rate(x: Float[arrays.AnyArray, "*batch 13"], gyro: Vector) -> Vector:
    """Body rate omega = (I + M) g - b [rad/s] of a gyro sample."""
    if is_single(x):
        return gyro + x[3:12].reshape(3, 3).dot(gyro) - x[:3]
    M = x[..., 3:12].reshape(*x.shape[:-1], 3, 3)
    return gyro + product(M, gyro[..., None])[..., 0] - x[..., :3]


def predict(state: FilterState, gyro: Vector, Q: Covariance, dt: float) -> tuple[FilterState, Transition]:
    """Turn by a gyro sample [rad/s], the mean over the step ``dt`` [s]; return the transition F, too."""
    omega = estimate_rate(state.x, gyro)
    F = transition(omega, gyro, dt)
    return FilterState(turn(state.q_xyzw, omega * dt), state.x, F.around(state.P) + Q), F


def process_noise(rotation: Column, bias: Column) -> Covariance:
    """Covariance Q that a step adds, of the variances of rotation and bias of each axis."""
    diagonal = rotation * _ROTATION_NOISE + bias * _BIAS_NOISE
    return diagonal.reshape(*rotation.shape[:-1], SIZE, SIZE)


def bias_variance(P: Covariance) -> Column:
    """Largest variance of the gyro bias [rad²/s²] over the axes."""
    diagonal = P.reshape(*P.shape[:-2], SIZE * SIZE)[..., :: SIZE + 1]
    if is_single(diagonal):
        return np.array([max(diagonal[BIAS].tolist())])
    return diagonal[..., BIAS].max(axis=-1, keepdims=True)


def apply_correction(state: FilterState, dx: Errors) -> FilterState:
    """Shift the estimate by a correction of the error state; the covariance stays."""
    return FilterState(turn(state.q_xyzw, dx[..., ROTATION]), state.x + dx[..., 3:], state.P)


def predict_angles(state: FilterState, angles: Vector, H: MeasurementMatrix) -> Vector:
    """Euler angles h^ that the attitude sensor should read: those of ``tau`` ago."""
    return angles + H[..., DELAY] * state.x[..., 12:13]


def measurement_matrix(angles: Vector, omega: Vector) -> MeasurementMatrix:
    """H = E [I, 0, 0, -omega] at Euler angles and body rate."""
    E = euler_matrix(angles)
    if is_single(omega):
        return E @ (omega @ _DELAYED + _DIRECT).reshape(3, SIZE)
    xp = namespace(omega)
    unseen = xp.zeros((*omega.shape[:-1], 3, DELAY - 3))
    return xp.concatenate([E, unseen.astype(E.dtype), -product(E, omega[..., None])], axis=-1)


def euler_matrix(angles: Vector) -> Float[arrays.AnyArray, "*batch 3 3"]:
    """E of (4), x1' = E(x1) omega, with the cosine of pitch kept away from zero."""
    xp = namespace(angles)
    s_phi, s_theta, _ = arrays.components(xp.sin(angles))
    c_phi, c_theta, _ = arrays.components(xp.cos(angles))
    one, zero = (1.0, 0.0) if isinstance(s_phi, float) else (xp.ones_like(s_phi), xp.zeros_like(s_phi))
    secant = one / away_from_zero(c_theta)
    tangent = s_theta * secant
    E = [one, s_phi * tangent, c_phi * tangent, zero, c_phi, -s_phi, zero, s_phi * secant, c_phi * secant]
    return arrays.stacked(E).reshape(*angles.shape, 3)


def correct(
    state: FilterState, H: MeasurementMatrix, residual: Vector, variance: Vector, used: Mask
) -> tuple[FilterState, Errors]:
    """Correct by the axes that are used: residual h - h^ [rad], diagonal of R [rad²]; return dx, too."""
    xp = namespace(residual)
    PH = product(state.P, H.swapaxes(-1, -2), MEASURED)
    S = product(H, PH, MEASURED) + xp.where(used, variance, LEFT_OUT)[..., None] * _AXES
    # With S = L L' and W = P H' L'^-1: K = W L^-1, and K S K' = W W' is symmetric to the last bit.
    L_inverse_T = _inverse_cholesky_T(S)
    W = product(PH, L_inverse_T)
    white = product(L_inverse_T.swapaxes(-1, -2), xp.where(used, residual, 0.0)[..., None])
    dx = product(W, white)[..., 0]
    P = state.P - product(W, W.swapaxes(-1, -2))
    return apply_correction(state._replace(P=P), dx), dx


def _inverse_cholesky_T(S: Array) -> Array:
    """L'^-1 (..., 3, 3) of the Cholesky factor L of a symmetric positive definite matrix (..., 3, 3)."""
    a, _, _, b, d, _, c, e, f = arrays.components(S.reshape(*S.shape[:-2], 9))
    sqrt = math.sqrt if isinstance(a, float) else namespace(S).sqrt
    i00 = 1.0 / sqrt(a)
    l10, l20 = b * i00, c * i00
    i11 = 1.0 / sqrt(d - l10 * l10)
    l21 = (e - l20 * l10) * i11
    i22 = 1.0 / sqrt(f - l20 * l20 - l21 * l21)
    i10 = -l10 * i00 * i11
    i20, i21 = -(l20 * i00 + l21 * i10) * i22, -l21 * i11 * i22
    zero = 0.0 * a
    return arrays.stacked([i00, i10, i20, zero, i11, i21, zero, zero, i22]).reshape(S.shape)


class MatrixTransition(NamedTuple):
    """Transition of the error of one vehicle; NumPy is quickest with F as a matrix."""

    F: Array  # (16, 16)

    def of(self, x: Array) -> Array:
        """F x of columns (16, n)."""
        return self.F @ x

    def around(self, P: Covariance) -> Covariance:
        """F P F', symmetric."""
        FPF = self.F @ P @ self.F.T
        return 0.5 * (FPF + FPF.T)


class BlockTransition(NamedTuple):
    """Transition of the errors of a batch: A and g dt alone are a twentieth of the work."""

    A: Array  # (..., 3, 3)
    g: Array  # (..., 3) gyro times dt
    dt: float

    def of(self, x: Array) -> Array:
        """F x of columns (..., 16, n)."""
        rotation = product(self.A, x[..., ROTATION, :]) + self._G(x[..., 3:, :])
        return namespace(x).concatenate([rotation, x[..., 3:, :]], axis=-2)

    def around(self, P: Covariance) -> Covariance:
        """F P F', symmetric."""
        xp = namespace(P)
        R, C, D = P[..., :3, :3], P[..., :3, 3:], P[..., 3:, 3:]
        across = product(self.A, C) + self._G(D)
        half = product(self.A, R) + self._G(C.swapaxes(-1, -2))
        G_across = self._G(across.swapaxes(-1, -2)).swapaxes(-1, -2)
        rotation = product(half, self.A.swapaxes(-1, -2)) + G_across
        rotation = 0.5 * (rotation + rotation.swapaxes(-1, -2))
        above = xp.concatenate([rotation, across], axis=-1)
        below = xp.concatenate([across.swapaxes(-1, -2), D], axis=-1)
        return xp.concatenate([above, below], axis=-2)

    def _G(self, x: Array) -> Array:
        """G x of bias, alignment and delay (..., 13, n)."""
        g = arrays.components(self.g)
        aligned = [g[i][..., None, None] * x[..., 3 + i : 12 : 3, :] for i in range(3)]
        return sum(aligned, -self.dt * x[..., :3, :])


Transition = MatrixTransition | BlockTransition


def transition(omega: Vector, gyro: Vector, dt: float) -> Transition:
    """Transition over ``dt`` [s] at a body rate and a gyro sample [rad/s]."""
    if is_single(omega):
        parts = np.concatenate([omega * dt, gyro * dt, (dt, 1.0)])
        return MatrixTransition((parts @ _TRANSITION).reshape(SIZE, SIZE))
    xp = namespace(omega)
    p, q, r = arrays.components(omega * dt)
    one = xp.ones_like(p)
    A = [one, r, -q, -r, one, p, q, -p, one]
    return BlockTransition(xp.stack(A, axis=-1).reshape(*omega.shape, 3), gyro * dt, dt)


def _transition() -> NDArray[np.float64]:
    """F as (omega dt, g dt, dt, 1) @ (8, 256): -[omega]x, g against the rows of M, the bias, and I."""
    parts = np.zeros((8, SIZE, SIZE))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        parts[i, j, k], parts[i, k, j] = 1.0, -1.0  # -[omega]x
        for row in range(3):
            parts[3 + i, row, 6 + 3 * row + i] = 1.0
    parts[6, ROTATION, BIAS], parts[7] = -np.eye(3), np.eye(SIZE)
    return parts.reshape(8, -1)


_AXES = np.eye(3)
_TRANSITION = _transition()
_ROTATION_NOISE = np.diag(np.eye(SIZE)[ROTATION].sum(axis=0)).ravel()  # Q (256,) with variance 1 of each
_BIAS_NOISE = np.diag(np.eye(SIZE)[BIAS].sum(axis=0)).ravel()
_DIRECT = np.eye(3, SIZE).ravel()  # [I, 0, 0, -omega] as omega @ (3, 48) + (48,)
_DELAYED = np.where(np.eye(3, dtype=bool)[..., None] & (np.arange(SIZE) == DELAY), -1.0, 0.0).reshape(3, -1)
