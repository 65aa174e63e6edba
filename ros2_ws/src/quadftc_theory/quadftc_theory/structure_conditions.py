"""The structural conditions of the paper's fault observers: Assumption 1, Lemma 1, observability, zeros.

They ask nothing of the gains; where one of the ranks fails, no gain helps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from quadftc_theory.conditions import Condition, Verdict, verdict
from quadftc_theory.linear_model import (
    AffineModel,
    Augmented,
    Zeros,
    augment,
    decouple,
    invariant_zeros,
    rank,
    unobservable_modes,
    zero_directions,
)

ZERO = 1e-9  # element of (11), or real part of a zero [rad/s], that counts as zero


def structure_conditions(model: AffineModel, needed: bool = True) -> list[Condition]:
    """Judge a model (6); ``needed`` says whether the scheme under test is built on it."""
    found = [_assumption_1(model), _dimensions(model)]
    try:
        parts = decouple(model)
    except ValueError as error:
        text = f"infeasible, whatever the gains: {error}"
        found.append(Condition("Lemma 1, (10)-(11)", Verdict.FAIL, text))
    else:
        text = (
            f"T and S computed; the zero blocks of (11) are zero to {parts.residual:.1e}, "
            f"det T = {np.linalg.det(parts.T):.3g}, det S = {np.linalg.det(parts.S):.3g}"
        )
        numbers = {"residual": parts.residual, "T": parts.T.tolist(), "S": parts.S.tolist()}
        system = augment(parts)
        zeros = invariant_zeros(system.A, system.F, system.C)
        found += [
            Condition("Lemma 1, (10)-(11)", verdict(parts.residual <= ZERO), text, numbers),
            _observability(system),
            _zeros(model, system, zeros),
            _matching(system, zeros),
        ]
    return [dataclasses.replace(item, needed=needed) for item in found]


def _assumption_1(model: AffineModel) -> Condition:
    of_CW, of_W = rank(model.C @ model.W), rank(model.W)
    text = f"rank(C W) = {of_CW}, rank(W) = {of_W}"
    if of_CW < of_W:
        text += ": the output cannot tell every disturbance from its first derivative"
    numbers = {"rank_CW": of_CW, "rank_W": of_W}
    return Condition("Assumption 1, rank(C W) = rank(W)", verdict(of_CW == of_W), text, numbers)


def _dimensions(model: AffineModel) -> Condition:
    p, r, q = len(model.C), rank(model.W), rank(model.F)
    text = f"p = {p} outputs, r = {r} disturbances, q = {q} faults: {p - r} {'>=' if p - r >= q else '<'} {q}"
    if p - r < q:
        text += f"; {r} outputs go into the disturbances, {p - r} are left for {q} faults"
    return Condition("p - r >= q", verdict(p - r >= q), text, {"p": p, "r": r, "q": q})


def _observability(system: Augmented) -> Condition:
    hidden, order = unobservable_modes(system.A, system.C), len(system.A)
    text = f"all {order} states" if len(hidden) == 0 else f"not seen: modes at {_listed(hidden)} rad/s"
    numbers = {"order": order, "unobservable": len(hidden)}
    return Condition("(A-bar, C-bar) observable", verdict(len(hidden) == 0), text, numbers)


def _zeros(model: AffineModel, system: Augmented, zeros: Zeros) -> Condition:
    numbers = {"zeros": [[zero.real, zero.imag] for zero in zeros.values], "normal_rank": zeros.normal_rank}
    outcome, text = _judge_zeros(model, system, zeros)
    return Condition("invariant zeros of (A-bar, F-bar, C-bar)", outcome, text, numbers)


def _judge_zeros(model: AffineModel, system: Augmented, zeros: Zeros) -> tuple[Verdict, str]:
    """What the invariant zeros of (A-bar, F-bar, C-bar) mean for each fault."""
    q = system.F.shape[1]
    if zeros.normal_rank < q:
        text = f"normal rank {zeros.normal_rank} < {q} faults: some faults leave no trace at any frequency"
        return Verdict.FAIL, text
    if len(zeros.values) == 0:
        return Verdict.PASS, "none: every fault shows"
    at = f"{len(zeros.values)} at s = {_listed(np.unique(np.round(zeros.values, 9)))} rad/s"
    fastest = float(zeros.values.real.max())
    if fastest > ZERO:
        return (
            Verdict.FAIL,
            f"{at}: a fault growing as exp({fastest:.3g} t) leaves no trace; its estimate diverges",
        )
    if np.all(np.abs(zeros.values) >= ZERO):
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
    seen, of_F = rank(system.C @ system.F), rank(system.F)
    stable = bool(np.all(zeros.values.real < -ZERO))
    none = "exists for no gain, as zeros are not stable: "
    if seen < of_F:
        text = f"rank(C-bar F-bar) = {seen} < rank(F-bar) = {of_F}: v2 cannot act against f_s"
        outcome = Verdict.FAIL
    elif stable:
        outcome, text = Verdict.PASS, "exists"
    elif np.all(zeros.values.real < ZERO):
        rest = "V2 of Theorem 1 can at best stay level, it need not fall; errors along the zeros remain"
        outcome, text = Verdict.DEPENDS, none + rest
    else:
        outcome, text = Verdict.FAIL, none + "V2 of Theorem 1 grows"
    numbers = {"rank_CF": seen, "rank_F": of_F, "zeros_stable": stable}
    return Condition("(34): P-bar with F-bar' P-bar = F0 C-bar", outcome, text, numbers)


def _listed(values: Iterable[complex]) -> str:
    return ", ".join(f"{value.real:.3g}" if abs(value.imag) < 1e-9 else f"{value:.3g}" for value in values)
