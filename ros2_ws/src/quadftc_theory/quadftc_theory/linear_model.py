# pyright: basic
"""The affine model (6) of Wang, Huang and Zhang (2021), Lemma 1 for any choice of outputs, and its zeros.

    (6)  x' = A x + D f(x) + B u + W Delta_d,   y = C x + F f_s,   x = [angles, body rate]

The paper takes the angles alone as its output and leaves W open. Here W = [0; I]: disturbances are angular
accelerations. With the output of an IMU message, y = [angles; body rate]. D and B enter no condition.

Lemma 1 splits the model where disturbances and faults part:

    (10)  z = T x,  h = S y
    (11)  S C T^-1 = [C1 0; 0 C4],  S F = [0; F2],  T W = [W1; 0]

The first part is measured without fault; the second is free of disturbances. The paper states the lemma under
Assumption 1, rank(C W) = rank(W). That is not enough: S1 must be blind to F and still see all of C W, that is

    rank [C W, F] = rank(W) + rank(F),

and p - r >= q follows. Construction: the rows of N span the left null space of F, S1 = (N C W)^+ N, T1 =
S1 C. S2 is the left null space of C W, T2 that of W. Then C1 = I, and W1 = I where W has full
column rank (else a basis of its columns stands for W).

The structural conditions ask nothing of the gains: where one of the ranks fails, no gain helps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space, orth, qr

from quadftc_theory.conditions import Condition, Verdict, assess, pairs
from quadftc_theory.invariant_zeros import TOLERANCE, Matrix, Zeros, invariant_zeros

ANGLES = ("roll", "pitch", "yaw")
OUTPUTS = {"angles": ANGLES, "imu": (*ANGLES, "p", "q", "r")}
ZERO = 1e-9  # element of (11), or real part of a zero [rad/s], that counts as zero


class AffineModel(NamedTuple):
    """The matrices of (6)."""

    A: Matrix  # (n, n)
    W: Matrix  # (n, disturbances)
    C: Matrix  # (p, n)
    F: Matrix  # (p, q)
    fault_names: tuple[str, ...]  # (q,)


class Decoupled(NamedTuple):
    """The model in z = T x and h = S y: r states and outputs of the first part (12), then the second (13)."""

    T: Matrix  # (n, n)
    S: Matrix  # (p, p)
    model: AffineModel  # T A T^-1, T W, S C T^-1, S F
    r: int  # rank of W
    residual: float  # largest element of the blocks that (11) wants to be zero


class Augmented(NamedTuple):
    """The second part with z3 = int h2 as a state (14)."""

    A: Matrix  # A-bar (n + p - 2 r, n + p - 2 r)
    F: Matrix  # F-bar (..., q)
    C: Matrix  # C-bar (p - r, ...)


def attitude_model(output: str = "imu", faulty: Sequence[str] = ANGLES) -> AffineModel:
    """Return (6)-(7) with the output of an IMU message, or the ``angles`` alone as in the paper.

    ``faulty`` are the outputs with a fault: roll, pitch, yaw, p, q, r. Other names raise ValueError.
    """
    if output not in OUTPUTS:
        raise ValueError(f"output = {output!r}: expected one of {', '.join(OUTPUTS)}")
    names = OUTPUTS[output]
    if unknown := [name for name in faulty if name not in names]:
        raise ValueError(f"faulty = {unknown[0]!r}: the outputs are {', '.join(names)}")
    return AffineModel(
        A=np.eye(6, k=3),
        W=np.eye(6)[:, 3:],
        C=np.eye(6)[: len(names)],
        F=np.eye(len(names))[:, [names.index(name) for name in faulty]],
        fault_names=tuple(faulty),
    )


def decouple(model: AffineModel) -> Decoupled:
    """Compute the transformation of Lemma 1; ValueError, with the rank that fails, if there is none."""
    A, W, C, F, _ = model
    r, q, CW = rank(W), rank(F), C @ W
    if rank(CW) < r:
        why = "outputs do not see every disturbance at once"
        raise ValueError(f"rank(C W) = {rank(CW)} < rank(W) = {r}: {why}")
    if (together := rank(np.hstack([CW, F]))) < r + q:
        why = "a fault looks like a disturbance"
        raise ValueError(f"rank [C W, F] = {together} < rank(W) + rank(F) = {r + q}: {why}")
    N = _left_null_space(F)
    basis_of_W = _reduced(orth(W, rcond=TOLERANCE).T).T
    S1 = np.linalg.pinv(N @ C @ basis_of_W) @ N
    S = np.vstack([S1, _left_null_space(CW)])
    T = np.vstack([S1 @ C, _left_null_space(W)])
    T_inverse = np.linalg.inv(T)
    split = model._replace(A=T @ A @ T_inverse, W=T @ W, C=S @ C @ T_inverse, F=S @ F)
    zero = (split.C[:r, r:], split.C[r:, :r], split.F[:r], split.W[r:])
    residual = max((float(np.max(np.abs(block))) for block in zero if block.size), default=0.0)
    return Decoupled(T, S, split, r, residual)


def augment(parts: Decoupled) -> Augmented:
    """Return the augmented system (14)."""
    r, (A, _, C, F, _) = parts.r, parts.model
    A4, C4, F2 = A[r:, r:], C[r:, r:], F[r:]
    n2, m2 = len(A4), len(C4)
    return Augmented(
        A=np.block([[A4, np.zeros((n2, m2))], [C4, np.zeros((m2, m2))]]),
        F=np.vstack([np.zeros((n2, F2.shape[1])), F2]),
        C=np.hstack([np.zeros((m2, n2)), np.eye(m2)]),
    )


def rank(matrix: Matrix) -> int:
    """Numerical rank; 0 for a matrix without rows or columns."""
    return int(np.linalg.matrix_rank(matrix, tol=TOLERANCE))


def stable(A: Matrix) -> bool:
    """Whether A is Hurwitz: every eigenvalue in the open left half-plane."""
    return bool(np.all(np.linalg.eigvals(A).real < -TOLERANCE))


def unobservable_modes(A: Matrix, C: Matrix) -> Matrix:
    """Eigenvalues of A that C does not see: rank [A - s I; C] < n (Popov, Belevitch, Hautus)."""
    n = len(A)
    return np.array([s for s in np.linalg.eigvals(A) if rank(np.vstack([A - s * np.eye(n), C])) < n])


def zero_directions(A: Matrix, F: Matrix, C: Matrix, s: complex) -> Matrix:
    """Inputs (k, q) of the zero directions at s: faults f exp(s t) with a state that hides them."""
    n, q, p = len(A), F.shape[1], len(C)
    pencil = np.block([[A - s * np.eye(n), F], [C, np.zeros((p, q))]])
    return null_space(pencil, rcond=TOLERANCE)[n:].T


def structure_conditions(model: AffineModel, needed: bool = True) -> list[Condition]:
    """Judge a model (6); ``needed`` says whether the scheme under test is built on it."""
    return [dataclasses.replace(item, needed=needed) for item in _structure_conditions(model)]


def _structure_conditions(model: AffineModel) -> Iterator[Condition]:
    of_CW, of_W = rank(model.C @ model.W), rank(model.W)
    text = f"rank(C W) = {of_CW}, rank(W) = {of_W}"
    if of_CW < of_W:
        text += ": the output cannot tell every disturbance from its first derivative"
    yield assess("Assumption 1, rank(C W) = rank(W)", of_CW == of_W, text, rank_CW=of_CW, rank_W=of_W)

    p, r, q = len(model.C), of_W, rank(model.F)
    text = f"p = {p} outputs, r = {r} disturbances, q = {q} faults: {p - r} {'>=' if p - r >= q else '<'} {q}"
    if p - r < q:
        text += f"; {r} outputs go into the disturbances, {p - r} are left for {q} faults"
    yield assess("p - r >= q", p - r >= q, text, p=p, r=r, q=q)

    try:
        parts = decouple(model)
    except ValueError as error:
        yield assess("Lemma 1, (10)-(11)", False, f"infeasible, whatever the gains: {error}")
        return
    T, S, residual = parts.T, parts.S, parts.residual
    text = f"T and S computed; the zero blocks of (11) are zero to {residual:.1e}, "
    text += f"det T = {np.linalg.det(T):.3g}, det S = {np.linalg.det(S):.3g}"
    numbers = {"residual": residual, "T": T.tolist(), "S": S.tolist()}
    yield assess("Lemma 1, (10)-(11)", residual <= ZERO, text, **numbers)

    system = augment(parts)
    hidden, order = unobservable_modes(system.A, system.C), len(system.A)
    text = f"not seen: modes at {_listed(hidden)} rad/s" if len(hidden) else f"all {order} states"
    yield assess("(A-bar, C-bar) observable", not len(hidden), text, order=order, unobservable=len(hidden))

    zeros, normal_rank = invariant_zeros(system.A, system.F, system.C)
    outcome, text = _judge_zeros(model, system, zeros, normal_rank)
    numbers = {"zeros": pairs(zeros), "normal_rank": normal_rank}
    yield Condition("invariant zeros of (A-bar, F-bar, C-bar)", outcome, text, numbers)
    yield _matching(system, zeros)


def _judge_zeros(model: AffineModel, system: Augmented, zeros: Zeros, normal: int) -> tuple[Verdict, str]:
    """What the invariant zeros of (A-bar, F-bar, C-bar) mean for each fault."""
    if normal < (q := system.F.shape[1]):
        return Verdict.FAIL, f"normal rank {normal} < {q} faults: some faults leave no trace at any frequency"
    if len(zeros) == 0:
        return Verdict.PASS, "none: every fault shows"
    at = f"{len(zeros)} at s = {_listed(np.unique(np.round(zeros, 9)))} rad/s"
    fastest = float(zeros.real.max())
    if fastest > ZERO:
        text = f"{at}: a fault growing as exp({fastest:.3g} t) leaves no trace; its estimate diverges"
        return Verdict.FAIL, text
    if np.all(np.abs(zeros) >= ZERO):
        if fastest < 0.0:
            return Verdict.PASS, f"{at}: hidden faults die out within {1.0 / -fastest:.3g} s"
        return Verdict.DEPENDS, f"{at}: hidden"
    touched = np.any(np.abs(zero_directions(system.A, system.F, system.C, 0.0)) > ZERO, axis=0)
    names = ", ".join(name for name, hit in zip(model.fault_names, touched, strict=True) if hit)
    text = f"{at}: a constant fault on {names} and the opposite constant error of its estimated angle look "
    return Verdict.DEPENDS, text + "the same; right only from a healthy start and without gyro bias"


def _matching(system: Augmented, zeros: Zeros) -> Condition:
    """Whether some P-bar > 0 has both V2' < 0 and F-bar' P-bar = F0 C-bar, as (34) uses in silence.

    By Corless and Tu (1998): if and only if rank(C-bar F-bar) = rank(F-bar) and the zeros are stable.
    """
    seen, of_F, decaying = rank(system.C @ system.F), rank(system.F), bool(np.all(zeros.real < -ZERO))
    outcome, text = Verdict.FAIL, "exists for no gain, as zeros are not stable: "
    if seen < of_F:
        text = f"rank(C-bar F-bar) = {seen} < rank(F-bar) = {of_F}: v2 cannot act against f_s"
    elif decaying:
        outcome, text = Verdict.PASS, "exists"
    elif np.all(zeros.real < ZERO):
        outcome = Verdict.DEPENDS
        text += "V2 of Theorem 1 can at best stay level, it need not fall; errors along the zeros remain"
    else:
        text += "V2 of Theorem 1 grows"
    numbers = {"rank_CF": seen, "rank_F": of_F, "zeros_stable": decaying}
    return Condition("(34): P-bar with F-bar' P-bar = F0 C-bar", outcome, text, numbers)


def _listed(values: Iterable[complex]) -> str:
    return ", ".join(f"{value.real:.3g}" if abs(value.imag) < 1e-9 else f"{value:.3g}" for value in values)


def _left_null_space(matrix: Matrix) -> Matrix:
    """Rows N (p - rank, p) with N matrix = 0, in a form with as many ones and zeros as can be."""
    p, q = matrix.shape
    return _reduced(np.eye(p) if q == 0 else null_space(matrix.T, rcond=TOLERANCE).T)


def _reduced(rows: Matrix) -> Matrix:
    """The same row space in reduced form, pivots chosen for a good condition."""
    if len(rows) == 0:
        return rows
    pivots = np.sort(qr(rows, mode="economic", pivoting=True)[2][: len(rows)])
    reduced = np.linalg.solve(rows[:, pivots], rows)
    reduced[np.abs(reduced) < TOLERANCE] = 0.0
    return np.asarray(reduced, np.float64)
