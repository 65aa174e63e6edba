# pyright: basic
"""Which faults can be detected and told apart at all, whatever the algorithm.

Two questions on the same equations, the second sharper than the first:

* Rank: is there a residual of the linear model, N(s) H(s) = 0, that responds to fault i and not to fault j?
* Strong (Chen, Patton (1999), "Robust model-based fault diagnosis for dynamic systems"; Nyberg (2002),
  "Criterions for detectability and strong detectability of faults in linear systems", Int. J. Control 75(7)):
  does such a residual also stay away from zero while fault i is constant, N(0) F_i != 0?
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.sparse.csgraph import connected_components

from quadftc_model.arrays import AnyArray
from quadftc_model.vehicle import Vehicle
from quadftc_theory.vehicle_equations import CHOICES, Assumptions, LinearModel, vehicle_model

GENERIC_S = 0.6180339887 + 0.4142135624j  # 1/s; no pole or zero of a model is there
RANK_TOLERANCE = 1e-9  # 1; of singular values, relative to the largest
RESPONSE_TOLERANCE = 1e-7  # 1; a residual's response to a fault of size 1 below it is rounding

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class IsolabilityResult:
    """Which faults can be detected, and which told apart from which.

    In each matrix (n, n), entry (i, j) says whether fault i can be told apart from fault j. Then a residual
    responds to i and is blind to j. The diagonal is False.
    """

    name: str  # the vehicle and its sensors
    assumptions: Mapping[str, Any]  # empty for a model that is no vehicle's
    faults: tuple[str, ...]
    detectable: Mask  # (n,)
    isolable: Mask  # (n, n)
    strongly_detectable: Mask  # (n,) also while the fault is constant
    strongly_isolable: Mask  # (n, n)

    @property
    def undetectable(self) -> tuple[str, ...]:
        """Faults that nothing responds to."""
        return self._named(~self.detectable)

    @property
    def transient(self) -> tuple[str, ...]:
        """Faults that are detected while they change only (weakly detectable)."""
        return self._named(self.detectable & ~self.strongly_detectable)

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Sets, of two or more, of detectable faults that cannot be told apart from each other."""
        confused = ~self.isolable & np.outer(self.detectable, self.detectable)
        count, labels = connected_components(confused & confused.T, directed=False)
        members = [self._named(labels == label) for label in range(count)]
        return tuple(group for group in members if len(group) > 1)

    def to_dict(self) -> dict[str, object]:
        """Everything as lists, strings and truth values, for JSON."""
        names = [*vars(self), "undetectable", "transient", "groups"]
        values = [getattr(self, name) for name in names]
        lists = [value.tolist() if isinstance(value, np.ndarray) else value for value in values]
        return dict(zip(names, lists, strict=True))

    def _named(self, mask: Mask) -> tuple[str, ...]:
        return tuple(self.faults[i] for i in np.flatnonzero(mask))


def analyse(vehicle: Vehicle, assumptions: Assumptions) -> IsolabilityResult:
    """Analyse a vehicle with its sensors."""
    described = dataclasses.asdict(assumptions) | {"sensor_set": list(assumptions.sensor_set)}
    result = analyse_model(vehicle_model(vehicle, assumptions))
    return dataclasses.replace(result, assumptions=described)


def analyse_model(model: LinearModel) -> IsolabilityResult:
    """Analyse any model; see :func:`analyse`."""
    masks = *rank_isolability(model), *strong_isolability(model)
    return IsolabilityResult(model.name, {}, model.faults, *masks)


def rank_isolability(model: LinearModel) -> tuple[Mask, Mask]:
    """Detectable faults (n,) and isolability (n, n) of the linear model, at a generic s.

    H(s) are the coefficients of the unknowns. Fault i is told apart from j if there is a row N(s) with
    N H = 0, N F_j = 0, N F_i != 0.
    """
    constant, linear, faults = _scaled(model)
    return _responses(constant + GENERIC_S * linear, faults, faults)


def strong_isolability(model: LinearModel) -> tuple[Mask, Mask]:
    """Strongly detectable faults (n,) and strong isolability (n, n) of the linear model.

    There is a polynomial row N(s) with N(s) H(s) = 0, N(s) F_j = 0 for all s, and N(0) F_i != 0. In one row,
    its coefficients obey linear equations (a parity space); its degree is at most the number of states. A
    rank test at s = 0 alone would take an unseen mode at s = 0 for a residual.
    """
    constant, linear, faults = _scaled(model)
    powers = np.eye(len(model.states) + 1)
    empty = np.zeros((len(powers), 1))
    unknowns = np.kron(np.hstack([powers, empty]), constant) + np.kron(np.hstack([empty, powers]), linear)
    return _responses(unknowns, np.kron(powers, faults), faults)


def _scaled(model: LinearModel) -> tuple[Floats, Floats, Floats]:
    """H0, H1 of H(s) = H0 + H1 s over the unknowns (states, others), and F, scaled.

    The scales of equations, unknowns and time bring the logarithms of all coefficients as near zero as can
    be in least squares. Source: Curtis, Reid (1972), "On the automatic scaling of
    matrices for Gaussian elimination". Ranks stay as they are, but rounding no longer hides them, as it would
    with an inertia of 1e-5 kg m².
    """
    powers = np.stack([np.hstack([model.A, model.B]), np.hstack([model.E, np.zeros_like(model.B)])])
    _, equations, unknowns = powers.shape
    power, row, column = places = np.nonzero(powers)
    logarithms = np.hstack([np.eye(equations)[row], np.eye(unknowns)[column], power[:, None]])
    scale = np.exp(-np.linalg.lstsq(logarithms, np.log(np.abs(powers[places])), rcond=None)[0])
    constant, linear = powers * np.outer(scale[:equations], scale[equations:-1])
    return constant, linear * scale[-1], np.where(model.F != 0.0, 1.0, 0.0)


def _responses(unknowns: AnyArray, blocks: AnyArray, faults: Floats) -> tuple[Mask, Mask]:
    """Whether rows N with N unknowns = 0, and for isolability N blocks_j = 0, respond to each fault.

    The response is that of the first entries of N, as many as ``faults`` has rows. Every ``n``-th column of
    ``blocks`` belongs to one of the n faults.
    """
    equations, count = faults.shape

    def responds(blind_to: AnyArray) -> Mask:
        # N is a row, its transpose in the null space; the conjugate matters for a complex s only
        basis = null_space(blind_to.T, rcond=RANK_TOLERANCE)[:equations]
        return np.linalg.norm(basis.T @ faults, axis=0) > RESPONSE_TOLERANCE

    told_apart = [responds(np.hstack([unknowns, blocks[:, j::count]])) for j in range(count)]
    return responds(unknowns), np.stack(told_apart, axis=1)


def isolability_lines(result: IsolabilityResult) -> list[str]:
    """What was assumed, and what the matrix says, in lines of plain text."""
    assumed = [words[result.assumptions[key]] for key, words in CHOICES.items() if key in result.assumptions]
    lines = [": ".join(filter(None, (result.name, ", ".join(assumed))))]
    for meaning, items in (
        ("cannot be detected", result.undetectable),
        ("detected only while they change", result.transient),
        ("cannot be told apart", [" / ".join(group) for group in result.groups]),
    ):
        if items:
            lines.append(f"{meaning}: {', '.join(items)}")
    if not result.undetectable and not result.groups:
        lines.append("every fault can be told apart from every other")
    return lines
