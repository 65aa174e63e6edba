"""What each metric of a summary is: its section of the table, its label, its unit, whether less is better."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, cast

from quadftc_flight.diagnosis_metrics import ESTIMATE_THRESHOLD_DEG
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded
from quadftc_report.measures import metric
from quadftc_report.wording import period

SETTLING = "fault_estimate_settling_s"

WINDOW = "fault_windows."
DIAGNOSIS = "diagnosis."
EVENT = "diagnosis.events."
CONFUSION = "diagnosis.confusion_"


@dataclasses.dataclass(frozen=True)
class Kind:
    """A metric: where it stands, what it is, its unit (summary's times ``scale``), whether less is better."""

    section: str
    label: str
    unit: str
    less_is_better: bool
    scale: float = 1.0


_TRACKING, _ESTIMATE, _EFFORT = "Tracking", "Fault estimate", "Disturbance and torque"
_DETECTION, _EACH, _HEALTHY = "Detection of faults", "Estimate, fault by fault", "Healthy axes"
_ISOLATION, _OTHER = "Isolation", "Other"
_DETAILS = "Diagnosis of"  # how sections begin that tell more than the diagnosis of the flight as a whole
_CONFUSION = f"{_DETAILS} which axis is faulty, against what is declared"
_SIZE = f"{_DETAILS} faults by an estimate above {ESTIMATE_THRESHOLD_DEG:g} deg"
_SECTIONS = (_TRACKING, _ESTIMATE, _EFFORT, _DETECTION, _EACH, _HEALTHY, _ISOLATION)

FLIGHT_KINDS = {
    "tracking_rmse_deg": Kind(_TRACKING, "tracking RMSE", "deg", True),
    "tracking_max_deg": Kind(_TRACKING, "largest tracking error", "deg", True),
    "max_tilt_deg": Kind(_TRACKING, "largest tilt", "deg", False),
    "fault_max_deg": Kind(_ESTIMATE, "largest fault", "deg", False),
    "fault_estimate_max_settled_deg": Kind(_ESTIMATE, "largest error, settled", "deg", True),
    "fault_estimate_max_deg": Kind(_ESTIMATE, "largest error", "deg", True),
    "fault_estimate_rmse_deg": Kind(_ESTIMATE, "RMSE", "deg", True),
    "fault_estimate_rmse_inside_deg": Kind(_ESTIMATE, "RMSE, inside fault windows", "deg", True),
    "fault_estimate_max_inside_deg": Kind(_ESTIMATE, "largest error, inside fault windows", "deg", True),
    "fault_estimate_rmse_outside_deg": Kind(_ESTIMATE, "RMSE, outside fault windows", "deg", True),
    "fault_estimate_max_outside_deg": Kind(_ESTIMATE, "largest error, outside fault windows", "deg", True),
    "disturbance_estimate_rmse": Kind(_EFFORT, "RMSE of the disturbance estimate", "rad/s²", True),
    "torque_rms": Kind(_EFFORT, "torque, RMS", "N m", False),
    "torque_total_variation": Kind(_EFFORT, "total variation of the torque", "N m/s", True),
    "saturation_share": Kind(_EFFORT, "samples with the torque cut", "%", True, 100.0),
}
WINDOW_KINDS = {
    "tracking_mean_deg": Kind("", "mean tracking error", "deg", False),
    "tracking_rmse_deg": Kind("", "tracking RMSE", "deg", True),
    "tracking_max_deg": Kind("", "largest tracking error", "deg", True),
    "fault_estimate_rmse_deg": Kind("", "RMSE of the fault estimate", "deg", True),
    "fault_estimate_max_deg": Kind("", "largest error of the fault estimate", "deg", True),
    SETTLING: Kind("", "fault estimate settles in", "ms", True, 1e3),
}
_DIAGNOSIS_KINDS = {
    "fault_count": Kind(_DETECTION, "faults", "", False),
    "missed": Kind(_DETECTION, "missed faults", "", True),
    "already_declared": Kind(_DETECTION, "axis declared faulty before the onset", "", True),
    "not_recovered": Kind(_DETECTION, "sensor not trusted again after a fault", "", True),
    "fault_count_by_kind": Kind(_DETECTION, "faults", "", False),
    "missed_by_kind": Kind(_DETECTION, "missed faults", "", True),
    "delay_median_s": Kind(_DETECTION, "detection delay, median", "ms", True, 1e3),
    "delay_max_s": Kind(_DETECTION, "detection delay, largest", "ms", True, 1e3),
    "onset_error_median_s": Kind(_DETECTION, "error of the onset, median", "ms", True, 1e3),
    "recovery_delay_median_s": Kind(_DETECTION, "trusted again after, median", "s", True),
    "recovery_delay_max_s": Kind(_DETECTION, "trusted again after, at most", "s", True),
    "estimate_rmse_median_deg": Kind(_EACH, "RMSE, median", "deg", True),
    "estimate_rmse_p95_deg": Kind(_EACH, "RMSE, 95th percentile", "deg", True),
    "estimate_rmse_detected_median_deg": Kind(_EACH, "RMSE once detected, median", "deg", True),
    "estimate_rmse_detected_p95_deg": Kind(_EACH, "RMSE once detected, 95th percentile", "deg", True),
    "estimate_bias_mean_deg": Kind(_EACH, "mean error", "deg", False),
    "estimate_max_deg": Kind(_EACH, "largest error", "deg", True),
    "tracking_rmse_median_deg": Kind(_EACH, "tracking RMSE, median", "deg", True),
    "tracking_rmse_p95_deg": Kind(_EACH, "tracking RMSE, 95th percentile", "deg", True),
    "nees": Kind(_EACH, "NEES", "", False),
    "nees_low": Kind(_EACH, "NEES if consistent, at least", "", False),
    "nees_high": Kind(_EACH, "NEES if consistent, at most", "", False),
    "coverage_2_sigma": Kind(_EACH, "errors within two standard deviations", "%", False, 100.0),
    "healthy_time_s": Kind(_HEALTHY, "healthy time", "s", False),
    "false_alarms": Kind(_HEALTHY, "false alarms", "", True),
    "false_alarms_per_hour": Kind(_HEALTHY, "false alarms an hour", "1/h", True),
    "false_alarm_time_s": Kind(_HEALTHY, "declared faulty", "s", True),
    "false_alarm_share": Kind(_HEALTHY, "declared faulty", "%", True, 100.0),
    "late_recovery_time_s": Kind(_HEALTHY, "of it left over from a fault", "s", True),
    "late_recovery_share": Kind(_HEALTHY, "of it left over from a fault", "%", True, 100.0),
    "starting_share": Kind(_HEALTHY, "samples before the diagnosis begins", "%", True, 100.0),
    "isolation_tested_s": Kind(_ISOLATION, "faulty and healthy axes, some declared", "s", False),
    "isolation_correct_s": Kind(_ISOLATION, "of it no healthy axis declared", "s", False),
    "isolation_accuracy": Kind(_ISOLATION, "isolation accuracy", "%", False, 100.0),
}
_BY_ESTIMATE_KINDS = {
    "threshold_deg": Kind(_SIZE, "threshold", "deg", False),
    "missed": Kind(_SIZE, "missed faults", "", True),
    "already_above": Kind(_SIZE, "estimate above it before the onset", "", True),
    "delay_median_s": Kind(_SIZE, "detection delay, median", "ms", True, 1e3),
    "delay_max_s": Kind(_SIZE, "detection delay, largest", "ms", True, 1e3),
    "healthy_time_s": Kind(_SIZE, "healthy time", "s", False),
    "false_alarm_time_s": Kind(_SIZE, "healthy axis above it", "s", True),
    "false_alarm_share": Kind(_SIZE, "healthy axis above it", "%", True, 100.0),
}
_EVENT_KINDS = {
    "fault_max_deg": Kind("", "largest fault", "deg", False),
    "detected": Kind("", "detected", "", False),
    "already_declared": Kind("", "declared faulty before the onset", "", False),
    "detection_delay_s": Kind("", "detection delay", "ms", True, 1e3),
    "onset_error_s": Kind("", "onset as it was reported, less the true one", "ms", False, 1e3),
    "declared_share": Kind("", "share of the fault in which it is declared", "%", False, 100.0),
    "declarations": Kind("", "times it was declared", "", False),
    "recovered": Kind("", "sensor trusted again", "", False),
    "recovery_delay_s": Kind("", "trusted again after", "s", True),
    "above_threshold": Kind("", "estimate above the threshold", "", False),
    "above_threshold_already": Kind("", "estimate above it before the onset", "", False),
    "above_threshold_delay_s": Kind("", "estimate above it after", "ms", True, 1e3),
    "estimate_rmse_deg": Kind("", "RMSE of the estimate", "deg", True),
    "estimate_bias_deg": Kind("", "mean error of the estimate", "deg", False),
    "estimate_max_deg": Kind("", "largest error of the estimate", "deg", True),
    "estimate_rmse_detected_deg": Kind("", "RMSE of the estimate once detected", "deg", True),
    "estimate_max_detected_deg": Kind("", "largest error of the estimate once detected", "deg", True),
    "nees": Kind("", "NEES", "", False),
    "nees_samples": Kind("", "independent samples", "", False),
    "nees_low": Kind("", "NEES if consistent, at least", "", False),
    "nees_high": Kind("", "NEES if consistent, at most", "", False),
    "coverage_2_sigma": Kind("", "errors within two standard deviations", "%", False, 100.0),
    "tracking_rmse_deg": Kind("", "tracking RMSE", "deg", True),
}
_CONFUSIONS = {
    "confusion_single_s": "only {} faulty",
    "confusion_any_s": "{} faulty",
    "confusion_by_kind_s": "{}",
}
_COLUMNS = {
    "none": "nothing declared",
    "time": "all the time",
    "own": "its axis declared",
    "other": "a healthy axis declared",
}
_SUFFIXES = {"_deg": "deg", "_s": "s"}  # what the name of another metric says of its unit
_ALL = "all"  # faults of every kind
_NOT_METRICS = ("start", "stop", "axes", "axis", "kind")  # of a window, of an event


def leaves(metrics: Any, prefix: str = "") -> Iterator[tuple[str, str | None]]:
    """Yield the path of every number, and its axis if the number is one of three."""
    entries: Mapping[str, Any] = (
        cast("dict[str, Any]", metrics)
        if isinstance(metrics, dict)
        else {str(index): item for index, item in enumerate(cast("list[Any]", metrics))}
    )
    listed = prefix.startswith((WINDOW, EVENT))
    for name, value in entries.items():
        path = f"{prefix}{name}"
        if listed and name in _NOT_METRICS:
            continue
        if isinstance(value, (dict, list)):
            yield from leaves(value, f"{path}.")
        else:
            yield path, name if name in AXES else None


def rank(section: str) -> int:
    """Where a section of the table stands; those of one rank in the order in which they come up."""
    if section in _SECTIONS:
        return _SECTIONS.index(section)
    return len(_SECTIONS) + (2 if section == _OTHER else int(section.startswith(_DETAILS)))


def kind_of(path: str, runs: tuple[Recorded, ...]) -> Kind:
    """Return what the metric at a path is; the runs tell when a fault window or fault was."""
    words = path.split(".")
    if path.startswith(WINDOW):
        kind = WINDOW_KINDS.get(words[2]) or unknown(words[2])
        return dataclasses.replace(kind, section=_window_title(int(words[1]), runs))
    if path.startswith(EVENT):
        kind = _EVENT_KINDS.get(words[3]) or unknown(words[3])
        return dataclasses.replace(kind, section=_event_title(int(words[2]), runs))
    if path.startswith(CONFUSION):
        return Kind(_CONFUSION, _confusion(*words[1:]), "s", False)
    if path.startswith(f"{DIAGNOSIS}by_estimate."):
        return _diagnosis_kind(_BY_ESTIMATE_KINDS, words[2:])
    if path.startswith(DIAGNOSIS):
        return _diagnosis_kind(_DIAGNOSIS_KINDS, words[1:])
    return FLIGHT_KINDS.get(words[0]) or unknown(words[0])


def unknown(name: str) -> Kind:
    """Return a metric under its own name."""
    suffix, unit = next(((end, unit) for end, unit in _SUFFIXES.items() if name.endswith(end)), ("", ""))
    return Kind(_OTHER, name.removesuffix(suffix).replace("_", " "), unit, False)


def _diagnosis_kind(kinds: Mapping[str, Kind], words: list[str]) -> Kind:
    """A metric of all axes together (``total_``), of an axis, or of a kind of fault."""
    name, *rest = words
    kind = kinds.get(name.removeprefix("total_")) or unknown(name)
    if name.startswith("total_"):
        return dataclasses.replace(kind, label=f"{kind.label}, all axes")
    for fault in (word for word in rest if word not in (*AXES, _ALL)):
        if kind.section == _SIZE:
            return dataclasses.replace(kind, label=f"{kind.label}, {fault}")
        return dataclasses.replace(kind, section=f"{_DETAILS} faults by kind: {fault}")
    return kind


def _confusion(name: str, row: str, column: str) -> str:
    who = "no axis faulty" if row == "none" else _CONFUSIONS.get(name, "{}").format(row)
    return f"{who}: {_COLUMNS.get(column, 'declared')}"


def _window_title(number: int, runs: tuple[Recorded, ...]) -> str:
    for run in runs:
        start, stop = (metric(run, f"{WINDOW}{number}.{name}") for name in ("start", "stop"))
        if start is not None and stop is not None:
            return f"Fault window {number + 1}, {period(start, stop)}"
    return f"Fault window {number + 1}"


def _event_title(number: int, runs: tuple[Recorded, ...]) -> str:
    for run in runs:
        event: Any = metric(run, f"{EVENT}{number}")
        if event is not None:
            when = period(event["start"], event["stop"])
            return f"{_DETAILS} the {event['kind']} on {event['axis']}, {when}"
    return f"{_DETAILS} fault {number + 1}"
