"""Metrics of the flights of a batch, from their tallies.

They are those of `quadftc_flight.metrics` and `quadftc_flight.diagnosis_metrics`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from quadftc_campaign.batch.engine import Floats, Outcome
from quadftc_flight.diagnosis_metrics.columns import Record, number
from quadftc_flight.diagnosis_metrics.which_rotor import SAID as SAID_KINDS
from quadftc_flight.diagnosis_metrics.which_rotor import TRUE as TRUE_KINDS
from quadftc_flight.diagnosis_metrics.which_rotor import is_sized
from quadftc_flight.diagnosis_metrics.which_sensor import SAID, TRUE
from quadftc_flight.fault_schedule import SENSORS, FaultEvent
from quadftc_model.samples import AXES
from quadftc_sim.rotor_fault import ROTOR

# root mean squares: the sum of squares of each, and the number of samples in it
ROOTS = {
    "tracking_rmse_deg": ("tracking", "delivered"),
    "fault_estimate_rmse_deg": ("estimate", "known"),
    "disturbance_estimate_rmse": ("disturbance", "delivered"),
    "torque_rms": ("torque", "delivered"),
}
VARIATION = "torque_total_variation"


def metric_of(name: str, outcome: Outcome) -> Floats:
    """Return one of `ROOTS` or `VARIATION`, (3,); NaN where no sample counts."""
    if name == VARIATION:
        return _if(outcome.span > 0.0, outcome.sums["variation"] / max(outcome.span, 1e-9))
    squares, count = (outcome.sums[key] for key in ROOTS[name])
    root = np.sqrt(_mean(squares, count))
    return np.degrees(root) if name.endswith("_deg") else root


def flight_record(outcome: Outcome) -> Record:
    """Metrics of the whole flight by name, or by ``name.axis``; None where no sample counts."""
    sums, marks = outcome.sums, outcome.marks
    of_axes = {
        "tracking_rmse_deg": metric_of("tracking_rmse_deg", outcome),
        "tracking_max_deg": np.degrees(_if(sums["delivered"], marks["tracking"])),
        "fault_estimate_rmse_deg": metric_of("fault_estimate_rmse_deg", outcome),
        "fault_estimate_max_deg": np.degrees(_if(sums["known"], marks["estimate"])),
        "disturbance_estimate_rmse": metric_of("disturbance_estimate_rmse", outcome),
        "torque_rms": metric_of("torque_rms", outcome),
        VARIATION: metric_of(VARIATION, outcome),
        "saturation_share": _mean(sums["saturated"], sums["delivered"]),
        "max_tilt_deg": np.degrees(np.arccos(np.clip(marks["upright"], -1.0, 1.0))),
        "starting_share": _mean(sums["starting"], sums["delivered"]),
        "healthy_time_s": sums["healthy"] * outcome.period,
        "false_alarms": sums["alarms"],
        "false_alarm_time_s": sums["alarmed"] * outcome.period,
    }
    of_axes |= {
        "attitude_error_rms_deg": np.degrees(np.sqrt(_mean(sums["tracking"].sum(), sums["delivered"]))),
        "attitude_error_max_deg": np.degrees(_if(sums["delivered"] > 0.0, marks["error"])),
    }
    # a flight whose numbers are not finite any more counts as lost
    unusable = bool(marks["unusable"] or marks.get("astray"))
    record: Record = {
        "finite": not (unusable or marks["restarted"]),
        "lost": bool(marks["lost"] or unusable),
        **_sensor_record(sums, outcome.period),
        **_rotor_record(sums, outcome.period),
    }
    if "position" in sums:
        of_axes |= _position_record(outcome)
    for name, values in of_axes.items():
        if np.ndim(values):
            record |= {f"{name}.{axis}": number(value) for axis, value in zip(AXES, values, strict=True)}
        else:
            record[name] = number(float(values))
    return record


def _position_record(outcome: Outcome) -> dict[str, Floats]:
    """Return how far a vehicle is from where it shall be, and from where it is taken to be."""
    sums, count = outcome.sums, outcome.sums["delivered"]
    return {
        "position_rmse_m": np.sqrt(_mean(sums["position"].sum(), count)),
        "position_max_m": np.sqrt(_if(count > 0.0, outcome.marks["position"])),
        "position_estimate_rmse_m": np.sqrt(_mean(sums["position_estimate"].sum(), count)),
    }


def _sensor_record(sums: dict[str, Floats], period: float) -> dict[str, float]:
    """Which sensors are named, over all axes; as in ``sensors`` of the metrics."""
    confused = sums["confusion"].sum(axis=-1) * period
    names = {
        "false_namings": "misnamings",
        "false_naming_time_s": "misnamed",
        "healthy_time_s": "sensors_healthy",
    }
    scales = {"false_namings": 1.0}
    return {
        f"sensors.confusion_s.{true}.{said}": float(confused[row, column])
        for row, true in enumerate(TRUE)
        for column, said in enumerate(SAID)
    } | {
        f"sensors.{name}.{sensor}": float(sums[key][place]) * scales.get(name, period)
        for name, key in names.items()
        for place, sensor in enumerate(SENSORS)
    }


def _rotor_record(sums: dict[str, Floats], period: float) -> dict[str, float]:
    """Which rotors are named; as in ``rotors`` of the metrics."""
    if "rotors_confusion" not in sums:
        return {}
    seconds = sums["rotors_confusion"] * period
    return {
        f"rotors.confusion_s.{true}.{said}": float(seconds[row, column])
        for row, true in enumerate(TRUE_KINDS)
        for column, said in enumerate(SAID_KINDS)
    } | {
        "rotors.false_namings": float(sums["rotors_misnamings"].sum()),
        "rotors.false_naming_time_s": float(sums["rotors_misnamed"].sum()) * period,
        "rotors.healthy_time_s": float(sums["rotors_healthy"].sum()) * period,
    }


def fault_records(outcome: Outcome, events: Sequence[FaultEvent]) -> list[Record]:
    """Metrics of each fault, as in the records of `quadftc_flight.diagnosis_metrics`.

    Faults of the attitude have the errors of its estimate, faults of each sensor whether it was named. Faults
    of rotors have both: whether the rotor was named, and the errors of its effectiveness.
    """
    places = {(event.component, event.axis): itertools.count() for event in events}
    records: list[Record] = []
    for event in events:
        if event.component == ROTOR:
            place, rotor = next(places[event.component, event.axis]), int(event.axis) - 1
            records.append(_rotor_fault_record(outcome, event, (place, rotor)))
            continue
        place, axis = next(places[event.component, event.axis]), AXES.index(event.axis)
        records.append(_naming_record(outcome, event, (SENSORS.index(event.component), place, axis)))
        if event.component == "attitude":
            records[-1] |= _fault_record(outcome, event, (place, axis))
    return records


def _naming_record(outcome: Outcome, event: FaultEvent, at: tuple[int, int, int]) -> Record:
    sums, marks = _of_fault(outcome, "fault", at)
    stated = sums["delivered"]
    judged = marks["sized"] and stated > 0.0
    return {
        **_naming(event, sums, marks, judged),
        "alarm_delay_s": _delay(marks["alarm_at"], event.start, judged),
        "ambiguous_share": sums["ambiguous"] / stated if stated else None,
        "attitude_error_max_deg": math.degrees(marks["error"]) if stated else None,
    }


def _of_fault(outcome: Outcome, kind: str, at: tuple[int, ...]) -> tuple[dict[str, float], dict[str, Any]]:
    """Return what was tallied of one fault, sums and marks by their names without the ``kind`` of tally."""
    sums, marks = (
        {
            name.removeprefix(f"{kind}_"): each[at].item()
            for name, each in tallies.items()
            if name.startswith(f"{kind}_")
        }
        for tallies in (outcome.sums, outcome.marks)
    )
    return sums, marks


def _naming(event: FaultEvent, sums: dict[str, float], marks: dict[str, Any], judged: bool) -> Record:
    """Return whether and when the faulty element was named, and how long that or something healthy was."""
    stated, already = sums["delivered"], marks["already"]
    return {
        **event._asdict(),
        "named": math.isfinite(marks["named_at"]) if judged else None,
        "already_named": already if judged else None,
        "naming_delay_s": _delay(marks["named_at"], event.start, judged and not already),
        "named_share": sums["named"] / stated if stated else None,
        "misnamed_share": sums["misnamed"] / stated if stated else None,
    }


def _delay(moment: float, since: float, is_judged: bool) -> float | None:
    """Return how much later than another a moment was [s]; None if it never was, or is not judged."""
    return moment - since if is_judged and math.isfinite(moment) else None


def _rotor_fault_record(outcome: Outcome, event: FaultEvent, at: tuple[int, int]) -> Record:
    sums, marks = _of_fault(outcome, "rotor", at)
    stated, settled = sums["delivered"], sums["settled"]
    sized = settled > 0.0 and is_sized(event)
    return {
        **_naming(event, sums, marks, stated > 0.0),
        "size_error_mean": sums["error"] / settled if sized else None,
        "size_error_max": marks["error_max"] if sized else None,
        "position_error_max_m": math.sqrt(marks["away"]) if stated else None,
    }


def _fault_record(outcome: Outcome, event: FaultEvent, at: tuple[int, int]) -> Record:
    sums, marks = _of_fault(outcome, "event", at)
    known, stated, already = sums["known"], sums["delivered"], marks["already"]
    sized = marks["sized"] and stated > 0.0
    detected = math.isfinite(marks["detected"]) if sized else None
    return {
        **event._asdict(),
        "detected": detected,
        "already_declared": already if sized else None,
        "detection_delay_s": _delay(marks["detected"], event.start, sized and not already),
        "declared_share": sums["declared"] / stated if stated else None,
        "recovered": math.isfinite(marks["trusted"]) if detected else None,
        "recovery_delay_s": _delay(marks["trusted"], event.stop, bool(detected)),
        "estimate_rmse_deg": math.degrees(math.sqrt(sums["squares"] / known)) if known else None,
        "estimate_bias_deg": math.degrees(sums["error"] / known) if known else None,
        "estimate_max_deg": math.degrees(marks["error"]) if known else None,
        "tracking_rmse_deg": math.degrees(math.sqrt(sums["tracking"] / stated)) if stated else None,
    }


def _mean(total: Floats, count: Floats) -> Floats:
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _if(condition: ArrayLike, values: ArrayLike) -> Floats:
    return np.where(condition, values, np.nan)
