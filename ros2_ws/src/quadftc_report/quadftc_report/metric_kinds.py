"""What each metric of a summary is: its section of the table, its label, its unit, whether less is better."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, cast

from quadftc_flight.diagnosis_metrics import ESTIMATE_THRESHOLD_DEG
from quadftc_flight.metrics import entries
from quadftc_model.samples import AXES
from quadftc_report.wording import period

SETTLING = "fault_estimate_settling_s"
DETAILS = ("Fault window", "Diagnosis of")  # how the sections of single faults and kinds of faults begin
BY_SIZE = f"Diagnosis of faults by an estimate above {ESTIMATE_THRESHOLD_DEG:g} deg"
CONFUSION = "Diagnosis of which axis is faulty, against what is declared"
SCALES = {"%": 100.0, "ms": 1e3}  # of units that are not those of the summary


class Kind(NamedTuple):
    """A metric."""

    label: str
    unit: str = ""
    less_is_better: bool = False


SECTIONS: dict[str, dict[str, Kind]] = {
    "Tracking": {
        "tracking_rmse_deg": Kind("tracking RMSE", "deg", True),
        "tracking_mean_deg": Kind("mean tracking error", "deg"),
        "tracking_max_deg": Kind("largest tracking error", "deg", True),
        "max_tilt_deg": Kind("largest tilt", "deg"),
    },
    "Fault estimate": {
        "fault_max_deg": Kind("largest fault", "deg"),
        "fault_estimate_max_settled_deg": Kind("largest error of the estimate, settled", "deg", True),
        "fault_estimate_max_deg": Kind("largest error of the estimate", "deg", True),
        "fault_estimate_rmse_deg": Kind("RMSE of the estimate", "deg", True),
        "fault_estimate_rmse_inside_deg": Kind("RMSE, inside fault windows", "deg", True),
        "fault_estimate_max_inside_deg": Kind("largest error, inside fault windows", "deg", True),
        "fault_estimate_rmse_outside_deg": Kind("RMSE, outside fault windows", "deg", True),
        "fault_estimate_max_outside_deg": Kind("largest error, outside fault windows", "deg", True),
        SETTLING: Kind("fault estimate settles in", "ms", True),
    },
    "Disturbance and torque": {
        "disturbance_estimate_rmse": Kind("RMSE of the disturbance estimate", "rad/s²", True),
        "torque_rms": Kind("torque, RMS", "N m"),
        "torque_total_variation": Kind("total variation of the torque", "N m/s", True),
        "saturation_share": Kind("samples with the torque cut", "%", True),
    },
    "Detection of faults": {
        "fault_count": Kind("faults"),
        "missed": Kind("missed faults", "", True),
        "already_declared": Kind("axis declared faulty before the onset", "", True),
        "not_recovered": Kind("sensor not trusted again after a fault", "", True),
        "fault_count_by_kind": Kind("faults"),
        "missed_by_kind": Kind("missed faults", "", True),
        "delay_median_s": Kind("detection delay, median", "ms", True),
        "delay_max_s": Kind("detection delay, largest", "ms", True),
        "onset_error_median_s": Kind("error of the onset, median", "ms", True),
        "recovery_delay_median_s": Kind("trusted again after, median", "s", True),
        "recovery_delay_max_s": Kind("trusted again after, at most", "s", True),
        "detected": Kind("detected"),
        "detection_delay_s": Kind("detection delay", "ms", True),
        "onset_error_s": Kind("onset as it was reported, less the true one", "ms"),
        "declared_share": Kind("share of the fault in which it is declared", "%"),
        "declarations": Kind("times it was declared"),
        "recovered": Kind("sensor trusted again"),
        "recovery_delay_s": Kind("trusted again after", "s", True),
        "threshold_deg": Kind("threshold", "deg"),
        "already_above": Kind("estimate above it before the onset", "", True),
        "above_threshold": Kind("estimate above the threshold"),
        "above_threshold_already": Kind("estimate above it before the onset"),
        "above_threshold_delay_s": Kind("estimate above it after", "ms", True),
    },
    "Estimate, fault by fault": {
        "estimate_rmse_median_deg": Kind("RMSE, median", "deg", True),
        "estimate_rmse_p95_deg": Kind("RMSE, 95th percentile", "deg", True),
        "estimate_rmse_detected_median_deg": Kind("RMSE once detected, median", "deg", True),
        "estimate_rmse_detected_p95_deg": Kind("RMSE once detected, 95th percentile", "deg", True),
        "estimate_bias_mean_deg": Kind("mean error", "deg"),
        "estimate_max_deg": Kind("largest error of the estimate", "deg", True),
        "tracking_rmse_median_deg": Kind("tracking RMSE, median", "deg", True),
        "tracking_rmse_p95_deg": Kind("tracking RMSE, 95th percentile", "deg", True),
        "nees": Kind("NEES"),
        "nees_low": Kind("NEES if consistent, at least"),
        "nees_high": Kind("NEES if consistent, at most"),
        "coverage_2_sigma": Kind("errors within two standard deviations", "%"),
        "estimate_rmse_deg": Kind("RMSE of the estimate", "deg", True),
        "estimate_bias_deg": Kind("mean error of the estimate", "deg"),
        "estimate_rmse_detected_deg": Kind("RMSE of the estimate once detected", "deg", True),
        "estimate_max_detected_deg": Kind("largest error of the estimate once detected", "deg", True),
        "nees_samples": Kind("independent samples"),
    },
    "Healthy axes": {
        "healthy_time_s": Kind("healthy time", "s"),
        "false_alarms": Kind("false alarms", "", True),
        "false_alarms_per_hour": Kind("false alarms an hour", "1/h", True),
        "false_alarm_time_s": Kind("declared faulty", "s", True),
        "false_alarm_share": Kind("declared faulty", "%", True),
        "late_recovery_time_s": Kind("of it left over from a fault", "s", True),
        "late_recovery_share": Kind("of it left over from a fault", "%", True),
        "starting_share": Kind("samples before the diagnosis begins", "%", True),
    },
    "Isolation": {
        "isolation_tested_s": Kind("faulty and healthy axes, some declared", "s"),
        "isolation_correct_s": Kind("of it no healthy axis declared", "s"),
        "isolation_accuracy": Kind("isolation accuracy", "%"),
    },
}
_KINDS = {name: (section, kind) for section, kinds in SECTIONS.items() for name, kind in kinds.items()}
_NOT_METRICS = ("start", "stop", "axes", "axis", "kind")  # of a window, of a fault
_FAULTY = {"confusion_single_s": "only {} faulty", "confusion_any_s": "{} faulty"}
_DECLARED = {
    "none": "nothing declared",
    "time": "all the time",
    "own": "its axis declared",
    "other": "a healthy axis declared",
}


class Leaf(NamedTuple):
    """A number of a summary, or one for each axis."""

    path: str  # without the axis
    has_axes: bool
    section: str
    kind: Kind


def list_metrics(metrics: Any, prefix: str = "", title: str = "") -> Iterator[Leaf]:
    """Yield every number of a summary; ``title``: of the fault window or fault whose numbers these are."""
    for name, value in entries(metrics):
        if name in _NOT_METRICS:
            continue
        if isinstance(value, (dict, list)):
            yield from list_metrics(value, f"{prefix}{name}.", title or _title(value, prefix, name))
        else:
            path = prefix.removesuffix(".") if name in AXES else f"{prefix}{name}"
            section, kind = describe(path)
            yield Leaf(path, name in AXES, title or section, kind)


def _title(value: Any, prefix: str, name: str) -> str:
    """The section of one fault window or one fault; empty: it is neither."""
    if prefix not in ("fault_windows.", "diagnosis.events."):
        return ""
    entry = cast("dict[str, Any]", value)
    when = period(entry["start"], entry["stop"])
    if prefix == "fault_windows.":
        return f"Fault window {int(name) + 1}, from {when}"
    return f"Diagnosis of the {entry['kind']} on {entry['axis']}, from {when}"


def describe(path: str) -> tuple[str, Kind]:
    """Return section and kind of the metric at a path; an unknown one has its own name as its label."""
    part, *words = path.split(".")
    if part != "diagnosis":
        return _look_up(words[1] if part == "fault_windows" else part)
    if words[0] == "events":
        return _look_up(words[2])
    if words[0].startswith("confusion_"):
        who = "no axis faulty" if words[1] == "none" else _FAULTY.get(words[0], "{}").format(words[1])
        return CONFUSION, Kind(f"{who}: {_DECLARED.get(''.join(words[2:]), 'declared')}", "s")
    by_estimate = words[0] == "by_estimate"
    full, *rest = words[1:] if by_estimate else words
    section, kind = _look_up(full.removeprefix("total_"))
    if full.startswith("total_"):
        kind = kind._replace(label=f"{kind.label}, all axes")
    faults = [word for word in rest if word != "all"]  # by kind
    if by_estimate:
        return BY_SIZE, kind._replace(label=", ".join([kind.label, *faults]))
    return f"Diagnosis of faults by kind: {faults[0]}" if faults else section, kind


def _look_up(name: str) -> tuple[str, Kind]:
    suffix, unit = next(((f"_{unit}", unit) for unit in ("deg", "s") if name.endswith(f"_{unit}")), ("", ""))
    return _KINDS.get(name) or ("Other", Kind(name.removesuffix(suffix).replace("_", " "), unit))
