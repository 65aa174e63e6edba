"""The cost that tuning lowers: a weighted mean of metrics, each relative to its value at the start."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.tally import Outcome, Sums
from quadftc_model.samples import AXES

Floats = NDArray[np.float64]

# metrics of `quadftc_flight.metrics`: the sum of squares that each is the root of the mean of, and its count
ROOTS = {
    "tracking_rmse_deg": ("tracking", "delivered"),
    "fault_estimate_rmse_deg": ("estimate", "known"),
    "disturbance_estimate_rmse": ("disturbance", "delivered"),
    "torque_rms": ("torque", "delivered"),
}
TERMS = (*ROOTS, "torque_total_variation")


def term(name: str, outcome: Outcome) -> Floats:
    """Return a metric (3,) of a flight; in degrees where its name says so. NaN: there is none."""
    sums = outcome.sums
    if name not in ROOTS:
        return sums.variation / outcome.span
    squares, count = (getattr(sums, key) for key in ROOTS[name])
    return _scale(name) * np.sqrt(np.where(count > 0, squares / np.maximum(count, 1), np.nan))


def slope_of_term(name: str, outcome: Outcome, slope: Sums) -> Floats:
    """Return the slope (3,) of a metric, from that of the sums; 0 where it is 0 or has no value."""
    if name not in ROOTS:
        return np.asarray(slope.variation / outcome.span)
    squares, count = ROOTS[name]
    value = term(name, outcome)
    change = getattr(slope, squares) / np.maximum(getattr(outcome.sums, count), 1)
    safe = np.where(value > 0.0, value, 1.0)
    return np.where(value > 0.0, _scale(name) ** 2 * change / (2.0 * safe), 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Cost:
    """A cost that is 1 at the start.

    Parameters
    ----------
    weights : mapping
        Of each metric.
    scale : array (metrics, 3)
        Mean of each metric at the start; an axis on which it is 0 or has no value does not count.
    """

    weights: Mapping[str, float]
    scale: Floats

    @property
    def _shares(self) -> Floats:
        """Cost of a unit of each metric on each axis (metrics, 3)."""
        counts = self.scale > 0.0
        each: Floats = np.array([*self.weights.values()], np.float64)
        weights = each[:, None] * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        return weights / weights.sum() / np.where(counts, self.scale, 1.0)

    def of(self, values: Floats) -> float:
        """Return the mean cost of flights (flights, metrics, 3)."""
        terms: Floats = np.where(self.scale > 0.0, values * self._shares, 0.0)
        return float(terms.sum()) / len(terms)

    def gradient(self, slopes: Floats) -> Floats:
        """Return the slope (gains,) of the mean cost from those of metrics (flights, gains, metrics, 3)."""
        return np.mean(np.sum(slopes * self._shares, axis=(2, 3)), axis=0)


def cost_from(weights: Mapping[str, float], values: Floats) -> Cost:
    """Return the cost that is 1 for flights (flights, metrics, 3); `ValueError` if all metrics are 0."""
    scale = np.asarray(np.mean(values, axis=0))
    if not np.any(scale > 0.0):
        raise ValueError(f"every metric is 0 from the start: {', '.join(weights)}")
    return Cost(weights, scale)


def values_of(record: Mapping[str, Any], names: Mapping[str, float]) -> Floats:
    """Return the metrics (metrics, 3) of a row of a campaign's table."""
    found = [[record[f"{name}.{axis}"] for axis in AXES] for name in names]
    return np.array([[np.nan if value is None else value for value in row] for row in found], np.float64)


def _scale(name: str) -> float:
    return float(np.degrees(1.0)) if name.endswith("_deg") else 1.0
