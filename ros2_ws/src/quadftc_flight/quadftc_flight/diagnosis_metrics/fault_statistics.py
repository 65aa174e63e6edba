"""The figures of many faults, of one flight or of many: medians, maxima and counts, by kind of fault.

>>> pooled = pool(summary["metrics"]["diagnosis"] for summary in summaries)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

from quadftc_flight.diagnosis_metrics.columns import (
    Figure,
    Metrics,
    PerAxis,
    Record,
    consistency_band,
    largest,
    mean,
    median,
    median_size,
    number,
    percentile_95,
)

ALL = "all"  # beside the kinds: faults of every kind
SECONDS_PER_HOUR = 3600.0
ALARMS = ("healthy_time_s", "false_alarms", "false_alarm_time_s", "late_recovery_time_s")

_FIGURES: dict[str, tuple[str, Figure]] = {
    "delay_median_s": ("detection_delay_s", median),
    "delay_max_s": ("detection_delay_s", largest),
    "onset_error_median_s": ("onset_error_s", median_size),
    "recovery_delay_median_s": ("recovery_delay_s", median),
    "recovery_delay_max_s": ("recovery_delay_s", largest),
    "estimate_rmse_median_deg": ("estimate_rmse_deg", median),
    "estimate_rmse_p95_deg": ("estimate_rmse_deg", percentile_95),
    "estimate_rmse_detected_median_deg": ("estimate_rmse_detected_deg", median),
    "estimate_rmse_detected_p95_deg": ("estimate_rmse_detected_deg", percentile_95),
    "estimate_bias_mean_deg": ("estimate_bias_deg", mean),
    "estimate_max_deg": ("estimate_max_deg", largest),
    "tracking_rmse_median_deg": ("tracking_rmse_deg", median),
    "tracking_rmse_p95_deg": ("tracking_rmse_deg", percentile_95),
    "coverage_2_sigma": ("coverage_2_sigma", mean),
    "nees": ("nees", mean),
}  # metric by kind -> what it is made of, and how


def fault_metrics(records: Sequence[Record]) -> Metrics:
    """Sum up the records of faults; those that cannot be judged do not count.

    The band of the mean NEES takes each fault for one independent sample. An error in telling the fault from
    the attitude stays in the estimate until the sensor is trusted again.
    """
    groups = _groups(records)
    judged, by_kind = groups[ALL], {kind: members for kind, members in groups.items() if kind != ALL}
    nees_counts = {kind: len(_values(members, "nees")) for kind, members in groups.items()}
    bands = {kind: consistency_band(n) if n else (None, None) for kind, n in nees_counts.items()}
    return {
        "fault_count": len(judged),
        "missed": _count(judged, "detected", False),
        "already_declared": _count(judged, "already_declared", True),
        "not_recovered": _count(judged, "recovered", False),
        "fault_count_by_kind": {kind: len(members) for kind, members in by_kind.items()},
        "missed_by_kind": {kind: _count(members, "detected", False) for kind, members in by_kind.items()},
        **_figures(groups),
        "nees_low": {kind: low for kind, (low, _) in bands.items()},
        "nees_high": {kind: high for kind, (_, high) in bands.items()},
    }


def with_shares(totals: Mapping[str, PerAxis]) -> Metrics:
    """Relate times [s] and counts to the healthy time: of each axis, and (``total_``) of all axes."""
    healthy = totals["healthy_time_s"]
    hours = {axis: None if time is None else time / SECONDS_PER_HOUR for axis, time in healthy.items()}
    result: Metrics = {}
    for name, values in totals.items():
        result[name] = values
        if name == "healthy_time_s":
            continue
        wholes, ratio, total = healthy, name.replace("_time_s", "_share"), _total([*values.values()])
        if name == "false_alarms":
            result["total_false_alarms"] = total
            wholes, ratio = hours, "false_alarms_per_hour"
        result[ratio] = {axis: _ratio(values[axis], wholes[axis]) for axis in wholes}
        result[f"total_{ratio}"] = _ratio(total, _total([*wholes.values()]))
    return result


def _ratio(part: float | None, whole: float | None) -> float | None:
    return number(part / whole) if part is not None and whole else None


def pool(diagnoses: Iterable[Metrics]) -> Metrics:
    """Sum up the diagnosis of many flights, ``summary["metrics"]["diagnosis"]`` of each.

    The result is as of one flight, without ``events`` and ``starting_share``, with the number of ``flights``.
    """
    flights = list(diagnoses)
    records = [record for flight in flights for record in flight["events"]]
    return {
        "flights": len(flights),
        **fault_metrics(records),
        **with_shares(_sums(flights, ALARMS)),
        "longest_false_alarm_s": _longest([flight.get("longest_false_alarm_s") or {} for flight in flights]),
    }


def _groups(records: Sequence[Record]) -> dict[str, list[Record]]:
    """Return the records that are judged: all, and by kind; a kind without any is there, too."""
    judged = [record for record in records if record["detected"] is not None]
    kinds = dict.fromkeys(str(record["kind"]) for record in records)
    return {ALL: judged, **{kind: [each for each in judged if each["kind"] == kind] for kind in kinds}}


def _figures(groups: Mapping[str, Sequence[Record]]) -> dict[str, dict[str, float | None]]:
    return {
        name: {kind: figure(_values(members, field)) for kind, members in groups.items()}
        for name, (field, figure) in _FIGURES.items()
    }


def _values(records: Iterable[Record], field: str) -> list[float]:
    return [float(value) for record in records if (value := record[field]) is not None]


def _count(records: Sequence[Record], field: str, value: bool) -> int | None:
    """Count the records that have a value; None if there is none that could."""
    found = [record[field] for record in records if record[field] is not None]
    return sum(each is value for each in found) if found else None


def _sums(parts: Sequence[Metrics], names: Iterable[str]) -> dict[str, PerAxis]:
    return {name: _total([part[name] for part in parts]) or {} for name in names}


def _longest(parts: Sequence[PerAxis]) -> PerAxis:
    """Return the largest value of each axis; None where no part has one."""
    axes = dict.fromkeys(axis for part in parts for axis in part)
    known = {axis: [value for part in parts if (value := part.get(axis)) is not None] for axis in axes}
    return {axis: max(values, default=None) for axis, values in known.items()}


def _total(parts: Sequence[Any]) -> Any:
    """Sum numbers, or mappings of such entry by entry; None counts as nothing."""
    there = [part for part in parts if part is not None]
    if not there or not isinstance(there[0], Mapping):
        return sum(there) if there else None
    entries = [cast("Metrics", part) for part in there]
    keys = dict.fromkeys(key for part in entries for key in part)
    return {key: _total([part.get(key) for part in entries]) for key in keys}
