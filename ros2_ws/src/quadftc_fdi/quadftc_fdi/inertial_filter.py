"""Error-state Kalman filter of an IMU with an attitude sensor: attitude, gyro bias, scale, alignment, delay.

    omega = (I + M) g - b,   q' = q (omega, 0) / 2          g: gyro
    h = x1(q) - E(x1) omega tau + noise                      Euler angles, sampled tau before the gyro

Error state (16): rotation delta in body axes, b (3), M (9, by rows), tau (1), after Lefferts, Markley and
Shuster (1982). The rotation itself is a quaternion, so nothing is singular but the Euler angles of the
measurement.

    delta' = -omega x delta + delta_M g - delta_b,   H = E [I, 0, 0, -omega]

Each axis of the measurement is taken or left by itself: a faulty one is left out and runs on the gyro alone,
and the covariance says how good that is. Arrays have any leading axes; there are no branches on data.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.error_transition import BIAS, DELAY, ROTATION, SIZE, Transition, transition
from quadftc_model.arrays import Array, components, is_single, namespace, product, stacked
from quadftc_model.rotations import (
    MIN_COS_PITCH,
    normalise,
    quaternion_from_rotation_vector,
    quaternion_product,
)

MEASURED = (0, 1, 2, DELAY)  # elements of the error that a measurement shows: all other columns of H are zero
REFUSED = 1e6  # rad²; variance of a measurement that is left out


class FilterState(NamedTuple):
    """Estimate and covariance."""

    q_xyzw: Array  # (..., 4)
    x: Array  # (..., 13) b [rad/s], M by rows [1], tau [s]
    P: Array  # (..., 16, 16) covariance of the error state


def initial(q_xyzw: Array, std_devs: NDArray[np.float64]) -> FilterState:
    """Start at an attitude (..., 4) with standard deviations (16,) of the error state."""
    xp = namespace(q_xyzw)
    batch = q_xyzw.shape[:-1]
    return FilterState(
        q_xyzw, xp.zeros((*batch, SIZE - 3)), xp.zeros((*batch, SIZE, SIZE)) + np.diag(std_devs**2)
    )


def rate(x: Array, gyro: Array) -> Array:
    """Body rate [rad/s] (..., 3) of a gyro sample: (I + M) g - b."""
    if is_single(x):
        return gyro + x[3:12].reshape(3, 3).dot(gyro) - x[:3]
    M = x[..., 3:12].reshape(*x.shape[:-1], 3, 3)
    return gyro + product(M, gyro[..., None])[..., 0] - x[..., :3]


def propagated(state: FilterState, gyro: Array, noise: Array, dt: float) -> tuple[FilterState, Transition]:
    """Turn by a gyro sample (..., 3) over ``dt`` [s].

    Parameters
    ----------
    state : FilterState
    gyro : array (..., 3)
        Mean over the step [rad/s].
    noise : array (..., 16, 16)
        Of `process_noise`.
    dt : float

    Returns
    -------
    FilterState, and the transition of the error.
    """
    omega = rate(state.x, gyro)
    q = normalise(quaternion_product(state.q_xyzw, quaternion_from_rotation_vector(omega * dt)))
    F = transition(omega, gyro, dt)
    return FilterState(q, state.x, F.around(state.P) + noise), F


def process_noise(rotation: Array, bias: Array) -> Array:
    """Covariance (..., 16, 16) that a step adds, of variances (..., 1) of rotation and bias of each axis."""
    both = rotation * _ROTATION_NOISE + bias * _BIAS_NOISE
    return both.reshape(*rotation.shape[:-1], SIZE, SIZE)


def bias_variance(P: Array) -> Array:
    """Largest variance of the gyro bias (..., 1) [rad²/s²] in a covariance (..., 16, 16)."""
    diagonal = P.reshape(*P.shape[:-2], SIZE * SIZE)[..., :: SIZE + 1]
    if is_single(diagonal):
        return np.array([max(diagonal[BIAS].tolist())])
    return diagonal[..., BIAS].max(axis=-1, keepdims=True)


def shifted(state: FilterState, dx: Array) -> FilterState:
    """Apply a correction (..., 16) of the error state; the covariance stays."""
    turn = quaternion_from_rotation_vector(dx[..., ROTATION])
    return FilterState(normalise(quaternion_product(state.q_xyzw, turn)), state.x + dx[..., 3:], state.P)


def predicted_angles(state: FilterState, angles: Array, H: Array) -> Array:
    """Euler angles that the attitude sensor should read: as they were ``tau`` ago."""
    return angles + H[..., DELAY] * state.x[..., 12:13]


def measurement_matrix(angles: Array, omega: Array) -> Array:
    """H = E [I, 0, 0, -omega] (..., 3, 16) at Euler angles (..., 3) and body rate (..., 3)."""
    E = euler_matrix(angles)
    if is_single(omega):
        return E @ (omega @ _DELAYED + _DIRECT).reshape(3, SIZE)
    xp = namespace(omega)
    unseen = xp.zeros((*omega.shape[:-1], 3, DELAY - 3))
    return xp.concatenate([E, unseen.astype(E.dtype), -product(E, omega[..., None])], axis=-1)


def euler_matrix(angles: Array) -> Array:
    """E (..., 3, 3) of (4), with the cosine of pitch kept away from zero."""
    xp = namespace(angles)
    (s_phi, s_theta, _), (c_phi, c_theta, _) = components(xp.sin(angles)), components(xp.cos(angles))
    if isinstance(c_theta, float):
        secant = 1.0 / math.copysign(max(abs(c_theta), MIN_COS_PITCH), c_theta)
        tangent = s_theta * secant
        return np.array(
            [
                [1.0, s_phi * tangent, c_phi * tangent],
                [0.0, c_phi, -s_phi],
                [0.0, s_phi * secant, c_phi * secant],
            ]
        )
    one, zero = xp.ones_like(s_phi), xp.zeros_like(s_phi)
    secant = xp.where(c_theta < 0.0, -1.0, 1.0) / xp.maximum(xp.abs(c_theta), MIN_COS_PITCH)
    tangent = s_theta * secant
    rows = [
        [one, s_phi * tangent, c_phi * tangent],
        [zero, c_phi, -s_phi],
        [zero, s_phi * secant, c_phi * secant],
    ]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def updated(
    state: FilterState, H: Array, residual: Array, variance: Array, taken: Array
) -> tuple[FilterState, Array]:
    """Correct by a measurement, axis by axis as ``taken`` says.

    Parameters
    ----------
    state : FilterState
    H : array (..., 3, 16)
    residual : array (..., 3)
        Measured minus predicted Euler angles [rad].
    variance : array (..., 3)
        Of each axis [rad²].
    taken : array (..., 3) bool
        The others are left out.

    Returns
    -------
    FilterState, and the correction (..., 16) that was made.
    """
    xp = namespace(residual)
    PH = product(state.P, H.swapaxes(-1, -2), MEASURED)
    S = product(H, PH, MEASURED) + xp.where(taken, variance, REFUSED)[..., None] * _AXES
    whitening = _whitening(S)
    W = product(PH, whitening)  # K = W whitening', and K S K' = W W', symmetric to the last bit
    white = product(whitening.swapaxes(-1, -2), xp.where(taken, residual, 0.0)[..., None])
    dx = product(W, white)[..., 0]
    P = state.P - product(W, W.swapaxes(-1, -2))
    return shifted(state._replace(P=P), dx), dx


def _whitening(S: Array) -> Array:
    """L^-T (..., 3, 3) of the Cholesky factor L of a symmetric positive definite matrix (..., 3, 3)."""
    a, _, _, b, d, _, c, e, f = components(S.reshape(*S.shape[:-2], 9))
    sqrt = math.sqrt if isinstance(a, float) else namespace(S).sqrt
    i00 = 1.0 / sqrt(a)
    l10, l20 = b * i00, c * i00
    i11 = 1.0 / sqrt(d - l10 * l10)
    l21 = (e - l20 * l10) * i11
    i22 = 1.0 / sqrt(f - l20 * l20 - l21 * l21)
    i10 = -l10 * i00 * i11
    i20, i21 = -(l20 * i00 + l21 * i10) * i22, -l21 * i11 * i22
    zero = 0.0 * a
    return stacked([i00, i10, i20, zero, i11, i21, zero, zero, i22]).reshape(S.shape)


def _measurement() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """[I, 0, 0, -omega] as omega @ (3, 48) + (48,)."""
    direct, delayed = np.zeros((3, SIZE)), np.zeros((3, 3, SIZE))
    direct[:, ROTATION] = np.eye(3)
    for i in range(3):
        delayed[i, i, SIZE - 1] = -1.0
    return direct.ravel(), delayed.reshape(3, -1)


def _noise(where: slice) -> NDArray[np.float64]:
    """Covariance of the error (256,) per variance of three of its elements."""
    found = np.zeros(SIZE)
    found[where] = 1.0
    return np.diag(found).ravel()


_AXES = np.eye(3)
_ROTATION_NOISE, _BIAS_NOISE = _noise(ROTATION), _noise(BIAS)
_DIRECT, _DELAYED = _measurement()
