"""Transition of the error state of `inertial_filter` over a step: F = [[A, G], [0, I]].

    delta' = -omega x delta + delta_M g - delta_b
    A = exp(-[omega dt]x),   G = dt [-I, I (x) g', 0]          A to second order, so that nothing grows

NumPy is quickest with F as one matrix, a batch with A and g dt, as only the upper three rows do anything.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model import arrays
from quadftc_model.arrays import (
    Array,
    Column,
    Float,
    Quaternion,
    Vector,
    components,
    is_single,
    namespace,
    product,
)

Covariance = Float[arrays.AnyArray, "*batch 16 16"]  # of the error state
Covariances = Float[arrays.AnyArray, "*batch n 16 16"]
Errors = Float[arrays.AnyArray, "*batch 16"]

SIZE = 16  # of the error state
ROTATION, BIAS, SCALE, DELAY = slice(0, 3), slice(3, 6), slice(6, 15), 15


class FilterState(NamedTuple):
    """Estimate and covariance."""

    q_xyzw: Quaternion
    x: Float[arrays.AnyArray, "*batch 13"]  # b [rad/s], M by rows [1], tau [s]
    P: Covariance  # of the error state


class ProcessNoise(NamedTuple):
    """Variances that a step adds on each axis, or alike on all."""

    rotation: Vector | Column | float  # [rad²]
    bias: Column | float  # of the gyro [rad²/s²]
    scale: Column | float = 0.0  # of its scale and alignment errors [1]


def variances(P: Covariance) -> Errors:
    """Diagonal of a covariance."""
    if type(P) is np.ndarray and P.ndim == 2:  # pyright: ignore[reportUnknownMemberType]
        return P.diagonal()
    return P.reshape(*P.shape[:-2], SIZE * SIZE)[..., :: SIZE + 1]


class MatrixTransition(NamedTuple):
    """Transition of the error of one vehicle."""

    F: NDArray[np.float64]  # (16, 16)

    def of(self, x: Array) -> Array:
        """F x of columns (16, n)."""
        return self.F.dot(x)

    def around(self, P: Covariance, earlier: Covariances, noise: ProcessNoise) -> Covariances:
        """F P F' and the noise, for P and earlier ones."""
        stack, added = np.concatenate([P[None], earlier]), np.empty(DELAY)
        result = self.F @ stack.reshape(-1, SIZE).dot(self.F.T).reshape(stack.shape)
        added[ROTATION], added[BIAS], added[SCALE] = noise.rotation, noise.bias, noise.scale
        result.reshape(-1, SIZE * SIZE)[:, : DELAY * SIZE : SIZE + 1] += added
        return result


class BlockTransition(NamedTuple):
    """Transition of the errors of a batch: A and g dt alone are a twentieth of the work."""

    A: Array  # (..., 3, 3)
    g: Array  # (..., 3) gyro times dt
    dt: float

    def of(self, x: Array) -> Array:
        """F x of columns (..., 16, n)."""
        return namespace(x).concatenate([self._upper(x), x[..., 3:, :]], axis=-2)

    def around(self, P: Covariance, earlier: Covariances, noise: ProcessNoise) -> Covariances:
        """F P F' and the noise, symmetric, for P and earlier ones."""
        variances = (noise.rotation * np.ones(3)) @ _ROTATION + (noise.bias * np.ones(3)) @ _BIAS
        variances = variances + (noise.scale * np.ones(9)) @ _SCALE
        Q = variances[..., None] * np.eye(SIZE)
        all_P = [P, *(earlier[..., index, :, :] for index in range(earlier.shape[-3]))]
        each = [self._around(P) + Q for P in all_P]
        return namespace(P).stack(each, axis=-3)

    def _around(self, P: Covariance) -> Covariance:
        xp = namespace(P)
        above = self._upper(P)
        rotation, across = self._upper(above.swapaxes(-1, -2)), above[..., 3:]
        rotation = 0.5 * (rotation + rotation.swapaxes(-1, -2))
        above = xp.concatenate([rotation, across], axis=-1)
        below = xp.concatenate([across.swapaxes(-1, -2), P[..., 3:, 3:]], axis=-1)
        return xp.concatenate([above, below], axis=-2)

    def _upper(self, x: Array) -> Array:
        """Upper three rows (..., 3, n) of F x."""
        g = components(self.g)
        aligned = [g[i][..., None, None] * x[..., 6 + i : 15 : 3, :] for i in range(3)]
        return product(self.A, x[..., ROTATION, :]) + sum(aligned, -self.dt * x[..., BIAS, :])


Transition = MatrixTransition | BlockTransition


def transition(omega: Vector, gyro: Vector, dt: float) -> Transition:
    """Transition over ``dt`` [s] at a body rate and a gyro sample [rad/s]."""
    x, y, z = [each * dt for each in components(omega)]
    xx, yy, zz, xy, xz, yz = 0.5 * x * x, 0.5 * y * y, 0.5 * z * z, 0.5 * x * y, 0.5 * x * z, 0.5 * y * z
    A = [1.0 - yy - zz, xy + z, xz - y, xy - z, 1.0 - xx - zz, yz + x, xz + y, yz - x, 1.0 - xx - yy]
    if is_single(omega):
        p, q, r = gyro.tolist()
        return MatrixTransition(np.array([*A, p * dt, q * dt, r * dt, -dt, 0.0, 1.0]).take(_PLACES))
    return BlockTransition(namespace(omega).stack(A, axis=-1).reshape(*omega.shape, 3), gyro * dt, dt)


def _places() -> NDArray[np.int64]:
    """Where each element of F stands among A (by rows), g dt, -dt, 0 and 1."""
    places = np.where(np.eye(SIZE), 14, 13)
    for row in range(3):
        places[row, ROTATION] = 3 * row + np.arange(3)
        places[row, 3 + row] = 12
        places[row, 6 + 3 * row : 9 + 3 * row] = 9 + np.arange(3)
    return places


_PLACES = _places()
_ROTATION, _BIAS, _SCALE = (np.eye(SIZE)[which] for which in (ROTATION, BIAS, SCALE))
