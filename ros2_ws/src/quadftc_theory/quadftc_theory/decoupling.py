"""Lemma 1 of Wang, Huang and Zhang (2021) for any model (6): split it where disturbances and faults part.

    (10)  z = T x,  h = S y
    (11)  S C T^-1 = [C1 0; 0 C4],  S F = [0; F2],  T W = [W1; 0]

The first part is moved by disturbances and measured without fault; the second is free of disturbances and
measured with the faults. The paper states the lemma under Assumption 1, rank(C W) = rank(W). That is not
enough: the rows S1 must be blind to F and still see all of C W, which asks for

    rank [C W, F] = rank(W) + rank(F),

and p - r >= q follows. Construction: N with N F = 0 (its rows span the left null space), S1 = (N C W)^+ N, S2
the left null space of C W, T1 = S1 C, T2 the left null space of W. Then C1 = I, and W1 = I where W has full
column rank (else a basis of its columns stands for W).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_theory.linear_form import AffineModel
from quadftc_theory.linear_systems import column_basis, left_null_space, rank

Matrix = NDArray[np.float64]


class Decoupled(NamedTuple):
    """The blocks of (11)-(13)."""

    T: Matrix  # (n, n)
    S: Matrix  # (p, p)
    A1: Matrix  # (r, r)
    A2: Matrix  # (r, n - r)
    A3: Matrix  # (n - r, r)
    A4: Matrix  # (n - r, n - r)
    B1: Matrix  # (r, m)
    B2: Matrix  # (n - r, m)
    D1: Matrix  # (r, s)
    D2: Matrix  # (n - r, s)
    C1: Matrix  # (r, r)
    C4: Matrix  # (p - r, n - r)
    F2: Matrix  # (p - r, q)
    W1: Matrix  # (r, disturbances)
    residual: float  # largest element of the blocks that (11) wants to be zero


class Augmented(NamedTuple):
    """The second part with z3 = int h2 as a state (14), and A2-bar of (15)."""

    A: Matrix  # A-bar (n + p - 2 r, n + p - 2 r)
    A3: Matrix  # A3-bar (..., r)
    D2: Matrix  # D2-bar (..., s)
    B: Matrix  # B-bar (..., m)
    F: Matrix  # F-bar (..., q)
    C: Matrix  # C-bar (p - r, ...)
    A2: Matrix  # A2-bar (r, ...)


def decouple(model: AffineModel) -> Decoupled:
    """Compute the transformation of Lemma 1 and what it makes of the model.

    Raises
    ------
    ValueError
        If there is none, saying which rank condition fails.
    """
    A, B, D, W, C, F = model[:6]
    r, q = rank(W), rank(F)
    CW = C @ W
    if rank(CW) < r:
        raise ValueError(
            f"rank(C W) = {rank(CW)} < rank(W) = {r}: outputs do not see every disturbance at once"
        )
    together = rank(np.hstack([CW, F]))
    if together < r + q:
        raise ValueError(
            f"rank [C W, F] = {together} < rank(W) + rank(F) = {r + q}: a fault looks like a disturbance"
        )
    N = left_null_space(F)
    S1 = np.linalg.pinv(N @ C @ column_basis(W)) @ N
    S = np.vstack([S1, left_null_space(CW)])
    T = np.vstack([S1 @ C, left_null_space(W)])
    T_inverse = np.linalg.inv(T)
    TAT, TB, TD, TW = T @ A @ T_inverse, T @ B, T @ D, T @ W
    SCT, SF = S @ C @ T_inverse, S @ F
    zero = (SCT[:r, r:], SCT[r:, :r], SF[:r], TW[r:])
    residual = max((float(np.max(np.abs(block))) for block in zero if block.size), default=0.0)
    return Decoupled(
        *(T, S, TAT[:r, :r], TAT[:r, r:], TAT[r:, :r], TAT[r:, r:], TB[:r], TB[r:], TD[:r], TD[r:]),
        *(SCT[:r, :r], SCT[r:, r:], SF[r:], TW[:r], residual),
    )


def augment(parts: Decoupled) -> Augmented:
    """Return the augmented system (14) and A2-bar of (15)."""
    n2, m2, r = len(parts.A4), len(parts.C4), len(parts.A1)

    def below(block: Matrix) -> Matrix:
        return np.vstack([block, np.zeros((m2, block.shape[1]))])

    return Augmented(
        A=np.block([[parts.A4, np.zeros((n2, m2))], [parts.C4, np.zeros((m2, m2))]]),
        A3=below(parts.A3),
        D2=below(parts.D2),
        B=below(parts.B2),
        F=np.vstack([np.zeros((n2, parts.F2.shape[1])), parts.F2]),
        C=np.hstack([np.zeros((m2, n2)), np.eye(m2)]),
        A2=np.hstack([parts.A2, np.zeros((r, m2))]),
    )
