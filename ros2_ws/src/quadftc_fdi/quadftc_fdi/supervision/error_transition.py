"""Transition of the error of the inertial filter over a step.

    delta' = -omega x delta + delta_M g - delta_b
    F = [[A, G], [0, I]],   A = I - [omega]x dt,   G = dt [-I, I (x) g', 0]

For one vehicle NumPy is quickest with F as a matrix. Batches keep A and g dt alone: a twentieth of the work.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from quadftc_model.arrays import AnyArray, Array, Vector, components, is_single, namespace, product

if TYPE_CHECKING:
    from jaxtyping import Float

    ErrorColumns = Float[AnyArray, "*batch 16 n"]
    Covariance = Float[AnyArray, "*batch 16 16"]  # of the error state
else:
    ErrorColumns = Covariance = Array

SIZE = 16  # of the error state
ROTATION, BIAS, DELAY = slice(0, 3), slice(3, 6), 15


class Transition(Protocol):
    """The transition F of the error."""

    def of(self, x: ErrorColumns) -> ErrorColumns:
        """F x."""
        ...

    def around(self, P: Covariance) -> Covariance:
        """F P F', symmetric."""
        ...


def transition(omega: Vector, gyro: Vector, dt: float) -> Transition:
    """Transition over ``dt`` [s] at a body rate and a gyro sample [rad/s]."""
    if is_single(omega):
        moving = np.concatenate([omega, gyro]) * dt
        return _Matrix((moving @ _TRANSITION + _at_rest(dt)).reshape(SIZE, SIZE))
    xp = namespace(omega)
    p, q, r = components(omega * dt)
    one = xp.ones_like(p)
    A = [one, r, -q, -r, one, p, q, -p, one]
    return _Blocks(xp.stack(A, axis=-1).reshape(*omega.shape, 3), gyro * dt, dt)


class _Matrix(NamedTuple):
    F: Array  # (16, 16)

    def of(self, x: Array) -> Array:
        return self.F @ x

    def around(self, P: Array) -> Array:
        FPF = self.F @ P @ self.F.T
        return 0.5 * (FPF + FPF.T)


class _Blocks(NamedTuple):
    A: Array  # (..., 3, 3)
    g: Array  # (..., 3) gyro times dt
    dt: float

    def of(self, x: Array) -> Array:
        rotation = product(self.A, x[..., ROTATION, :]) + self._G(x[..., 3:, :])
        return namespace(x).concatenate([rotation, x[..., 3:, :]], axis=-2)

    def around(self, P: Array) -> Array:
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
        g = components(self.g)
        aligned = [g[i][..., None, None] * x[..., 3 + i : 12 : 3, :] for i in range(3)]
        return sum(aligned, -self.dt * x[..., :3, :])


@functools.lru_cache(maxsize=256)
def _at_rest(dt: float) -> NDArray[np.float64]:
    """F (256,) at omega = g = 0."""
    F = np.eye(SIZE)
    F[ROTATION, BIAS] = -dt * np.eye(3)
    F.setflags(write=False)
    return F.ravel()


def _transition() -> NDArray[np.float64]:
    """Derivative (6, 256) of F by (omega, g) dt: -[omega]x, and g against the rows of M."""
    dF = np.zeros((6, SIZE, SIZE))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        dF[i, j, k], dF[i, k, j] = 1.0, -1.0  # -[omega]x
        for row in range(3):
            dF[3 + i, row, 6 + 3 * row + i] = 1.0
    return dF.reshape(6, -1)


_TRANSITION = _transition()
