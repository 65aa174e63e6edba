r"""How much thrust has a rotor lost? A Kalman filter of the losses of the rotors that are named.

    r_0 - d_0 = - sum_i b_i w_i s_i + n,    s_i' = white noise,    0 <= s_i <= 1

r_0, d_0 and b_i w_i are those of `evidence`, by the shortest average. n is the disturbance. It lasts for
about the third average, so it counts as white noise of the same density at low frequency. The loss of a rotor
that is not named is zero, and known to be.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.rotor_diagnosis.evidence import TIMES, Residuals
from quadftc_fdi.rotor_diagnosis.rotor_model import Effects
from quadftc_model.arrays import (
    Array,
    Scalar,
    clip,
    diagonal,
    larger,
    namespace,
    smaller,
    solve_positive,
    sqrt,
    where,
)

UNKNOWN = 0.25  # 1; standard deviation of a loss at first, and at most
CHANGES = 0.03  # 1/sqrt(s); random walk of a loss
JUMPED, JUMP = 25.0, 0.1  # 1; l of a loss that has changed; standard deviation of a change


class Losses(NamedTuple):
    """Loss of each rotor, and the covariance of all."""

    mean: Array  # s (..., n) [1]
    covariance: Array  # (..., n, n)


def start_losses(thrusts: Array) -> Losses:
    """Start without a loss; thrusts (..., n)."""
    zeros = namespace(thrusts).zeros_like(thrusts)
    return Losses(zeros, _diagonal(zeros))


def open_losses(state: Losses, new: Array, loss: Array) -> Losses:
    """Begin with the ``new`` ones (..., n), at a loss (..., n)."""
    mean = where(new, clip(loss, 0.0, 1.0), state.mean)
    return Losses(mean, state.covariance + _diagonal(new * UNKNOWN**2))


def close_losses(state: Losses, healthy: Array) -> Losses:
    """Forget the losses of rotors that are ``healthy`` (..., n)."""
    kept = 1.0 - healthy
    return Losses(state.mean * kept, state.covariance * kept[..., None] * kept[..., None, :])


def correct_losses(
    state: Losses, seen: Residuals, effects: Effects, named: Array, change: Array, unheard: Array, dt: Scalar
) -> Losses:
    """Advance by ``dt`` [s]; ``change`` is l of what the known losses leave (..., n).

    ``unheard``: variance by what no sensor tells (..., K, 4).
    """
    n = change.shape[-1]
    noise = CHANGES**2 * dt + JUMP**2 * (change > JUMPED)
    room = larger(UNKNOWN**2 - diagonal(state.covariance), 0.0)
    P = state.covariance + _diagonal(named * smaller(noise, room))
    # four channels at once
    H = -effects.rows * (named * seen.mean[..., 0, 4 : 4 + n])[..., None, :]  # (..., 4, n)
    variance = seen.variance + unheard
    density = 2.0 * (TIMES[0] * variance[..., 0, :] + TIMES[2] * variance[..., 2, :])
    R = _diagonal(density / larger(dt, 1e-6))
    PH = P @ H.swapaxes(-1, -2)
    gain = solve_positive(H @ PH + R, PH.swapaxes(-1, -2)).swapaxes(-1, -2)  # (..., n, 4)
    innovation = seen.mean[..., 0, :4] - seen.usual - (H @ state.mean[..., None])[..., 0]
    mean = clip(state.mean + (gain @ innovation[..., None])[..., 0], 0.0, 1.0)
    left = P - gain @ PH.swapaxes(-1, -2)
    return Losses(mean, 0.5 * (left + left.swapaxes(-1, -2)))


def std_dev_of(state: Losses) -> Array:
    """Standard deviation of each loss (..., n)."""
    return sqrt(larger(diagonal(state.covariance), 0.0))


def _diagonal(parts: Array) -> Array:
    return parts[..., None] * np.eye(parts.shape[-1])
