"""What a batch keeps of each flight: sums and extremes of its samples, and the metrics from them.

The metrics are those of `quadftc_flight.metrics` and `quadftc_flight.diagnosis_metrics`. Sums are taken out
and set to zero every few hundred samples, and added in double precision.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.loop_step import Row
from quadftc_flight.diagnosis_metrics import ESTIMATE_THRESHOLD_DEG, GRACE_TIME
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_model.arrays import Array, namespace
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES, FAULTY, HEALTHY, RECOVERING, SUSPECT

Floats = NDArray[np.float64]

ABOVE = float(np.radians(ESTIMATE_THRESHOLD_DEG))  # rad


class Schedule(NamedTuple):
    """When the attitude of a flight is faulty."""

    start: Array  # (events, 3) of the faults of each axis [s]; infinite: no more
    stop: Array  # (events, 3)
    following: Array  # (events, 3) start of the next fault of the axis [s]


class Sums(NamedTuple):
    """What adds up; each (3,) but those of events (events, 3)."""

    delivered: Array  # () samples
    tracking: Array  # squares of attitude minus reference [rad²]
    disturbance: Array  # squares of the error of its estimate [rad²/s⁴]
    known: Array  # samples whose true fault is finite
    estimate: Array  # squares of the error of the fault's estimate [rad²]
    torque: Array  # squares [N² m²]
    variation: Array  # absolute changes of the torque [N m]
    saturated: Array  # samples with the torque cut
    starting: Array  # samples before the diagnosis has begun
    healthy: Array  # healthy, and with a state
    alarms: Array  # times it was declared faulty while healthy
    alarmed: Array  # samples declared faulty while healthy
    event_known: Array  # samples whose true fault is finite
    event_error: Array  # error of the estimate [rad]
    event_squares: Array  # its squares [rad²]
    event_tracking: Array  # squares [rad²]
    event_delivered: Array  # samples
    event_declared: Array  # of those, declared faulty


class Marks(NamedTuple):
    """What is remembered; each (3,) but those of events (events, 3)."""

    tracking: Array  # largest [rad]
    estimate: Array  # largest error of the fault's estimate [rad]
    tilt: Array  # () least cosine of the angle to the vertical
    finite: Array  # () bool: all numbers were finite
    torque: Array  # last command [N m]
    begun: Array  # () bool: there was one
    declared: Array  # bool: in the last sample
    score: Array  # largest estimate while healthy [rad]
    event_sized: Array  # bool: the fault changes the reading
    event_already: Array  # bool: declared in the last sample before
    event_already_above: Array  # bool
    event_detected: Array  # time of the first declaration [s]; infinite: none
    event_above: Array  # time at which the estimate is first as large as a fault [s]
    event_trusted: Array  # time at which the axis is trusted again [s]
    event_error: Array  # largest error of the estimate [rad]
    event_score: Array  # largest estimate [rad]


class Tally(NamedTuple):
    """Everything kept of a flight."""

    sums: Sums
    marks: Marks


class Outcome(NamedTuple):
    """What is left of one flight; arrays as in `Sums` and `Marks`, in double precision."""

    sums: Sums
    marks: Marks
    rows: int  # samples that left the IMU
    period: float  # of the samples [s]

    @property
    def span(self) -> float:
        """Time from the first to the last of them [s]."""
        return (self.rows - 1) * self.period


class _Judged(NamedTuple):
    """One sample, held against the schedule of the faults; (3,), those of events (events, 3)."""

    tracking: Array  # attitude minus reference, without sign [rad]
    size: Array  # of the fault's estimate [rad]
    error: Array  # of the fault's estimate [rad]; 0 where the true fault is non-finite
    known: Array  # bool: the true fault is finite
    declared: Array  # bool: faulty
    trusted: Array  # bool: healthy or suspect
    healthy: Array  # bool: no fault acts, nor did just before
    event: Array  # bool: the fault acts
    after: Array  # bool: it has ended, and the next one has not begun
    starts: Array  # bool: it has not begun


def empty_tally(like: Array, events: int) -> Tally:
    """Tally of no sample, for an array (..., 3)."""
    xp = namespace(like)
    one, axes = like[..., 0] * 0.0, xp.zeros_like(like)
    each = xp.stack([axes] * events, axis=-2)
    no, none, never = axes > 0.0, each > 0.0, each + np.inf
    sums = [
        one if name == "delivered" else each if name.startswith("event") else axes for name in Sums._fields
    ]
    marks = Marks(
        *(axes, axes, one + 1.0, one == 0.0, axes, one > 0.0, no, axes),
        *(none, none, none, never, never, never, each, each),
    )
    return Tally(Sums(*sums), marks)


def update_tally(tally: Tally, row: Row, schedule: Schedule) -> Tally:
    """Take a sample of one flight into its tally."""
    judged = _judge(row, schedule)
    return Tally(_add(tally.sums, tally.marks, row, judged), _mark(tally.marks, row, judged))


def _judge(row: Row, schedule: Schedule) -> _Judged:
    xp = namespace(row.angles)
    there, time, state = row.delivered, row.time, row.estimate.state
    known = there & xp.isfinite(row.fault)
    inside = (schedule.start <= time) & (time < schedule.stop)
    just_after = (schedule.stop <= time) & (time < schedule.stop + GRACE_TIME)
    return _Judged(
        tracking=xp.abs(wrap(row.angles - row.reference)),
        size=xp.abs(row.estimate.fault),
        error=xp.where(known, wrap(row.estimate.fault - row.fault), 0.0),
        known=known,
        declared=(state == FAULTY) | (state == RECOVERING),
        trusted=(state == HEALTHY) | (state == SUSPECT),
        healthy=there & ~(inside | just_after).any(axis=-2),
        event=there & inside,
        after=there & (schedule.stop <= time) & (time < schedule.following),
        starts=there & (time < schedule.start),
    )


def _add(sums: Sums, marks: Marks, row: Row, judged: _Judged) -> Sums:
    xp = namespace(row.angles)
    there, torque, declared = row.delivered, row.output.torque, judged.declared
    tracking, error, healthy, event = judged.tracking, judged.error, judged.healthy, judged.event
    one, count = 1.0 * there, 1.0 * (event & judged.known)
    terms = Sums(
        delivered=one,
        tracking=one * tracking**2,
        disturbance=one * (row.disturbance_estimate - row.disturbance) ** 2,
        known=1.0 * judged.known,
        estimate=error**2,
        torque=one * torque**2,
        variation=xp.where(there & marks.begun, xp.abs(torque - marks.torque), 0.0),
        saturated=1.0 * (there & row.output.saturated),
        starting=1.0 * (there & ~(declared | judged.trusted)),
        healthy=1.0 * healthy,
        alarms=1.0 * (healthy & declared & ~marks.declared),
        alarmed=1.0 * (healthy & declared),
        event_known=count,
        event_error=count * error,
        event_squares=count * error**2,
        event_tracking=1.0 * event * tracking**2,
        event_delivered=1.0 * event,
        event_declared=1.0 * (event & declared),
    )
    return Sums(*(total + term for total, term in zip(sums, terms, strict=True)))


def _mark(marks: Marks, row: Row, judged: _Judged) -> Marks:
    xp = namespace(row.angles)
    there, time, torque = row.delivered, row.time, row.output.torque
    tracking, size, error, known, declared, trusted, healthy, event, after, starts = judged
    above, event_known, cosine = size >= ABOVE, event & known, xp.cos(row.angles)
    magnitude = (xp.abs(row.angles) + size + xp.abs(torque)).sum(axis=-1)
    return Marks(
        tracking=xp.maximum(marks.tracking, xp.where(there, tracking, 0.0)),
        estimate=xp.maximum(marks.estimate, xp.abs(error)),
        tilt=xp.minimum(marks.tilt, cosine[..., 0] * cosine[..., 1]),
        finite=marks.finite & (xp.isfinite(magnitude) | ~there),
        torque=xp.where(there, torque, marks.torque),
        begun=marks.begun | there,
        declared=xp.where(there, declared, marks.declared),
        score=xp.maximum(marks.score, xp.where(healthy, size, 0.0)),
        event_sized=marks.event_sized | (event_known & (row.fault != 0.0)),
        event_already=xp.where(starts, declared, marks.event_already),
        event_already_above=xp.where(starts, above, marks.event_already_above),
        event_detected=xp.minimum(marks.event_detected, xp.where(event & declared, time, np.inf)),
        event_above=xp.minimum(marks.event_above, xp.where(event & above, time, np.inf)),
        event_trusted=xp.minimum(marks.event_trusted, xp.where(after & trusted, time, np.inf)),
        event_error=xp.maximum(marks.event_error, xp.where(event_known, xp.abs(error), 0.0)),
        event_score=xp.maximum(marks.event_score, xp.where(event, size, 0.0)),
    )


def most_events(events: Sequence[FaultEvent]) -> int:
    """Of any axis; at least one, so that there is something to compute with."""
    return max([1, *(sum(event.axis == axis for event in events) for axis in AXES)])


def schedule_of(events: Sequence[FaultEvent], most: int) -> tuple[Floats, Floats, Floats]:
    """Start, stop and start of the next fault of each axis (most, 3) [s]; infinite where there is none."""
    start, stop, following = (np.full((most, len(AXES)), np.inf) for _ in range(3))
    for axis, name in enumerate(AXES):
        own = [event for event in events if event.axis == name]
        start[: len(own), axis] = [event.start for event in own]
        stop[: len(own), axis] = [event.stop for event in own]
        for place, event in enumerate(own):
            later = [other.start for other in own if other.start >= event.stop]
            following[place, axis] = min(later, default=np.inf)
    return start, stop, following


def flight_record(outcome: Outcome) -> dict[str, Any]:
    """Metrics of the whole flight, by name.

    Those of an axis are called ``name.axis``. None: there is no value, as where no sample counts.
    """
    sums, marks = outcome.sums, outcome.marks
    return {
        "finite": bool(marks.finite),
        **_axes("tracking_rmse_deg", np.degrees(_rms(sums.tracking, sums.delivered))),
        **_axes("tracking_max_deg", np.degrees(_if(sums.delivered, marks.tracking))),
        **_axes("fault_estimate_rmse_deg", np.degrees(_rms(sums.estimate, sums.known))),
        **_axes("fault_estimate_max_deg", np.degrees(_if(sums.known, marks.estimate))),
        **_axes("disturbance_estimate_rmse", _rms(sums.disturbance, sums.delivered)),
        **_axes("torque_rms", _rms(sums.torque, sums.delivered)),
        **_axes("torque_total_variation", _if(outcome.span > 0.0, sums.variation / max(outcome.span, 1e-9))),
        **_axes("saturation_share", _mean(sums.saturated, sums.delivered)),
        "max_tilt_deg": float(np.degrees(np.arccos(np.clip(marks.tilt, -1.0, 1.0)))),
        **_axes("starting_share", _mean(sums.starting, sums.delivered)),
        **_axes("healthy_time_s", sums.healthy * outcome.period),
        **_axes("false_alarms", sums.alarms),
        **_axes("false_alarm_time_s", sums.alarmed * outcome.period),
        **_axes("healthy_estimate_max_deg", np.degrees(_if(sums.healthy, marks.score))),
    }


def fault_records(outcome: Outcome, events: Sequence[FaultEvent]) -> list[dict[str, Any]]:
    """Metrics of each fault, as in the records of `quadftc_flight.diagnosis_metrics`."""
    places: dict[str, int] = dict.fromkeys(AXES, 0)
    records: list[dict[str, Any]] = []
    for event in events:
        records.append(_fault_record(outcome, event, (places[event.axis], AXES.index(event.axis))))
        places[event.axis] += 1
    return records


def _fault_record(outcome: Outcome, event: FaultEvent, at: tuple[int, int]) -> dict[str, Any]:
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


def _axes(name: str, values: Floats) -> dict[str, Any]:
    numbers: list[float] = np.asarray(values, np.float64).tolist()
    return {
        f"{name}.{axis}": number if math.isfinite(number) else None
        for axis, number in zip(AXES, numbers, strict=True)
    }
