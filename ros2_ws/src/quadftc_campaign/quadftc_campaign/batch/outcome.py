"""The metrics of a flight from its tally, by the names and in the units of `summary.json`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.flown import Outcome
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_model.samples import AXES

Record = dict[str, Any]
Floats = NDArray[np.float64]


def flight_record(outcome: Outcome) -> Record:
    """Metrics of the whole flight, by name.

    Those of an axis are called ``name.axis``. None: there is no value, as where no sample counts.
    """
    sums, marks = outcome.sums, outcome.marks
    span = (outcome.rows - 1) * outcome.period
    return {
        "finite": bool(marks.finite),
        **_axes("tracking_rmse_deg", np.degrees(_rms(sums.tracking, sums.delivered))),
        **_axes("tracking_max_deg", np.degrees(_if(sums.delivered, marks.tracking))),
        **_axes("fault_estimate_rmse_deg", np.degrees(_rms(sums.estimate, sums.known))),
        **_axes("fault_estimate_max_deg", np.degrees(_if(sums.known, marks.estimate))),
        **_axes("disturbance_estimate_rmse", _rms(sums.disturbance, sums.delivered)),
        **_axes("torque_rms", _rms(sums.torque, sums.delivered)),
        **_axes("torque_total_variation", _if(span > 0.0, sums.variation / max(span, 1e-9))),
        **_axes("saturation_share", _mean(sums.saturated, sums.delivered)),
        "max_tilt_deg": float(np.degrees(np.arccos(np.clip(marks.tilt, -1.0, 1.0)))),
        **_axes("starting_share", _mean(sums.starting, sums.stated)),
        **_axes("healthy_time_s", sums.healthy * outcome.period),
        **_axes("false_alarms", sums.alarms),
        **_axes("false_alarm_time_s", sums.alarmed * outcome.period),
        **_axes("healthy_estimate_max_deg", np.degrees(_if(sums.healthy, marks.score))),
    }


def fault_records(outcome: Outcome, events: Sequence[FaultEvent]) -> list[Record]:
    """Metrics of each fault, as in the records of `quadftc_flight.diagnosis_metrics`."""
    places: dict[str, int] = dict.fromkeys(AXES, 0)
    records: list[Record] = []
    for event in events:
        records.append(_fault_record(outcome, event, (places[event.axis], AXES.index(event.axis))))
        places[event.axis] += 1
    return records


def _fault_record(outcome: Outcome, event: FaultEvent, at: tuple[int, int]) -> Record:
    sums, marks = outcome.sums, outcome.marks
    known, stated = float(sums.event_known[at]), float(sums.event_delivered[at])
    sized = bool(marks.event_sized[at]) and stated > 0.0
    detected = _found(marks.event_detected[at], sized)
    above = _found(marks.event_above[at], sized)
    already, already_above = bool(marks.event_already[at]), bool(marks.event_already_above[at])
    trusted = float(marks.event_trusted[at])
    return {
        **event._asdict(),
        "detected": detected,
        "already_declared": already if sized else None,
        "detection_delay_s": _delay(marks.event_detected[at], event.start, detected and not already),
        "declared_share": float(sums.event_declared[at]) / stated if stated else None,
        "recovered": math.isfinite(trusted) if detected else None,
        "recovery_delay_s": _delay(trusted, event.stop, detected and math.isfinite(trusted)),
        "above_threshold": above,
        "above_threshold_delay_s": _delay(marks.event_above[at], event.start, above and not already_above),
        "estimate_rmse_deg": math.degrees(math.sqrt(sums.event_squares[at] / known)) if known else None,
        "estimate_bias_deg": math.degrees(sums.event_error[at] / known) if known else None,
        "estimate_max_deg": math.degrees(marks.event_error[at]) if known else None,
        "estimate_peak_deg": math.degrees(marks.event_score[at]) if stated else None,
        "tracking_rmse_deg": math.degrees(math.sqrt(sums.event_tracking[at] / stated)) if stated else None,
    }


def _found(moment: float, sized: bool) -> bool | None:
    return math.isfinite(moment) if sized else None


def _delay(moment: float, since: float, there: bool | None) -> float | None:
    return float(moment) - since if there else None


def _rms(squares: Floats, count: Any) -> Floats:
    return np.sqrt(_mean(squares, count))


def _mean(total: Floats, count: Any) -> Floats:
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _if(condition: Any, values: Floats) -> Floats:
    return np.where(condition, values, np.nan)


def _axes(name: str, values: Floats) -> Record:
    numbers: list[float] = np.asarray(values, np.float64).tolist()
    return {
        f"{name}.{axis}": number if math.isfinite(number) else None
        for axis, number in zip(AXES, numbers, strict=True)
    }
