"""What the flights of one cell gave: medians, 95 % quantiles, faults missed, false alarms.

Faults are judged by what an observer declares; those of an observer without a detector by the size of its
estimate. A fault that was declared before its onset was not found: it counts as missed.
"""

from __future__ import annotations

from typing import NamedTuple

import polars as pl

from quadftc_campaign.table import whole_flights
from quadftc_flight.diagnosis_metrics import ESTIMATE_THRESHOLD_DEG
from quadftc_flight.run_directory import NO_OBSERVER
from quadftc_model.samples import AXES
from quadftc_report.campaign_results import has_observer

WITHOUT_DETECTOR = ("sliding_mode",)  # its states say nothing: the size of its estimate is taken
ESTIMATED_BY = {"fault_estimate_rmse_deg": "observer", "disturbance_estimate_rmse": "disturbance_observer"}
LOST = 90.0  # deg; tracking error at which a vehicle is lost

Pair = tuple[float, float]


class Faults(NamedTuple):
    """What became of the faults of some flights; shares in [0, 1]."""

    missed: float  # of the faults, declared before their onset included
    alarmed: float  # of the flights: a healthy axis was declared faulty


def worst_axis(metric: str) -> pl.Expr:
    """The worst axis of a metric of whole flights; infinite where the vehicle was lost."""
    lost = ~pl.col("finite").fill_null(value=False) | (_largest("tracking_max_deg") > LOST)
    return pl.when(lost).then(float("inf")).otherwise(_largest(metric))


def typical(frame: pl.DataFrame, metric: str) -> Pair | None:
    """Median and 95 % quantile of the worst axis over flights; None: there is no value, as nothing estimates.

    Parameters
    ----------
    frame : polars.DataFrame
        Rows of a campaign's table.
    metric : str
        Without the axis.
    """
    part = ESTIMATED_BY.get(metric)
    if part is not None and (frame[part] == NO_OBSERVER).all():
        return None
    return _pair(whole_flights(frame).select(value=worst_axis(metric))["value"])


def typical_fault(frame: pl.DataFrame, metric: str) -> Pair | None:
    """Median and 95 % quantile of a metric of faults, ``fault.`` left out; None: no fault has a value."""
    return _pair(frame.select(value=pl.col(f"fault.{metric}"))["value"])


def faults_of(frame: pl.DataFrame) -> Faults | None:
    """What became of the faults; None without a fault observer."""
    if not has_observer(frame):
        return None
    by_size = frame["observer"][0] in WITHOUT_DETECTOR
    delay = "fault.above_threshold_delay_s" if by_size else "fault.detection_delay_s"
    judged = frame.filter(pl.col("fault.detected").is_not_null())
    if by_size:
        alarmed = _largest("healthy_estimate_max_deg") >= ESTIMATE_THRESHOLD_DEG
    else:
        alarmed = _largest("false_alarms") > 0.0
    flights = whole_flights(frame).select(alarmed=alarmed.fill_null(value=False))["alarmed"]
    missed = judged[delay].null_count() / judged.height if judged.height else float("nan")
    return Faults(missed, int(flights.sum()) / max(len(flights), 1))


def _largest(metric: str) -> pl.Expr:
    return pl.max_horizontal(*(pl.col(f"{metric}.{axis}") for axis in AXES))


def _pair(values: pl.Series) -> Pair | None:
    values = values.drop_nulls().drop_nans()
    if not len(values):
        return None
    ordered = values.sort()  # quantiles without interpolation: some values may be infinite
    return float(ordered[(len(ordered) - 1) // 2]), float(ordered[round(0.95 * (len(ordered) - 1))])
