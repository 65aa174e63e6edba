"""What each metric of a summary is: its section of the table, its label, its unit, whether less is better."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

from quadftc_flight.diagnosis_metrics import ESTIMATE_THRESHOLD_DEG
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import metric
from quadftc_report.wording import period

SETTLING = "fault_estimate_settling_s"
WINDOW = "fault_windows."
DIAGNOSIS = "diagnosis."
EVENT = "diagnosis.events."
CONFUSION = "diagnosis.confusion_"
OTHER = "Other"
DETAILS = "Diagnosis of"  # how the sections of single faults and kinds of faults begin
BY_SIZE = f"{DETAILS} faults by an estimate above {ESTIMATE_THRESHOLD_DEG:g} deg"


class Kind(NamedTuple):
    """A metric; ``scale``: from the unit of the summary to ``unit``."""

    label: str
    unit: str
    less_is_better: bool = False
    scale: float = 1.0


SECTIONS: dict[str, dict[str, Kind]] = {
    "Tracking": {
        "tracking_rmse_deg": Kind("tracking RMSE", "deg", True),
        "tracking_max_deg": Kind("largest tracking error", "deg", True),
        "max_tilt_deg": Kind("largest tilt", "deg"),
    },
    "Fault estimate": {
        "fault_max_deg": Kind("largest fault", "deg"),
        "fault_estimate_max_settled_deg": Kind("largest error, settled", "deg", True),
        "fault_estimate_max_deg": Kind("largest error", "deg", True),
        "fault_estimate_rmse_deg": Kind("RMSE", "deg", True),
        "fault_estimate_rmse_inside_deg": Kind("RMSE, inside fault windows", "deg", True),
        "fault_estimate_max_inside_deg": Kind("largest error, inside fault windows", "deg", True),
        "fault_estimate_rmse_outside_deg": Kind("RMSE, outside fault windows", "deg", True),
        "fault_estimate_max_outside_deg": Kind("largest error, outside fault windows", "deg", True),
    },
    "Disturbance and torque": {
        "disturbance_estimate_rmse": Kind("RMSE of the disturbance estimate", "rad/s²", True),
        "torque_rms": Kind("torque, RMS", "N m"),
        "torque_total_variation": Kind("total variation of the torque", "N m/s", True),
        "saturation_share": Kind("samples with the torque cut", "%", True, 100.0),
    },
    "Detection of faults": {
        "fault_count": Kind("faults", ""),
        "missed": Kind("missed faults", "", True),
        "already_declared": Kind("axis declared faulty before the onset", "", True),
        "not_recovered": Kind("sensor not trusted again after a fault", "", True),
        "fault_count_by_kind": Kind("faults", ""),
        "missed_by_kind": Kind("missed faults", "", True),
        "delay_median_s": Kind("detection delay, median", "ms", True, 1e3),
        "delay_max_s": Kind("detection delay, largest", "ms", True, 1e3),
        "onset_error_median_s": Kind("error of the onset, median", "ms", True, 1e3),
        "recovery_delay_median_s": Kind("trusted again after, median", "s", True),
        "recovery_delay_max_s": Kind("trusted again after, at most", "s", True),
    },
    "Estimate, fault by fault": {
        "estimate_rmse_median_deg": Kind("RMSE, median", "deg", True),
        "estimate_rmse_p95_deg": Kind("RMSE, 95th percentile", "deg", True),
        "estimate_rmse_detected_median_deg": Kind("RMSE once detected, median", "deg", True),
        "estimate_rmse_detected_p95_deg": Kind("RMSE once detected, 95th percentile", "deg", True),
        "estimate_bias_mean_deg": Kind("mean error", "deg"),
        "estimate_max_deg": Kind("largest error", "deg", True),
        "tracking_rmse_median_deg": Kind("tracking RMSE, median", "deg", True),
        "tracking_rmse_p95_deg": Kind("tracking RMSE, 95th percentile", "deg", True),
        "nees": Kind("NEES", ""),
        "nees_low": Kind("NEES if consistent, at least", ""),
        "nees_high": Kind("NEES if consistent, at most", ""),
        "coverage_2_sigma": Kind("errors within two standard deviations", "%", False, 100.0),
    },
    "Healthy axes": {
        "healthy_time_s": Kind("healthy time", "s"),
        "false_alarms": Kind("false alarms", "", True),
        "false_alarms_per_hour": Kind("false alarms an hour", "1/h", True),
        "false_alarm_time_s": Kind("declared faulty", "s", True),
        "false_alarm_share": Kind("declared faulty", "%", True, 100.0),
        "late_recovery_time_s": Kind("of it left over from a fault", "s", True),
        "late_recovery_share": Kind("of it left over from a fault", "%", True, 100.0),
        "starting_share": Kind("samples before the diagnosis begins", "%", True, 100.0),
    },
    "Isolation": {
        "isolation_tested_s": Kind("faulty and healthy axes, some declared", "s"),
        "isolation_correct_s": Kind("of it no healthy axis declared", "s"),
        "isolation_accuracy": Kind("isolation accuracy", "%", False, 100.0),
    },
}
_FLIGHT_AND_DIAGNOSIS = {name: title for title, kinds in SECTIONS.items() for name in kinds}
_BY_ESTIMATE = {
    "threshold_deg": Kind("threshold", "deg"),
    "already_above": Kind("estimate above it before the onset", "", True),
    "false_alarm_time_s": Kind("healthy axis above it", "s", True),
    "false_alarm_share": Kind("healthy axis above it", "%", True, 100.0),
}  # where they differ from those by the fault states
_SINGLE = {
    "tracking_mean_deg": Kind("mean tracking error", "deg"),
    "fault_estimate_rmse_deg": Kind("RMSE of the fault estimate", "deg", True),
    "fault_estimate_max_deg": Kind("largest error of the fault estimate", "deg", True),
    SETTLING: Kind("fault estimate settles in", "ms", True, 1e3),
    "detected": Kind("detected", ""),
    "already_declared": Kind("declared faulty before the onset", ""),
    "detection_delay_s": Kind("detection delay", "ms", True, 1e3),
    "onset_error_s": Kind("onset as it was reported, less the true one", "ms", False, 1e3),
    "declared_share": Kind("share of the fault in which it is declared", "%", False, 100.0),
    "declarations": Kind("times it was declared", ""),
    "recovered": Kind("sensor trusted again", ""),
    "recovery_delay_s": Kind("trusted again after", "s", True),
    "above_threshold": Kind("estimate above the threshold", ""),
    "above_threshold_already": Kind("estimate above it before the onset", ""),
    "above_threshold_delay_s": Kind("estimate above it after", "ms", True, 1e3),
    "estimate_rmse_deg": Kind("RMSE of the estimate", "deg", True),
    "estimate_bias_deg": Kind("mean error of the estimate", "deg"),
    "estimate_max_deg": Kind("largest error of the estimate", "deg", True),
    "estimate_rmse_detected_deg": Kind("RMSE of the estimate once detected", "deg", True),
    "estimate_max_detected_deg": Kind("largest error of the estimate once detected", "deg", True),
    "nees_samples": Kind("independent samples", ""),
}  # of a fault window or a single fault; where it is not here, as of the flight
_CONFUSIONS = {"confusion_single_s": "only {} faulty", "confusion_any_s": "{} faulty"}
_COLUMNS = {
    "none": "nothing declared",
    "time": "all the time",
    "own": "its axis declared",
    "other": "a healthy axis declared",
}
_NOT_METRICS = ("start", "stop", "axes", "axis", "kind")  # of a window, of an event


def leaves(metrics: Any, prefix: str = "") -> Iterator[tuple[str, str | None]]:
    """Yield the path of every number; without the axis, which comes beside it, if there is one for each."""
    entries: Mapping[str, Any] = (
        cast("dict[str, Any]", metrics)
        if isinstance(metrics, dict)
        else {str(index): item for index, item in enumerate(cast("list[Any]", metrics))}
    )
    listed = prefix.startswith((WINDOW, EVENT))
    for name, value in entries.items():
        if listed and name in _NOT_METRICS:
            continue
        if isinstance(value, (dict, list)):
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield (prefix[:-1], name) if name in AXES else (f"{prefix}{name}", None)


def place_of(path: str) -> tuple[int, int, int]:
    """Return a sort key: flight, diagnosis, windows and single faults by number, unknown."""
    words = path.split(".")
    if path.startswith(WINDOW):
        return 2, int(words[1]), 0
    if path.startswith(EVENT):
        return 3, int(words[2]), 0
    names = list(_FLIGHT_AND_DIAGNOSIS)
    known = words[0] in names
    return (1 if path.startswith(DIAGNOSIS) else 0 if known else 4), 0, names.index(words[0]) if known else 0


def section_rank(section: str) -> int:
    """Return a sort key of a section; those of one rank stay in the order of their metrics."""
    titles = list(SECTIONS)
    if section in titles:
        return titles.index(section)
    return len(titles) + (2 if section == OTHER else int(section.startswith(DETAILS)))


def kind_of(path: str, runs: Sequence[Recorded] = ()) -> tuple[str, Kind]:
    """Return section and kind of the metric at a path; the runs tell when a fault window or fault was."""
    words = path.split(".")
    if path.startswith(WINDOW):
        return _window_title(int(words[1]), runs), _SINGLE.get(words[2]) or _general(words[2])[1]
    if path.startswith(EVENT):
        return _event_title(int(words[2]), runs), _SINGLE.get(words[3]) or _general(words[3])[1]
    if path.startswith(CONFUSION):
        name, row, *column = words[1:]
        who = "no axis faulty" if row == "none" else _CONFUSIONS.get(name, "{}").format(row)
        label = f"{who}: {_COLUMNS.get(''.join(column), 'declared')}"
        return f"{DETAILS} which axis is faulty, against what is declared", Kind(label, "s")
    if not path.startswith(DIAGNOSIS):
        return _general(words[0])
    by_estimate = words[1] == "by_estimate"
    full, *rest = words[2:] if by_estimate else words[1:]
    name = full.removeprefix("total_")
    section, kind = _general(name)
    if by_estimate:
        section, kind = BY_SIZE, _BY_ESTIMATE.get(name, kind)
    if name != full:
        return section, kind._replace(label=f"{kind.label}, all axes")
    for fault in (word for word in rest if word not in (*AXES, "all")):
        if by_estimate:
            return section, kind._replace(label=f"{kind.label}, {fault}")
        return f"{DETAILS} faults by kind: {fault}", kind
    return section, kind


def _general(name: str) -> tuple[str, Kind]:
    """A metric of the flight or its diagnosis; an unknown one under its own name."""
    if name in _FLIGHT_AND_DIAGNOSIS:
        section = _FLIGHT_AND_DIAGNOSIS[name]
        return section, SECTIONS[section][name]
    suffix, unit = next(((f"_{unit}", unit) for unit in ("deg", "s") if name.endswith(f"_{unit}")), ("", ""))
    return OTHER, Kind(name.removesuffix(suffix).replace("_", " "), unit)


def _window_title(number: int, runs: Sequence[Recorded]) -> str:
    for window in (metric(run, f"{WINDOW}{number}") for run in runs):
        if window is not None:
            return f"Fault window {number + 1}, {period(window['start'], window['stop'])}"
    return f"Fault window {number + 1}"


def _event_title(number: int, runs: Sequence[Recorded]) -> str:
    for event in (metric(run, f"{EVENT}{number}") for run in runs):
        if event is not None:
            when = period(event["start"], event["stop"])
            return f"{DETAILS} the {event['kind']} on {event['axis']}, {when}"
    return f"{DETAILS} fault {number + 1}"
