"""The studies of docs/robustness.md: what each varies, and its statistics.

Faults are judged by what an observer declares; those of an observer without a detector by the size of its
estimate. A fault that was declared before its onset was not found: it counts as missed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import polars as pl

from quadftc_campaign.table import whole_flights
from quadftc_flight.summary import NO_OBSERVER
from quadftc_model.samples import AXES
from quadftc_tools.study.page import has_detector

GRADE = "sensors.grade"
GRADES = {"ideal": "ideal sensors", "mems": "MEMS IMU"}
LOST = 90.0  # deg; tracking error at which a vehicle is lost

Pair = tuple[float, float]


class Shown(NamedTuple):
    """A metric of a whole flight that a study shows, the worst axis of each flight."""

    title: str
    metric: str  # without the axis


class Study(NamedTuple):
    """A campaign over a grid of one value, and perhaps of the grade of the sensors."""

    name: str  # campaigns/study_NAME.yaml
    path: str  # of the value
    title: str  # of its axis, with the unit
    shown: tuple[Shown, ...]


class Sized(NamedTuple):
    """A kind of fault of the study of sizes."""

    kind: str
    path: str  # of its size
    title: str  # of its axis, with the unit
    edges: tuple[float, ...]  # of the bins of its table


TRACKING = Shown("tracking RMSE [deg]", "tracking_rmse_deg")
ESTIMATE = Shown("fault estimate RMSE [deg]", "fault_estimate_rmse_deg")
CHATTER = Shown("torque variation [N m/s]", "torque_total_variation")
INERTIA = "inertia of the vehicle over that of the model"
STUDIES = (
    Study("inertia", "plant.inertia_factor", INERTIA, (TRACKING, ESTIMATE)),
    Study("motor_lag", "plant.motor_bandwidth", "bandwidth of the motors [rad/s]", (TRACKING, ESTIMATE)),
    Study("gyro", "sensors.gyro_bias", "largest gyro bias [deg/s]", (TRACKING, ESTIMATE)),
    Study("rate", "rate", "rate [Hz]", (TRACKING, ESTIMATE, CHATTER)),
)
SIZES = "fault_size"  # campaigns/study_fault_size.yaml
DEGREES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
SIZED = (
    Sized("step", "faults.0.value", "step [deg]", DEGREES),
    Sized("sine", "faults.1.amplitude", "amplitude of the sine [deg]", DEGREES),
    Sized("ramp", "faults.2.rate", "slope of the ramp [deg/s]", tuple(each / 10.0 for each in DEGREES)),
)


def variants_of(frame: pl.DataFrame) -> list[str]:
    """Return the variants that were flown, in the order of the campaign where it is known."""
    variants = frame["variant"].unique(maintain_order=True)
    return (variants.sort() if variants.dtype == pl.Enum else variants).to_list()


def worst_axis(metric: str) -> pl.Expr:
    """The worst axis of a metric of whole flights; infinite where the vehicle was lost."""
    lost = ~pl.col("finite").fill_null(value=False) | (_largest("tracking_max_deg") > LOST)
    return pl.when(lost).then(float("inf")).otherwise(_largest(metric))


def typical(frame: pl.DataFrame, metric: str) -> Pair | None:
    """Median and 95 % quantile of the worst axis of a metric over flights; None: nothing estimates it."""
    if metric == ESTIMATE.metric and (frame["observer"] == NO_OBSERVER).all():
        return None
    return _quantiles(whole_flights(frame).select(value=worst_axis(metric))["value"])


def typical_fault(frame: pl.DataFrame, metric: str) -> Pair | None:
    """Median and 95 % quantile of a metric of faults, ``fault.`` left out; None: no fault has a value."""
    return _quantiles(frame.select(value=pl.col(f"fault.{metric}"))["value"])


def share_missed(frame: pl.DataFrame) -> float | None:
    """Share of the faults that are missed, declared before their onset included; None without an observer."""
    if (frame["observer"] == NO_OBSERVER).all():
        return None
    by_size = not has_detector(frame["observer"][0])
    delay = "fault.above_threshold_delay_s" if by_size else "fault.detection_delay_s"
    judged = frame.filter(pl.col("fault.detected").is_not_null())
    return judged[delay].null_count() / judged.height if judged.height else math.nan


def _largest(metric: str) -> pl.Expr:
    return pl.max_horizontal(*(pl.col(f"{metric}.{axis}") for axis in AXES))


def _quantiles(values: pl.Series) -> Pair | None:
    values = values.drop_nulls().drop_nans()
    if not len(values):
        return None
    ordered = values.sort()  # quantiles without interpolation: some values may be infinite
    return float(ordered[(len(ordered) - 1) // 2]), float(ordered[round(0.95 * (len(ordered) - 1))])


def cells(study: Study, frame: pl.DataFrame) -> Iterator[tuple[str, float, pl.DataFrame]]:
    """Cells of a study in order: grade (empty: all the same), value, rows."""
    for grade in grades_of(frame):
        of_grade = frame.filter(pl.col(GRADE) == grade) if grade else frame
        for value in of_grade[study.path].unique().sort().to_list():
            yield grade, value, of_grade.filter(pl.col(study.path) == value)


def grades_of(frame: pl.DataFrame) -> list[str]:
    """Grades of the sensors that were flown; one empty text if they are not varied."""
    if GRADE not in frame.columns:
        return [""]
    there = frame[GRADE].unique().to_list()
    return [grade for grade in GRADES if grade in there]


def bins(
    sized: Sized, frame: pl.DataFrame, edges: Sequence[float]
) -> Iterator[tuple[float, float, pl.DataFrame]]:
    """Faults of a kind by size: low, high, rows."""
    of_kind = frame.filter(pl.col("fault.kind") == sized.kind)
    size = pl.col(sized.path).abs()
    for low, high in itertools.pairwise(edges):
        yield low, high, of_kind.filter((low <= size) & (size < high))
