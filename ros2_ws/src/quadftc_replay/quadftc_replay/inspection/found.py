"""What a test hands on: a finding, and the curve that shows it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from quadftc_replay.flight_log import MAIN, Floats
from quadftc_replay.inspection.verdict import Finding

BODY_AXES = ("x", "y", "z")
CERTAIN = 0.999  # the largest probability that a test gives
AROUND = 2.0  # s; drawn before and after a finding


class Curve(NamedTuple):
    """What a page draws to show a finding."""

    title: str
    unit: str
    time: Floats  # (n,) [s]
    lines: Mapping[str, Floats]  # name: (n,)


class Found(NamedTuple):
    """A finding with its curve."""

    finding: Finding
    curve: Curve | None = None
    is_direct: bool = False  # no motion of the vehicle makes it, so that it follows from nothing else


def component_name(kind: str, name: str) -> str:
    """Name a sensor: the main one by its kind alone."""
    return f"{kind} {name}" if name != MAIN else kind


def make_finding(component: str, element: str, kind: str, onset: float, **others: Any) -> Finding:
    """Make a finding; what is not given is not known."""
    usual: dict[str, object] = {
        "end_s": None,
        "size": None,
        "sigma": None,
        "unit": "",
        "probability": CERTAIN,
        "ambiguous_with": (),
        "evidence": (),
    }
    values = {**usual, **others}
    return Finding(component=component, element=element, kind=kind, onset_s=max(onset, 0.0), **values)  # type: ignore[arg-type]


def make_found(
    component: str,
    element: str,
    kind: str,
    onset: float,
    curve: Curve | None = None,
    is_direct: bool = False,
    **others: Any,
) -> Found:
    """Make a finding with what is around it of a curve; what is not given is not known."""
    finding = make_finding(component, element, kind, onset, **others)
    if curve is not None:
        span = finding.onset_s - AROUND, (finding.end_s or finding.onset_s) + AROUND
        rows = slice(*np.searchsorted(curve.time, span))
        lines = {each: values[rows] for each, values in curve.lines.items()}
        curve = curve._replace(time=curve.time[rows], lines=lines)
    return Found(finding, curve, is_direct)


def confidence(score: float, level: float) -> float:
    """Return the probability for a score beyond its level: 0.75 at it, 0.94 at twice it.

    Residuals have heavier tails than a normal distribution, so it grows with the square alone.
    """
    return min(1.0 - 0.25 * (level / max(score, level)) ** 2, CERTAIN)
