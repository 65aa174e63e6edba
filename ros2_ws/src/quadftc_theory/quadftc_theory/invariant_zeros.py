"""Invariant zeros of (A, B, C), with any number of inputs and outputs.

    x' = A x + B u,  y = C x + D u,   zeros: s where the pencil [A - s I, B; C, D] loses rank

Emami-Naeini and Van Dooren (1982): outputs that D does not reach fix some states by themselves. The rows of C
that fix them go, the derivatives of those states become outputs, and the finite zeros stay. Where nothing is
left to fix, D has full row rank. The same on the dual system makes D invertible, and the zeros are
the eigenvalues of A - B D^-1 C.

Each step is orthogonal, so the ranks are judged against one norm, that of the whole pencil.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig, svd

Matrix = NDArray[np.float64]
Zeros = NDArray[np.complex128]  # (k,) [rad/s]

TOLERANCE = 1e-9  # of singular values; matrices here are of order one


class _Pencil(NamedTuple):
    A: Matrix  # (n, n)
    B: Matrix  # (n, inputs)
    C: Matrix  # (outputs, n)
    D: Matrix  # (outputs, inputs)

    def transpose(self) -> _Pencil:
        return _Pencil(self.A.T, self.C.T, self.B.T, self.D.T)


def invariant_zeros(A: Matrix, B: Matrix, C: Matrix) -> tuple[Zeros, int]:
    """Where the pencil [A - s I, B; C, 0] loses rank: inputs exp(s t) that leave no trace in the output.

    Also return the normal rank of the transfer matrix C (s I - A)^-1 B.
    """
    tolerance = TOLERANCE * float(np.sqrt(sum(np.sum(np.square(M)) for M in (A, B, C))))
    wide = _fix_states(_Pencil(A, B, C, np.zeros((len(C), B.shape[1]))), tolerance)
    square = _fix_states(wide.transpose(), tolerance)
    n, normal_rank = square.B.shape
    # Through the null space of [C, D], not through D^-1: D may be nearly singular.
    kernel = svd(np.hstack([square.C, square.D]))[2][normal_rank:].T
    values = eig(np.hstack([square.A, square.B]) @ kernel, kernel[:n], right=False)
    return np.sort_complex(np.asarray(values, np.complex128)), normal_rank


def _fix_states(pencil: _Pencil, tolerance: float) -> _Pencil:
    """The pencil with the same finite zeros whose D has full row rank."""
    while True:
        rotation, size, _ = _split(pencil.D, tolerance)
        outputs, blind = rotation[:, :size].T, rotation[:, size:].T
        _, fixed, axes = _split(blind @ pencil.C, tolerance)
        A, B, C, D = pencil.A, pencil.B, outputs @ pencil.C, outputs @ pencil.D
        if fixed == 0:
            return _Pencil(A, B, C, D)
        known, free = axes[:fixed], axes[fixed:]
        pencil = _Pencil(
            A=free @ A @ free.T,
            B=free @ B,
            C=np.vstack([C @ free.T, known @ A @ free.T]),
            D=np.vstack([D, known @ B]),
        )


def _split(matrix: Matrix, tolerance: float) -> tuple[Matrix, int, Matrix]:
    """Orthogonal U, the rank, and orthogonal V' of a singular value decomposition."""
    if 0 in matrix.shape:
        return np.eye(len(matrix)), 0, np.eye(matrix.shape[1])
    left, values, right = svd(matrix)
    return left, int(np.sum(values > tolerance)), right
