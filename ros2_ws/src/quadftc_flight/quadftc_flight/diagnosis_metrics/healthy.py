"""What is said of an axis without a fault: false alarms, and declarations left over from a fault."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quadftc_flight.diagnosis_metrics.columns import Columns, Mask
from quadftc_flight.diagnosis_metrics.faults import ESTIMATE_THRESHOLD_DEG
from quadftc_flight.diagnosis_metrics.statistics import number
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_model.samples import AXES

GRACE_TIME = 5.0  # s; after the end of a fault, to find out that it is over: neither healthy nor faulty
SECONDS_PER_HOUR = 3600.0

PerAxis = dict[str, Any]


@dataclasses.dataclass(frozen=True, eq=False)
class Truth:
    """Which axes are faulty, and which are healthy (n, 3); in the grace after a fault, neither."""

    faulty: Mask
    healthy: Mask


def truth(columns: Columns, events: Sequence[FaultEvent], judged: Sequence[bool]) -> Truth:
    """Divide the time of each axis; in an event that is not ``judged`` it is neither faulty nor healthy."""
    faulty = np.zeros((len(columns.time), len(AXES)), np.bool_)
    doubtful = np.zeros_like(faulty)
    for event, counts in zip(events, judged, strict=True):
        axis = AXES.index(event.axis)
        doubtful[columns.rows(event.start, event.stop + GRACE_TIME), axis] = True
        if counts:
            faulty[columns.rows(event.start, event.stop), axis] = True
    return Truth(faulty, ~faulty & ~doubtful)


def alarm_metrics(columns: Columns, true: Truth) -> dict[str, PerAxis]:
    """Judge what the states say of healthy axes; each metric has a number for each axis."""
    return with_shares(_by_axis(_alarms(columns, true, axis) for axis in range(len(AXES))))


def estimate_alarm_metrics(columns: Columns, true: Truth) -> dict[str, PerAxis]:
    """Judge how long the estimate of healthy axes is as large as a fault."""
    per_axis: list[dict[str, Any]] = []
    for axis in range(len(AXES)):
        size = np.abs(columns.estimate[true.healthy[:, axis], axis])
        size = size[np.isfinite(size)]
        times = (
            _seconds(columns, np.ones(len(size), np.bool_)),
            _seconds(columns, size >= ESTIMATE_THRESHOLD_DEG),
        )
        per_axis.append(dict(zip(("healthy_time_s", "false_alarm_time_s"), times, strict=True)))
    return with_shares(_by_axis(per_axis))


def with_shares(totals: Mapping[str, PerAxis]) -> dict[str, Any]:
    """Relate times [s] and counts to the healthy time: of each axis, and (``total_``) of all axes."""
    hours = {
        axis: None if time is None else time / SECONDS_PER_HOUR
        for axis, time in totals["healthy_time_s"].items()
    }
    result: dict[str, Any] = {}
    for name, values in totals.items():
        result[name] = values
        if name == "false_alarms":
            result["total_false_alarms"] = _sum(values)
            result.update(_related("false_alarms_per_hour", values, hours))
        elif name != "healthy_time_s":
            result.update(_related(name.replace("_time_s", "_share"), values, totals["healthy_time_s"]))
    return result


def _related(name: str, parts: PerAxis, wholes: PerAxis) -> dict[str, Any]:
    """Ratios of each axis, and of the sums of those axes that have a whole."""
    return {
        name: {axis: _ratio(parts[axis], wholes[axis]) for axis in wholes},
        f"total_{name}": _ratio(_sum(parts), _sum(wholes)),
    }


def _sum(values: PerAxis) -> Any:
    known = [value for value in values.values() if value is not None]
    return sum(known) if known else None


def _alarms(columns: Columns, true: Truth, axis: int) -> dict[str, Any]:
    known = columns.known[:, axis]
    if not known.any():
        return dict.fromkeys(("healthy_time_s", "false_alarms", "false_alarm_time_s", "late_recovery_time_s"))
    declared, healthy = columns.declared[known, axis], true.healthy[known, axis]
    begins = declared & ~np.concatenate([[False], declared[:-1]])
    wrong = declared & healthy
    return {
        "healthy_time_s": _seconds(columns, healthy),
        "false_alarms": int(np.sum(begins & healthy)),
        "false_alarm_time_s": _seconds(columns, wrong),
        "late_recovery_time_s": _seconds(columns, wrong & ~_began_in(healthy, begins)),
    }


def _began_in(mask: Mask, begins: Mask) -> Mask:
    """Whether the last beginning before or at a row was in a mask (m,)."""
    rows = np.where(begins, np.arange(len(begins)), 0)
    return mask[np.maximum.accumulate(rows)]


def _by_axis(per_axis: Any) -> dict[str, PerAxis]:
    found = list(per_axis)
    return {name: {axis: each[name] for axis, each in zip(AXES, found, strict=True)} for name in found[0]}


def _seconds(columns: Columns, mask: Mask) -> float | None:
    """Time of the rows of a mask [s]."""
    return number(np.sum(mask) * columns.period)


def _ratio(part: float | None, whole: float | None) -> float | None:
    return number(part / whole) if part is not None and whole else None
