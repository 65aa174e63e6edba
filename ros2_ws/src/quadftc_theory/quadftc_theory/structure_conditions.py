"""The structural conditions of the paper's fault observers: Assumption 1, Lemma 1, observability, zeros.

They ask nothing of the gains; where one of the ranks fails, no gain helps.
"""

from __future__ import annotations

import numpy as np

from quadftc_theory.conditions import Condition, Verdict, verdict
from quadftc_theory.decoupling import Augmented, augment, decouple
from quadftc_theory.linear_form import AffineModel
from quadftc_theory.linear_systems import Zeros, invariant_zeros, rank, unobservable_modes, zero_directions

RESIDUAL = 1e-9  # largest element that counts as zero in (11)


def structure_conditions(model: AffineModel, needed: bool = True) -> list[Condition]:
    """Judge a model (6).

    Parameters
    ----------
    model : AffineModel
    needed : bool
        Whether the scheme under test is built on this model.
    """
    W, C, F = model.W, model.C, model.F
    p, r, q = len(C), rank(W), rank(F)
    found = [_assumption_1(rank(C @ W), r, needed), _dimensions(p, r, q, needed)]
    try:
        parts = decouple(model)
    except ValueError as error:
        text = f"infeasible, whatever the gains: {error}"
        return [*found, Condition("Lemma 1, (10)-(11)", Verdict.FAIL, text, needed=needed)]
    text = (
        f"T and S computed; the zero blocks of (11) are zero to {parts.residual:.1e}, "
        f"det T = {np.linalg.det(parts.T):.3g}, det S = {np.linalg.det(parts.S):.3g}"
    )
    numbers = {"residual": parts.residual, "T": parts.T.tolist(), "S": parts.S.tolist()}
    found.append(Condition("Lemma 1, (10)-(11)", verdict(parts.residual <= RESIDUAL), text, numbers, needed))
    system = augment(parts)
    zeros = invariant_zeros(system.A, system.F, system.C)
    return [
        *found,
        _observability(system, needed),
        _zeros(model, system, zeros, needed),
        _matching(system, zeros, needed),
    ]


def _assumption_1(of_CW: int, of_W: int, needed: bool) -> Condition:
    text = f"rank(C W) = {of_CW}, rank(W) = {of_W}"
    if of_CW < of_W:
        text += ": the output cannot tell every disturbance from its first derivative"
    return Condition(
        "Assumption 1, rank(C W) = rank(W)",
        verdict(of_CW == of_W),
        text,
        {"rank_CW": of_CW, "rank_W": of_W},
        needed,
    )


def _dimensions(p: int, r: int, q: int, needed: bool) -> Condition:
    text = f"p = {p} outputs, r = {r} disturbances, q = {q} faults: {p - r} {'>=' if p - r >= q else '<'} {q}"
    if p - r < q:
        text += f"; {r} outputs go into the disturbances, {p - r} are left for {q} faults"
    return Condition("p - r >= q", verdict(p - r >= q), text, {"p": p, "r": r, "q": q}, needed)


def _observability(system: Augmented, needed: bool) -> Condition:
    hidden = unobservable_modes(system.A, system.C)
    order = len(system.A)
    text = f"all {order} states" if len(hidden) == 0 else f"not seen: modes at {_listed(hidden)} rad/s"
    return Condition(
        "(A-bar, C-bar) observable",
        verdict(len(hidden) == 0),
        text,
        {"order": order, "unobservable": len(hidden)},
        needed,
    )


def _zeros(model: AffineModel, system: Augmented, zeros: Zeros, needed: bool) -> Condition:
    """What the invariant zeros of (A-bar, F-bar, C-bar) mean for each fault."""
    name = "invariant zeros of (A-bar, F-bar, C-bar)"
    q = system.F.shape[1]
    numbers = {"zeros": [[zero.real, zero.imag] for zero in zeros.values], "normal_rank": zeros.normal_rank}
    if zeros.normal_rank < q:
        text = f"normal rank {zeros.normal_rank} < {q} faults: some faults leave no trace at any frequency"
        return Condition(name, Verdict.FAIL, text, numbers, needed)
    if len(zeros.values) == 0:
        return Condition(name, Verdict.PASS, "none: every fault shows", numbers, needed)
    at = f"{len(zeros.values)} at s = {_listed(np.unique(np.round(zeros.values, 9)))} rad/s"
    growing = zeros.values[zeros.values.real > 1e-9]
    if len(growing):
        text = (
            f"{at}: a fault growing as exp({growing.real.max():.3g} t) leaves no trace; its estimate diverges"
        )
        return Condition(name, Verdict.FAIL, text, numbers, needed)
    still = zeros.values[np.abs(zeros.values) < 1e-9]
    if len(still) == 0:
        worst = zeros.values.real.max()
        text = f"{at}: hidden faults die out within {1.0 / -worst:.3g} s" if worst < 0.0 else f"{at}: hidden"
        return Condition(name, Verdict.PASS if worst < 0.0 else Verdict.DEPENDS, text, numbers, needed)
    touched = np.any(np.abs(zero_directions(system.A, system.F, system.C, 0.0)) > 1e-9, axis=0)
    names = ", ".join(name for name, hit in zip(model.fault_names, touched, strict=True) if hit)
    text = (
        f"{at}: a constant fault on {names} and the opposite constant error of its estimated angle look the "
        "same; right only from a healthy start and without gyro bias"
    )
    return Condition(name, Verdict.DEPENDS, text, numbers, needed)


def _matching(system: Augmented, zeros: Zeros, needed: bool) -> Condition:
    """Whether some P-bar > 0 has both V2' < 0 and F-bar' P-bar = F0 C-bar, as (34) uses in silence.

    By Corless and Tu (1998): if and only if rank(C-bar F-bar) = rank(F-bar) and the zeros are stable.
    """
    seen, of_F = rank(system.C @ system.F), rank(system.F)
    stable = bool(np.all(zeros.values.real < -1e-9))
    name = "(34): P-bar with F-bar' P-bar = F0 C-bar"
    numbers = {"rank_CF": seen, "rank_F": of_F, "zeros_stable": stable}
    if seen < of_F:
        text = f"rank(C-bar F-bar) = {seen} < rank(F-bar) = {of_F}: v2 cannot act against f_s"
        return Condition(name, Verdict.FAIL, text, numbers, needed)
    if stable:
        return Condition(name, Verdict.PASS, "exists", numbers, needed)
    marginal = bool(np.all(zeros.values.real < 1e-9))
    text = "exists for no gain, as zeros are not stable: " + (
        "V2 of Theorem 1 can at best stay level, it need not fall; errors along the zeros remain"
        if marginal
        else "V2 of Theorem 1 grows"
    )
    return Condition(name, Verdict.DEPENDS if marginal else Verdict.FAIL, text, numbers, needed)


def _listed(values: np.ndarray) -> str:  # pyright: ignore
    return ", ".join(f"{value.real:.3g}" if abs(value.imag) < 1e-9 else f"{value:.3g}" for value in values)
