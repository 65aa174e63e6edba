"""What a batch keeps of each flight, sample by sample: sums and extremes, no trace.

The numbers are those of `quadftc_flight.metrics` and `quadftc_flight.diagnosis_metrics`; angles in radians.
Sums are taken out and set to zero every few hundred samples, and added in double precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.loop import Row
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
    known: Array  # samples with a true fault that is a number
    estimate: Array  # squares of the error of the fault's estimate [rad²]
    torque: Array  # squares [N² m²]
    variation: Array  # absolute changes of the torque [N m]
    saturated: Array  # samples with the torque cut
    stated: Array  # samples of the diagnosis
    starting: Array  # of those, before it has begun
    healthy: Array  # healthy, and with a state
    alarms: Array  # times it was declared faulty while healthy
    alarmed: Array  # samples declared faulty while healthy
    event_known: Array  # samples with a true fault that is a number
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
    finite: Array  # () bool: everything was a number
    torque: Array  # last command [N m]
    begun: Array  # () bool: there was one
    declared: Array  # bool: in the last sample
    above: Array  # bool: the estimate was as large as a fault in the last sample
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


def no_sums(like: Array, events: int) -> Sums:
    """Sums of no sample."""
    xp = namespace(like)
    one, axes, each = (
        like[..., 0] * 0.0,
        xp.zeros_like(like),
        xp.stack([xp.zeros_like(like)] * events, axis=-2),
    )
    kinds = {"delivered": one}
    return Sums(*(kinds.get(name, each if name.startswith("event") else axes) for name in Sums._fields))


def no_tally(like: Array, events: int) -> Tally:
    """Tally of no sample, for an array (..., 3)."""
    xp = namespace(like)
    sums = no_sums(like, events)
    axes, each, one = xp.zeros_like(like), sums.event_known, sums.delivered
    no, none = axes > 0.0, each > 0.0
    never = each + np.inf
    return Tally(
        sums,
        Marks(
            *(axes, axes, one + 1.0, one == 0.0, axes, one > 0.0, no, no, axes),
            *(none, none, none, never, never, never, each, each),
        ),
    )


def tallied(tally: Tally, row: Row, schedule: Schedule) -> Tally:
    """Take a sample."""
    xp = namespace(row.angles)
    sums, marks = tally
    there, time = row.delivered, row.time
    one = 1.0 * there
    tracking = xp.abs(wrap(row.angles - row.reference))
    declared = (row.estimate.state == FAULTY) | (row.estimate.state == RECOVERING)
    trusted = (row.estimate.state == HEALTHY) | (row.estimate.state == SUSPECT)
    size = xp.abs(row.estimate.fault)
    is_above = size >= ABOVE
    known = there & xp.isfinite(row.fault)
    error = xp.where(known, wrap(row.estimate.fault - row.fault), 0.0)
    torque = row.output.torque
    variation = xp.where(there & marks.begun, xp.abs(torque - marks.torque), 0.0)
    inside = (schedule.start <= time) & (time < schedule.stop)
    judged = inside | ((schedule.stop <= time) & (time < schedule.stop + GRACE_TIME))
    healthy = there & ~judged.any(axis=-2)
    begins = declared & ~marks.declared
    event = there & inside
    event_known = known & inside
    after = there & (schedule.stop <= time) & (time < schedule.following)
    starts = time < schedule.start
    count = 1.0 * event_known
    new_sums = Sums(
        delivered=sums.delivered + one,
        tracking=sums.tracking + one * tracking**2,
        disturbance=sums.disturbance + one * (row.disturbance_estimate - row.disturbance) ** 2,
        known=sums.known + 1.0 * known,
        estimate=sums.estimate + error**2,
        torque=sums.torque + one * torque**2,
        variation=sums.variation + variation,
        saturated=sums.saturated + 1.0 * (there & row.output.saturated),
        stated=sums.stated + one,
        starting=sums.starting + 1.0 * (there & ~(declared | trusted)),
        healthy=sums.healthy + 1.0 * healthy,
        alarms=sums.alarms + 1.0 * (healthy & begins),
        alarmed=sums.alarmed + 1.0 * (healthy & declared),
        event_known=sums.event_known + count,
        event_error=sums.event_error + count * error,
        event_squares=sums.event_squares + count * error**2,
        event_tracking=sums.event_tracking + 1.0 * event * tracking**2,
        event_delivered=sums.event_delivered + 1.0 * event,
        event_declared=sums.event_declared + 1.0 * (event & declared),
    )
    cosine = xp.cos(row.angles)
    numbers = (xp.abs(row.angles) + size + xp.abs(torque)).sum(axis=-1)
    new_marks = Marks(
        tracking=xp.maximum(marks.tracking, xp.where(there, tracking, 0.0)),
        estimate=xp.maximum(marks.estimate, xp.abs(error)),
        tilt=xp.minimum(marks.tilt, cosine[..., 0] * cosine[..., 1]),
        finite=marks.finite & (xp.isfinite(numbers) | ~there),
        torque=xp.where(there, torque, marks.torque),
        begun=marks.begun | there,
        declared=xp.where(there, declared, marks.declared),
        above=xp.where(there, is_above, marks.above),
        score=xp.maximum(marks.score, xp.where(healthy, size, 0.0)),
        event_sized=marks.event_sized | (event_known & (row.fault != 0.0)),
        event_already=xp.where(there & starts, declared, marks.event_already),
        event_already_above=xp.where(there & starts, is_above, marks.event_already_above),
        event_detected=xp.minimum(marks.event_detected, xp.where(event & declared, time, np.inf)),
        event_above=xp.minimum(marks.event_above, xp.where(event & is_above, time, np.inf)),
        event_trusted=xp.minimum(marks.event_trusted, xp.where(after & trusted, time, np.inf)),
        event_error=xp.maximum(marks.event_error, xp.where(event_known, xp.abs(error), 0.0)),
        event_score=xp.maximum(marks.event_score, xp.where(event, size, 0.0)),
    )
    return Tally(new_sums, new_marks)


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
