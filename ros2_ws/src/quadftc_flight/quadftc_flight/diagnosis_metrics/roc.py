# pyright: basic
"""Receiver operating characteristic: what a threshold on a score costs in false alarms, and what it finds.

The score is what a detector would hold against a threshold. Where the estimate is zero until the observer's
detector says fault, a score made of it says nothing of that detector: fly it with several thresholds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from sklearn.metrics import auc, roc_curve

from quadftc_flight.diagnosis_metrics.columns import Columns, Floats, finite
from quadftc_flight.diagnosis_metrics.verdicts import has_size, truth
from quadftc_flight.fault_schedule import FaultEvent, attitude_events
from quadftc_flight.flight import Flight
from quadftc_model.samples import AXES

Score = Callable[[Flight], Floats]  # (n, 3); NaN where there is none


class Roc(NamedTuple):
    """The curve, from the highest threshold to the lowest; each array (m,)."""

    threshold: Floats  # a score of this or more says fault; the first is infinite
    false_alarm_share: Floats  # share of what is healthy that is said to be faulty
    detection_probability: Floats  # share of what is faulty that is said to be
    area: float  # under the curve; 0.5: guessing, 1: some threshold makes no mistake


def roc(score: ArrayLike, faulty: ArrayLike) -> Roc:
    """Return the curve of finite scores (n,), by whether each comes from a fault (n,); else a ValueError."""
    labels = np.asarray(faulty, np.bool_)
    if labels.all() or not labels.any():
        missing = "healthy" if labels.any() else "faulty"
        raise ValueError(f"faulty: no {missing} score among {len(labels)}; a curve needs both")
    false_alarms, detections, thresholds = roc_curve(labels, score)
    return Roc(thresholds, false_alarms, detections, float(auc(false_alarms, detections)))


def detection_scores(
    flight: Flight, events: Sequence[FaultEvent], score: Score, within: float
) -> tuple[Floats, Floats]:
    """Return the scores (n,) of all healthy samples, and the highest score (m,) of each fault.

    A fault has a size, and a score within ``within`` [s] of its onset and before its end. Healthy is an axis
    as for the false-alarm share of `diagnosis_metrics`: outside faults and the grace after them.
    """
    columns, scores, events = Columns(flight), score(flight), attitude_events(events)
    healthy = finite(scores[truth(columns, events, [True] * len(events)).healthy])
    highest: list[float] = []
    for event in (event for event in events if has_size(columns, event)):
        rows = columns.rows(event.start, min(event.start + within, event.stop))
        values = finite(scores[rows, AXES.index(event.axis)])
        highest.extend(values.max(keepdims=True) if len(values) else ())
    return healthy, np.asarray(highest, np.float64)


def estimate_size(flight: Flight) -> Floats:
    """Size of the fault estimate [rad] (n, 3)."""
    return np.abs(flight.fault_estimate)


def estimate_over_std_dev(flight: Flight) -> Floats:
    """Size of the fault estimate over its standard deviation [1] (n, 3); NaN where there is none."""
    given = flight.fault_std_dev > 0.0
    return np.where(given, np.abs(flight.fault_estimate) / np.where(given, flight.fault_std_dev, 1.0), np.nan)
