"""Transition of the error state of `inertial_filter` over a step: F = [[A, G], [0, I]].

    delta' = -omega x delta + delta_M g - delta_b
    A = exp(-[omega dt]x),   G = dt [-I, I (x) g', 0]

Only the upper three rows do anything. A is of second order in the rotation omega dt, which is held within
`FARTHEST`: beyond, in the gaps of a tumble, that would multiply the covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_model import arrays
from quadftc_model.arrays import (
    Array,
    Column,
    Float,
    Quaternion,
    Scalar,
    Vector,
    components,
    larger,
    namespace,
    norm,
    stacked,
)

Covariance = Float[arrays.AnyArray, "*batch 16 16"]  # of the error state
Covariances = Float[arrays.AnyArray, "*batch n 16 16"]
Errors = Float[arrays.AnyArray, "*batch 16"]

SIZE = 16  # of the error state
ROTATION, BIAS, SCALE, DELAY = slice(0, 3), slice(3, 6), slice(6, 15), 15
FARTHEST = 1.0  # rad; of the rotation in A, which is an eighth too long there


class FilterState(NamedTuple):
    """Estimate and covariance."""

    q_xyzw: Quaternion
    x: Float[arrays.AnyArray, "*batch 13"]  # b [rad/s], M by rows [1], tau [s]
    P: Covariance  # of the error state


class ProcessNoise(NamedTuple):
    """Variances that a step adds on each axis, or alike on all."""

    rotation: Vector | Column  # [rad²]
    bias: Column  # of the gyro [rad²/s²]
    scale: Column  # of its scale and alignment errors [1]


class Transition(NamedTuple):
    """A, and what G is made of."""

    A: Array  # (..., 3, 3)
    g: Vector  # gyro times dt [rad]
    dt: Scalar  # [s]

    def of(self, x: Array) -> Array:
        """F x of columns (..., 16, n)."""
        return namespace(x).concatenate([self._upper(x), x[..., 3:, :]], axis=-2)

    def around(self, P: Covariances, noise: ProcessNoise) -> Covariances:
        """F P F' and the noise, symmetric to the last bit."""
        xp, several = namespace(P), Transition(self.A[..., None, :, :], self.g[..., None, :], self.dt)
        above = several._upper(P)
        rotation, across = several._upper(above.swapaxes(-1, -2)), above[..., 3:]
        rotation = 0.5 * (rotation + rotation.swapaxes(-1, -2))
        above = xp.concatenate([rotation, across], axis=-1)
        below = xp.concatenate([across.swapaxes(-1, -2), P[..., 3:, 3:]], axis=-1)
        parts = (noise.rotation, 3), (noise.bias, 3), (noise.scale, 9), (xp.zeros_like(noise.bias), 1)
        Q = xp.concatenate([variance * np.ones(count) for variance, count in parts], axis=-1)
        return xp.concatenate([above, below], axis=-2) + Q[..., None, :, None] * np.eye(SIZE)

    def _upper(self, x: Array) -> Array:
        """Upper three rows (..., 3, n) of F x."""
        upper = self.A @ x[..., ROTATION, :] - self.dt * x[..., BIAS, :]
        for i, g in enumerate(components(self.g)):
            upper = upper + g[..., None, None] * x[..., 6 + i : 15 : 3, :]
        return upper


def transition(omega: Vector, gyro: Vector, dt: Scalar) -> Transition:
    """Transition over ``dt`` [s] at a body rate and a gyro sample [rad/s]."""
    rotation = omega * dt
    x, y, z = components(rotation * (FARTHEST / larger(norm(rotation), FARTHEST)))
    xx, yy, zz, xy, xz, yz = 0.5 * x * x, 0.5 * y * y, 0.5 * z * z, 0.5 * x * y, 0.5 * x * z, 0.5 * y * z
    A = [1.0 - yy - zz, xy + z, xz - y, xy - z, 1.0 - xx - zz, yz + x, xz + y, yz - x, 1.0 - xx - yy]
    return Transition(stacked(A).reshape(*omega.shape, 3), gyro * dt, dt)
