# pyright: basic
"""Linear systems x' = A x + F f, y = C x: ranks, observability, invariant zeros, stability.

Invariant zeros come from SLICOT (routine AB08ND, after Emami-Naeini and Van Dooren, 1982), which takes
systems that are not square, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig, null_space, orth, qr

Matrix = NDArray[np.float64]

TOLERANCE = 1e-9  # relative to the largest singular value; matrices here are of order one


def rank(matrix: Matrix) -> int:
    """Numerical rank; 0 for a matrix without rows or columns."""
    if matrix.size == 0:
        return 0
    singular = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(singular > TOLERANCE * max(1.0, singular[0])))


def left_null_space(matrix: Matrix) -> Matrix:
    """Rows N (p - rank, p) with N matrix = 0, in a form with as many ones and zeros as can be."""
    p, q = matrix.shape
    rows = np.eye(p) if q == 0 else null_space(matrix.T, rcond=TOLERANCE).T
    return _reduced(np.asarray(rows, np.float64))


def column_basis(matrix: Matrix) -> Matrix:
    """Columns (n, rank) that span those of the matrix, with as many ones and zeros as can be."""
    return _reduced(orth(matrix, rcond=TOLERANCE).T).T


def unobservable_modes(A: Matrix, C: Matrix) -> Matrix:
    """Eigenvalues of A that C does not see: rank [A - s I; C] < n (Popov, Belevitch, Hautus)."""
    n = len(A)
    modes = np.linalg.eigvals(A)
    hidden = [s for s in modes if _complex_rank(np.vstack([A - s * np.eye(n), C]).astype(np.complex128)) < n]
    return np.array(hidden)


class Zeros(NamedTuple):
    """Invariant zeros of (A, F, C)."""

    values: NDArray[np.complex128]  # (k,) [rad/s]
    normal_rank: int  # of the transfer matrix C (s I - A)^-1 F


def invariant_zeros(A: Matrix, F: Matrix, C: Matrix) -> Zeros:
    """Where the pencil [A - s I, F; C, 0] loses rank: inputs exp(s t) that leave no trace in the output.

    Parameters
    ----------
    A, F, C : array (n, n), (n, q), (p, n)
    """
    from slycot import ab08nd  # a second to load

    n, q, p = len(A), F.shape[1], len(C)
    finite, normal_rank, _, _, _, _, _, _, pencil_a, pencil_b = ab08nd(n, q, p, A, F, C, np.zeros((p, q)))
    values = eig(pencil_a[:finite, :finite], pencil_b[:finite, :finite], right=False)
    return Zeros(np.sort_complex(np.asarray(values, np.complex128)), int(normal_rank))


def zero_directions(A: Matrix, F: Matrix, C: Matrix, s: complex) -> Matrix:
    """Inputs (k, q) of the zero directions at s: faults f exp(s t) with a state that hides them."""
    n, q, p = len(A), F.shape[1], len(C)
    pencil = np.block([[A - s * np.eye(n), F], [C, np.zeros((p, q))]])
    return null_space(pencil, rcond=TOLERANCE)[n:].T


def stable(A: Matrix) -> bool:
    """Whether A is Hurwitz: every eigenvalue in the open left half-plane."""
    return bool(np.all(np.linalg.eigvals(A).real < -TOLERANCE))


def _complex_rank(matrix: NDArray[np.complex128]) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=TOLERANCE * max(1.0, float(np.linalg.norm(matrix, 2)))))


def _reduced(rows: Matrix) -> Matrix:
    """The same row space in reduced form, pivots chosen for a good condition."""
    count = len(rows)
    if count == 0:
        return rows
    pivots = np.sort(qr(rows, mode="economic", pivoting=True)[2][:count])
    reduced = np.linalg.solve(rows[:, pivots], rows)
    reduced[np.abs(reduced) < TOLERANCE] = 0.0
    return np.asarray(reduced, np.float64)
