"""Transition of the error of the inertial filter over a step: delta' = -omega x delta + delta_M g - delta_b.

Only the rotation changes, so F = [[A, G], [0, I]] with A = I - [omega]x dt and G = dt [-I, I (x) g', 0]. One
vehicle in NumPy is quickest with F as a matrix; batches, with the seven elements of each row that are not
zero, a twentieth of the work.
"""

from __future__ import annotations

import functools
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from quadftc_model.arrays import Array, components, is_single, namespace, product

SIZE = 16  # of the error state
ROTATION, BIAS, DELAY = slice(0, 3), slice(3, 6), 15


class Transition(Protocol):
    """The transition F of the error."""

    def of(self, x: Array) -> Array:
        """F x of columns (..., 16, n)."""
        ...

    def around(self, P: Array) -> Array:
        """F P F' of a covariance (..., 16, 16), symmetric."""
        ...


def transition(omega: Array, gyro: Array, dt: float) -> Transition:
    """Transition over ``dt`` [s] at a body rate and a gyro sample [rad/s], (..., 3) each."""
    if is_single(omega):
        moving = np.concatenate([omega, gyro]) * dt
        return _Matrix((moving @ _TRANSITION + _resting(dt)).reshape(SIZE, SIZE))
    xp = namespace(omega)
    p, q, r = components(omega * dt)
    one = xp.ones_like(p)
    A = [one, r, -q, -r, one, p, q, -p, one]
    return _Blocks(xp.stack(A, axis=-1).reshape(*omega.shape, 3), gyro * dt, dt)


class _Matrix(NamedTuple):
    """F itself."""

    F: Array  # (16, 16)

    def of(self, x: Array) -> Array:
        return self.F @ x

    def around(self, P: Array) -> Array:
        carried = self.F @ P @ self.F.T
        return 0.5 * (carried + carried.T)


class _Blocks(NamedTuple):
    """The part of F that is not that of the identity."""

    A: Array  # (..., 3, 3)
    g: Array  # (..., 3) gyro times dt
    dt: float

    def of(self, x: Array) -> Array:
        rotated = product(self.A, x[..., ROTATION, :]) + self._turned(x[..., 3:, :])
        return namespace(x).concatenate([rotated, x[..., 3:, :]], axis=-2)

    def around(self, P: Array) -> Array:
        xp = namespace(P)
        R, C, D = P[..., :3, :3], P[..., :3, 3:], P[..., 3:, 3:]
        across = product(self.A, C) + self._turned(D)
        turned = product(self.A, R) + self._turned(C.swapaxes(-1, -2))
        rotation = product(turned, self.A.swapaxes(-1, -2)) + self._turned(across.swapaxes(-1, -2)).swapaxes(
            -1, -2
        )
        rotation = 0.5 * (rotation + rotation.swapaxes(-1, -2))
        above = xp.concatenate([rotation, across], axis=-1)
        below = xp.concatenate([across.swapaxes(-1, -2), D], axis=-1)
        return xp.concatenate([above, below], axis=-2)

    def _turned(self, x: Array) -> Array:
        """G x of bias, alignment and delay (..., 13, n)."""
        g = components(self.g)
        moved = [g[i][..., None, None] * x[..., 3 + i : 12 : 3, :] for i in range(3)]
        return sum(moved, -self.dt * x[..., :3, :])


@functools.lru_cache(maxsize=256)
def _resting(dt: float) -> NDArray[np.float64]:
    """F (256,) without motion: the rotation falls by dt times the bias."""
    F = np.eye(SIZE)
    F[ROTATION, BIAS] = -dt * np.eye(3)
    F.setflags(write=False)
    return F.ravel()


def _transition() -> NDArray[np.float64]:
    """What (omega, g) dt adds to F (6, 256): -[omega]x, and g against the rows of M."""
    found = np.zeros((6, SIZE, SIZE))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        found[i, j, k], found[i, k, j] = 1.0, -1.0  # -[omega]x
        for row in range(3):
            found[3 + i, row, 6 + 3 * row + i] = 1.0
    return found.reshape(6, -1)


_TRANSITION = _transition()
