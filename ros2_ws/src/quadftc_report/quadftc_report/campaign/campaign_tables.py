"""Tables of quantiles: of the faults by their kind, of the whole flights by axis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.samples import AXES
from quadftc_report.campaign.results import Results, Side, numbers
from quadftc_report.templating import NOTHING
from quadftc_report.wording import short

MIDDLE, HIGH, LARGEST = ("median", "q50"), ("95 %", "q95"), ("largest", "max")
HOUR = 3600.0  # s


class Cell(NamedTuple):
    """What is in a table: a text over some columns; ``note``: it is no number."""

    text: str
    span: int = 1
    note: bool = False
    first: bool = False  # of its heading


class Head(NamedTuple):
    """A heading over some columns."""

    title: str
    columns: tuple[str, ...]


class Line(NamedTuple):
    """A line of a table."""

    name: str
    cells: tuple[Cell, ...]


class Table(NamedTuple):
    """A table whose lines are in groups."""

    heads: tuple[Head, ...]
    groups: tuple[tuple[str, tuple[Line, ...]], ...]


class Column(NamedTuple):
    """A metric whose quantiles are shown."""

    title: str
    metric: str
    quantiles: tuple[tuple[str, str], ...]
    scale: float = 1.0

    @property
    def head(self) -> Head:
        """Its heading."""
        return Head(self.title, tuple(name for name, _ in self.quantiles))


DELAY = Column("detection delay [s]", "fault.detection_delay_s", (MIDDLE, HIGH))
OF_FAULTS = (
    DELAY,
    Column("RMSE of the estimate [deg]", "fault.estimate_rmse_deg", (MIDDLE, HIGH, LARGEST)),
    Column("tracking RMSE [deg]", "fault.tracking_rmse_deg", (MIDDLE, HIGH)),
)
OF_FLIGHTS = (
    Column("tracking RMSE [deg]", "tracking_rmse_deg", (MIDDLE, HIGH, LARGEST)),
    Column("RMSE of the fault estimate [deg]", "fault_estimate_rmse_deg", (MIDDLE, HIGH, LARGEST)),
    Column("total variation of the torque [N\u00a0m/s]", "torque_total_variation", (MIDDLE, HIGH)),
    Column("samples with the torque cut [%]", "saturation_share", (MIDDLE, HIGH), 100.0),
)


def fault_table(results: Results) -> Table | None:
    """Return the table of the faults; None: there were none."""
    if not results.kinds:
        return None
    heads = (Head("faults", ("count", "missed")), *(column.head for column in OF_FAULTS))
    groups = ((kind, tuple(_fault_lines(results, kind))) for kind in results.kinds)
    return Table(heads, tuple(groups))


def _fault_lines(results: Results, kind: str) -> Iterator[Line]:
    for side in results.sides:
        found = side.summary["faults"].get(kind)
        if found is None:
            continue
        count = Cell(str(found["count"]), first=True)
        if side.has_observer:
            missed = str(found["missed"])
            if found["judged"] != found["count"]:
                missed = f"{missed} of {found['judged']}"
            detection = (Cell(missed), *_quantiles(found["metrics"], DELAY))
        else:
            detection = (Cell("no fault observer", 3, note=True),)
        rest = (cell for column in OF_FAULTS[1:] for cell in _quantiles(found["metrics"], column))
        yield Line(side.name, (count, *detection, *rest))


def flight_table(results: Results) -> Table:
    """Return the table of the whole flights."""
    heads = (*(column.head for column in OF_FLIGHTS), Head("false alarms [1/h]", ("mean",)))
    return Table(
        heads, tuple((axis, tuple(_flight_line(side, axis) for side in results.sides)) for axis in AXES)
    )


def _flight_line(side: Side, axis: str) -> Line:
    metrics = side.summary["metrics"]
    cells = [cell for column in OF_FLIGHTS for cell in _quantiles(metrics, column, f".{axis}")]
    rate = alarms_per_hour(side, [axis])
    alarms = Cell(NOTHING if rate is None or not side.has_observer else short(rate), first=True)
    return Line(side.name, (*cells, alarms))


def healthy_hours(side: Side, axes: Sequence[str] = AXES) -> float:
    """Return for how long the axes of all flights were healthy, together [h]."""
    return sum(float(np.nansum(numbers(side.flights, f"healthy_time_s.{axis}"))) for axis in axes) / HOUR


def alarms_per_hour(side: Side, axes: Sequence[str] = AXES) -> float | None:
    """Return the false alarms in an hour of a healthy axis [1/h]; None: no axis was healthy."""
    hours = healthy_hours(side, axes)
    if not hours > 0.0:
        return None
    return sum(float(np.nansum(numbers(side.flights, f"false_alarms.{axis}"))) for axis in axes) / hours


def _quantiles(metrics: Mapping[str, Any], column: Column, suffix: str = "") -> Iterator[Cell]:
    values = metrics.get(f"{column.metric}{suffix}", {})
    for place, (_, key) in enumerate(column.quantiles):
        value = values.get(key)
        yield Cell(NOTHING if value is None else short(column.scale * value), first=place == 0)
