"""What the estimate of a variant, held against a level, finds and costs; and what its own detector does.

One score for each fault, the largest estimate while it lasts; one for each axis of each flight, the largest
estimate while that axis is healthy. A level finds a fault, or gives an axis a false alarm, if the score
reaches it. Such shares count faults and axes, not samples: they depend on how long an axis is healthy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.diagnosis_metrics.roc import Roc, roc
from quadftc_model.samples import AXES
from quadftc_report.campaign.results import Side, known, numbers

Floats = NDArray[np.float64]


class Detector(NamedTuple):
    """How well a variant tells faulty axes from healthy ones."""

    curve: Roc | None  # None: there is nothing to compare, or it never estimates anything
    faults: int  # scores of the curve
    healthy: int
    point: tuple[float, float] | None  # its own: share of healthy axes with a false alarm, of faults found
    silent: float  # share of the scores that are exactly zero


def detector_of(side: Side) -> Detector:
    """Judge a variant."""
    peaks = known(numbers(side.faults, "fault.estimate_peak_deg"))
    calm = known(np.concatenate([numbers(side.flights, f"healthy_estimate_max_deg.{axis}") for axis in AXES]))
    scores = np.concatenate([peaks, calm])
    faulty: NDArray[np.bool_] = np.arange(len(scores)) < len(peaks)
    useful = len(peaks) > 0 and len(calm) > 0 and bool(np.any(scores > 0.0))
    curve = roc(scores, faulty) if useful else None
    silent = np.count_nonzero(scores == 0.0) / max(len(scores), 1)
    return Detector(curve, len(peaks), len(calm), _own(side), silent)


def _own(side: Side) -> tuple[float, float] | None:
    """Where the variant's own detector is; None if it never says anything."""
    found = known(numbers(side.faults, "fault.detected"))
    alarms = np.concatenate([_alarms(side, axis) for axis in AXES])
    if not len(found) or not len(alarms) or not (np.any(found) or np.any(alarms)):
        return None
    return float(np.mean(alarms > 0.0)), float(np.mean(found))


def _alarms(side: Side, axis: str) -> Floats:
    """False alarms of an axis in each flight in which it is healthy for a time."""
    healthy = numbers(side.flights, f"healthy_time_s.{axis}") > 0.0
    return known(numbers(side.flights, f"false_alarms.{axis}")[healthy])
