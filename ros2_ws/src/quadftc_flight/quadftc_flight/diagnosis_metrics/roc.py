# pyright: basic
"""Receiver operating characteristic: what a threshold on a score costs in false alarms, and what it finds.

The score is what a detector would hold against a threshold. Where the estimate is zero until the observer's
detector says fault, a score made of it says nothing of that detector: fly it with several thresholds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from sklearn.metrics import auc, roc_curve

from quadftc_flight.diagnosis_metrics.columns import Floats


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
