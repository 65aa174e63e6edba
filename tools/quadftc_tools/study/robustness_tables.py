"""The studies of docs/robustness.md: what each varies, and its tables.

Faults are judged by what an observer declares; those of an observer without a detector by the size of its
estimate. A fault that was declared before its onset was not found: it counts as missed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import polars as pl

from quadftc_campaign.table import whole_flights
from quadftc_flight.diagnosis_metrics import ESTIMATE_THRESHOLD_DEG
from quadftc_flight.summary import NO_OBSERVER
from quadftc_model.samples import AXES
from quadftc_tools.study.page import NOTHING, has_detector, markdown

GRADE = "sensors.grade"
GRADES = {"ideal": "ideal sensors", "mems": "MEMS IMU"}
LOST = 90.0  # deg; tracking error at which a vehicle is lost
ESTIMATED_BY = {"fault_estimate_rmse_deg": "observer", "disturbance_estimate_rmse": "disturbance_observer"}

Pair = tuple[float, float]
Write = Callable[[pl.DataFrame], str]


class Shown(NamedTuple):
    """A metric of a whole flight that a study shows, the worst axis of each flight."""

    key: str  # of its table
    title: str
    metric: str  # without the axis
    drawn: bool = True  # in the figure, too


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


class Faults(NamedTuple):
    """What became of the faults of some flights; shares in [0, 1]."""

    missed: float  # of the faults, declared before their onset included
    alarmed: float  # of the flights: a healthy axis was declared faulty


TRACKING = Shown("tracking", "tracking RMSE [deg]", "tracking_rmse_deg")
ESTIMATE = Shown("estimate", "fault estimate RMSE [deg]", "fault_estimate_rmse_deg")
DISTURBANCE = Shown(
    "disturbance", "disturbance estimate RMSE [rad/s²]", "disturbance_estimate_rmse", drawn=False
)
CHATTER = Shown("torque", "torque variation [N m/s]", "torque_total_variation")
INERTIA = "inertia of the vehicle over that of the model"
STUDIES = (
    Study("inertia", "plant.inertia_factor", INERTIA, (TRACKING, ESTIMATE, DISTURBANCE)),
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
    part = ESTIMATED_BY.get(metric)
    if part is not None and (frame[part] == NO_OBSERVER).all():
        return None
    return _quantiles(whole_flights(frame).select(value=worst_axis(metric))["value"])


def typical_fault(frame: pl.DataFrame, metric: str) -> Pair | None:
    """Median and 95 % quantile of a metric of faults, ``fault.`` left out; None: no fault has a value."""
    return _quantiles(frame.select(value=pl.col(f"fault.{metric}"))["value"])


def faults_of(frame: pl.DataFrame) -> Faults | None:
    """What became of the faults; None without a fault observer."""
    if (frame["observer"] == NO_OBSERVER).all():
        return None
    by_size = not has_detector(frame["observer"][0])
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


def study_tables(study: Study, frame: pl.DataFrame) -> dict[str, str]:
    """Tables of a study over a grid: those of its metrics, and that of the faults."""
    rows = [(_row_name(grade, value), cell) for grade, value, cell in cells(study, frame)]
    first = " and ".join(filter(None, ["sensors" if GRADE in frame.columns else "", study.title]))
    made = {
        f"{study.name}-{shown.key}": _table(first, rows, lambda cell, m=shown.metric: _pair(typical(cell, m)))
        for shown in study.shown
    }
    return {**made, f"{study.name}-faults": _table(first, rows, lambda cell: _faults(cell, 0, 1))}


def size_tables(frame: pl.DataFrame) -> dict[str, str]:
    """Tables of the study of sizes: estimate and tracking while the fault lasts, and faults missed."""
    rows = [
        (f"{sized.title}, {low:g} to {high:g}", cell)
        for sized in SIZED
        for low, high, cell in bins(sized, frame, sized.edges)
    ]
    writers: dict[str, Write] = {
        "estimate": lambda cell: _pair(typical_fault(cell, "estimate_rmse_deg") if faults_of(cell) else None),
        "tracking": lambda cell: _pair(typical_fault(cell, "tracking_rmse_deg")),
        "missed": lambda cell: _faults(cell, 0),
    }
    tables = {f"{SIZES}-{key}": _table("fault", rows, write) for key, write in writers.items()}
    alarms = _table("", [("all flights", frame)], lambda cell: _faults(cell, 1))
    return {**tables, f"{SIZES}-alarms": alarms}


def _row_name(grade: str, value: float) -> str:
    return ", ".join(filter(None, [GRADES.get(grade, ""), f"{value:g}"]))


def _table(first: str, rows: Sequence[tuple[str, pl.DataFrame]], write: Write) -> str:
    """One row for each cell, one column for each variant."""
    names = variants_of(rows[0][1])
    lines = [
        [title, *(write(cell.filter(pl.col("variant") == name)) for name in names)] for title, cell in rows
    ]
    return markdown([first, *(f"`{name}`" for name in names)], lines)


def _pair(pair: Pair | None) -> str:
    return NOTHING if pair is None else " / ".join(_number(each) for each in pair)


def _number(value: float) -> str:
    """Two digits: more would pretend that so few flights tell them."""
    if not math.isfinite(value):
        return "lost"
    if value == 0.0:
        return "0"
    value = float(f"{value:.1e}")
    digits = max(1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:.{min(digits, 4)}f}"


def _faults(cell: pl.DataFrame, *which: int) -> str:
    found = faults_of(cell)
    if found is None:
        return NOTHING
    shares = (found[place] for place in which)
    return " / ".join(NOTHING if math.isnan(share) else f"{100.0 * share:.0f} %" for share in shares)
