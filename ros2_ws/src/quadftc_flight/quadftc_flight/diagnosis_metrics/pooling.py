"""The figures of many faults: medians, maxima and counts, by kind of fault; of one flight, or of many.

>>> pooled = pool(summary["metrics"]["diagnosis"] for summary in summaries)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, cast

import numpy as np

from quadftc_flight.diagnosis_metrics.faults import ESTIMATE_THRESHOLD_DEG
from quadftc_flight.diagnosis_metrics.healthy import with_shares
from quadftc_flight.diagnosis_metrics.isolation import accuracy
from quadftc_flight.diagnosis_metrics.statistics import consistency_band, median, number, percentile_95

Record = Mapping[str, Any]
Measure = Callable[[Sequence[float]], float | None]

ALL = "all"  # beside the kinds: faults of every kind

_ALARM_SUMS = ("healthy_time_s", "false_alarms", "false_alarm_time_s", "late_recovery_time_s")
_ESTIMATE_ALARM_SUMS = ("healthy_time_s", "false_alarm_time_s")
_ISOLATION_SUMS = ("isolation_tested_s", "isolation_correct_s")
_CONFUSIONS = ("confusion_single_s", "confusion_any_s", "confusion_by_kind_s")


def _mean(values: Sequence[float]) -> float | None:
    return number(np.mean(values)) if len(values) else None


def _largest(values: Sequence[float]) -> float | None:
    return number(max(values)) if len(values) else None


def _median_size(values: Sequence[float]) -> float | None:
    return median([abs(value) for value in values])


_MEASURES: dict[str, tuple[str, Measure]] = {
    "delay_median_s": ("detection_delay_s", median),
    "delay_max_s": ("detection_delay_s", _largest),
    "onset_error_median_s": ("onset_error_s", _median_size),
    "recovery_delay_median_s": ("recovery_delay_s", median),
    "recovery_delay_max_s": ("recovery_delay_s", _largest),
    "estimate_rmse_median_deg": ("estimate_rmse_deg", median),
    "estimate_rmse_p95_deg": ("estimate_rmse_deg", percentile_95),
    "estimate_rmse_detected_median_deg": ("estimate_rmse_detected_deg", median),
    "estimate_rmse_detected_p95_deg": ("estimate_rmse_detected_deg", percentile_95),
    "estimate_bias_mean_deg": ("estimate_bias_deg", _mean),
    "estimate_max_deg": ("estimate_max_deg", _largest),
    "tracking_rmse_median_deg": ("tracking_rmse_deg", median),
    "tracking_rmse_p95_deg": ("tracking_rmse_deg", percentile_95),
    "coverage_2_sigma": ("coverage_2_sigma", _mean),
    "nees": ("nees", _mean),
}  # metric by kind -> what it is made of, and how
_ESTIMATE_MEASURES: dict[str, tuple[str, Measure]] = {
    "delay_median_s": ("above_threshold_delay_s", median),
    "delay_max_s": ("above_threshold_delay_s", _largest),
}


def fault_metrics(records: Sequence[Record]) -> dict[str, Any]:
    """Sum up the records of faults; those that cannot be judged do not count.

    Delays are those of the faults that were found. The band of the mean NEES takes each fault for one
    independent sample: the error made in telling a fault from the attitude stays in the estimate until the
    sensor is trusted again.
    """
    groups = _groups(records, "detected")
    judged = groups[ALL]
    measured = _measured(groups, _MEASURES)
    bands = {kind: _band(len(_values(members, "nees"))) for kind, members in groups.items()}
    return {
        "fault_count": len(judged),
        "missed": _count(judged, "detected", False),
        "already_declared": _count(judged, "already_declared", True),
        "not_recovered": _count(judged, "recovered", False),
        "fault_count_by_kind": {kind: len(members) for kind, members in groups.items() if kind != ALL},
        "missed_by_kind": {
            kind: _count(members, "detected", False) for kind, members in groups.items() if kind != ALL
        },
        **measured,
        "nees_low": {kind: low for kind, (low, _) in bands.items()},
        "nees_high": {kind: high for kind, (_, high) in bands.items()},
    }


def estimate_fault_metrics(records: Sequence[Record]) -> dict[str, Any]:
    """Sum up what the size of the estimate, without any state, says of faults."""
    groups = _groups(records, "above_threshold")
    return {
        "threshold_deg": ESTIMATE_THRESHOLD_DEG,
        "missed": _count(groups[ALL], "above_threshold", False),
        "already_above": _count(groups[ALL], "above_threshold_already", True),
        **_measured(groups, _ESTIMATE_MEASURES),
    }


def pool(diagnoses: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Sum up the diagnosis of many flights.

    Parameters
    ----------
    diagnoses : iterable of mapping
        ``summary["metrics"]["diagnosis"]`` of each flight.

    Returns
    -------
    dict
        As of one flight, without ``events`` and ``starting_share``; with the number of ``flights``.
    """
    flights = list(diagnoses)
    records = [record for flight in flights for record in flight["events"]]
    tested, correct = (_total([flight[name] for flight in flights]) for name in _ISOLATION_SUMS)
    by_estimate = [flight["by_estimate"] for flight in flights]
    return {
        "flights": len(flights),
        **fault_metrics(records),
        **with_shares(_summed(flights, _ALARM_SUMS)),
        "isolation_tested_s": tested,
        "isolation_correct_s": correct,
        "isolation_accuracy": accuracy(correct, tested),
        **_summed(flights, _CONFUSIONS),
        "by_estimate": {
            **estimate_fault_metrics(records),
            **with_shares(_summed(by_estimate, _ESTIMATE_ALARM_SUMS)),
        },
    }


def _groups(records: Sequence[Record], verdict: str) -> dict[str, list[Record]]:
    """Records that have a verdict: all, and by kind; a kind without any is there, too."""
    judged = [record for record in records if record[verdict] is not None]
    kinds = dict.fromkeys(str(record["kind"]) for record in records)
    return {ALL: judged, **{kind: [each for each in judged if each["kind"] == kind] for kind in kinds}}


def _measured(
    groups: Mapping[str, Sequence[Record]], measures: Mapping[str, tuple[str, Measure]]
) -> dict[str, dict[str, float | None]]:
    return {
        name: {kind: measure(_values(members, field)) for kind, members in groups.items()}
        for name, (field, measure) in measures.items()
    }


def _values(records: Iterable[Record], field: str) -> list[float]:
    return [float(record[field]) for record in records if record[field] is not None]


def _count(records: Sequence[Record], field: str, value: bool) -> int | None:
    """How many of the records have a value; None if there is none that could."""
    found = [record[field] for record in records if record[field] is not None]
    return sum(each is value for each in found) if found else None


def _band(count: int) -> tuple[float | None, float | None]:
    return consistency_band(count) if count else (None, None)


def _summed(parts: Sequence[Mapping[str, Any]], names: Iterable[str]) -> dict[str, Any]:
    return {name: _total([part[name] for part in parts]) or {} for name in names}


def _total(parts: Sequence[Any]) -> Any:
    """Sum of numbers, or of mappings of such entry by entry; None counts as nothing."""
    there = [part for part in parts if part is not None]
    if not there:
        return None
    if not isinstance(there[0], Mapping):
        return sum(there)
    entries = [cast("Mapping[str, Any]", part) for part in there]
    keys = dict.fromkeys(key for part in entries for key in part)
    return {key: _total([part.get(key) for part in entries]) for key in keys}
