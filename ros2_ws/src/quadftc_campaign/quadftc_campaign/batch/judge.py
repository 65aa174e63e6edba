"""What a batch keeps of each flight: sums and extremes of its samples.

Sums are taken out and set to zero every few hundred samples, and added in double precision. Metrics come from
them in `batch.records`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.loop_step import Row
from quadftc_flight.diagnosis_metrics import ESTIMATE_THRESHOLD_DEG, GRACE_TIME
from quadftc_flight.diagnosis_metrics.which_rotor import SIZE_TIME, name_rotors, rotor_confusion
from quadftc_flight.diagnosis_metrics.which_sensor import UNSEEN, Naming, confusion, name_sensors
from quadftc_flight.fault_schedule import SENSORS, FaultEvent
from quadftc_flight.metrics import LOST
from quadftc_model.arrays import Array, namespace
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES, FAULTY, HEALTHY, RECOVERING, SUSPECT, UNUSABLE
from quadftc_sim.rotor_fault import ROTOR

Floats = NDArray[np.float64]
# by name, each (3,); those called event_ of each fault of the attitude, (events, 3); those called fault_ of
# each fault of a sensor, (sensors, events, 3)
Arrays = dict[str, Array]

ABOVE = float(np.radians(ESTIMATE_THRESHOLD_DEG))  # rad


class RotorSchedule(NamedTuple):
    """When the rotors of a flight are faulty, (events, n): the faults of each rotor."""

    start: Array  # [s]; infinite: no more
    stop: Array  # [s]


class Schedule(NamedTuple):
    """When the sensors of a flight are faulty, (sensors, events, 3): the faults of each axis."""

    start: Array  # [s]; infinite: no more
    stop: Array  # [s]
    following: Array  # start of the next fault of the axis [s]
    unseen: Array  # 1: the reading is missing, which its true fault does not show; else 0
    rotors: RotorSchedule | None = None  # None: on the test stand

    @property
    def of_attitude(self) -> Schedule:
        """Of the attitude alone, (events, 3)."""
        columns = (self.start, self.stop, self.following, self.unseen)
        return Schedule(*(each[SENSORS.index("attitude")] for each in columns))


class Tally(NamedTuple):
    """What is kept of the samples of a flight."""

    sums: Arrays
    ever: Arrays  # bool: it was so in some sample
    largest: Arrays
    smallest: Arrays
    last: Arrays


class Outcome(NamedTuple):
    """What is left of one flight, in double precision."""

    sums: dict[str, Floats]  # as in `Tally`
    marks: dict[str, Any]  # all else of the tally
    span: float  # time from the first to the last sample [s]
    period: float  # of the samples [s]
    slope: dict[str, Floats] | None = None  # of the sums, along the direction of the flight
    trace: Row | None = None  # every sample, arrays (samples, ...)


def update_tally(tally: Tally | None, row: Row, schedule: Schedule) -> Tally:
    """Add a sample of a flight to its tally; None: it is the first."""
    xp = namespace(row.angles)
    if tally is None:
        no, none = (xp.zeros_like(like, dtype=bool) for like in (row.angles, schedule.start))
        marks = {"event_already": none[0], "event_already_above": none[0], "begun": no[..., 0]}
        marks |= {"fault_already": none, "named": none[:, 0]}
        if schedule.rotors is not None:
            never = xp.zeros_like(schedule.rotors.start, dtype=bool)
            marks |= {"rotor_already": never, "rotors_named": never[0]}
        return _tally(row, schedule, {"torque": xp.zeros_like(row.angles), "declared": no, **marks})
    new = _tally(row, schedule, tally.last)
    operations = (xp.add, xp.logical_or, xp.maximum, xp.minimum)
    sums, ever, largest, smallest = (
        {name: operation(before[name], now[name]) for name in before}
        for operation, before, now in zip(operations, tally[:-1], new[:-1], strict=True)
    )
    return Tally(sums, ever, largest, smallest, new.last)


def _tally(row: Row, schedule: Schedule, last: Arrays) -> Tally:
    """Tally one sample, after those of which the last is given."""
    attitude, sensors = _tally_attitude(row, schedule.of_attitude, last), _tally_sensors(row, schedule, last)
    rotors = _tally_rotors(row, schedule, last)
    parts = zip(attitude, sensors, _tally_position(row), rotors, strict=True)
    return Tally(*(a | b | c | d for a, b, c, d in parts))


def _tally_position(row: Row) -> Tally:
    """Tally where a vehicle is in free flight."""
    tally = Tally({}, {}, {}, {}, {})
    if row.position is None:
        return tally
    there = namespace(row.position).where
    off, wrong = (
        there(row.delivered, (row.position - other) ** 2, 0.0)  # m²
        for other in (row.position_reference, row.position_estimate)
    )
    distance, sums = off.sum(axis=-1), {"position": off, "position_estimate": wrong}
    astray = ~(distance + wrong.sum(axis=-1) < UNUSABLE)
    return tally._replace(sums=sums, largest={"position": distance}, ever={"astray": astray})


def _tally_sensors(row: Row, schedule: Schedule, last: Arrays) -> Tally:
    """Tally which sensor is named, as `quadftc_flight.diagnosis_metrics.which_sensor` judges it."""
    xp = namespace(row.angles)
    there, time, naming = row.delivered, row.time, _naming(row)
    # which faults act, by sensor and axis, and which sensors are healthy
    inside, faulty, healthy = _truth(row, schedule)
    named, wrong = naming.named, naming.named & healthy
    anything = naming.named.any(axis=-2) | naming.ambiguous
    truth = xp.stack((row.fault, row.gyro_fault, row.accelerometer_fault), axis=-2)
    error = xp.abs(wrap(row.angles - row.reference))
    size = xp.sqrt((error**2).sum(axis=-1))
    tilted, wanted = (xp.cos(each[..., 0]) * xp.cos(each[..., 1]) for each in (row.angles, row.reference))
    limit = math.cos(LOST)
    lost = (tilted < limit) & (wanted >= limit) | (error > LOST).any(axis=-1)
    sums = {
        "confusion": 1.0 * confusion(faulty, healthy, naming),
        "sensors_healthy": 1.0 * healthy.sum(axis=-1),
        "misnamings": 1.0 * (wrong & ~last["named"]).sum(axis=-1),
        "misnamed": 1.0 * wrong.sum(axis=-1),
        "fault_delivered": 1.0 * inside,
        "fault_named": 1.0 * (inside & named[..., None, :]),
        "fault_ambiguous": 1.0 * (inside & naming.ambiguous),
        "fault_misnamed": 1.0 * (inside & wrong.any(axis=-2)),
    }
    ever = {
        "lost": there & lost,
        "fault_sized": inside & ((truth[..., None, :] != 0.0) | (schedule.unseen > 0.0)),  # NaN, too
    }
    largest = {
        "error": xp.where(there, size, 0.0),  # rad
        "fault_error": xp.where(inside, size, 0.0),  # rad
    }
    smallest = {
        "fault_named_at": xp.where(inside & named[..., None, :], time, np.inf),  # s
        "fault_alarm_at": xp.where(inside & anything, time, np.inf),  # s
    }
    early = there & (time < schedule.start)
    new_last = {
        "named": xp.where(there, named, last["named"]),
        "fault_already": xp.where(early, named[..., None, :], last["fault_already"]),
    }
    return Tally(sums, ever, largest, smallest, new_last)


def _truth(row: Row, schedule: Schedule | RotorSchedule) -> tuple[Array, Array, Array]:
    """Return which faults act (..., events, elements), and which elements are faulty and which healthy."""
    there, time = row.delivered, row.time
    inside = there & (schedule.start <= time) & (time < schedule.stop)
    grace = (schedule.stop <= time) & (time < schedule.stop + GRACE_TIME)
    faulty = inside.any(axis=-2)
    return inside, faulty, there & ~(faulty | grace.any(axis=-2))


def _tally_rotors(row: Row, schedule: Schedule, last: Arrays) -> Tally:
    """Tally which rotor is named, as `quadftc_flight.diagnosis_metrics.which_rotor` judges it."""
    tally, rotors, said = Tally({}, {}, {}, {}, {}), schedule.rotors, row.estimate.rotors
    if rotors is None or row.rotor_effectiveness is None or row.position is None:
        return tally
    xp, there, time = namespace(row.angles), row.delivered, row.time
    estimate = xp.ones_like(row.rotor_effectiveness) if said is None else said.effectiveness
    named = xp.zeros_like(rotors.start[0], dtype=bool)
    if said is not None:
        named = name_rotors(said.state, said.ambiguous)
    inside, faulty, healthy = _truth(row, rotors)
    _, sensor_faulty, sensor_healthy = _truth(row, schedule)
    of_sensors = _naming(row).named
    wrong = named & healthy
    misnamed = wrong.any(axis=-1) | (of_sensors & sensor_healthy).any(axis=(-2, -1))
    counted = xp.all(faulty | healthy, axis=-1) & xp.all(sensor_faulty | sensor_healthy, axis=(-2, -1))
    any_sensor = (sensor_faulty.any(axis=(-2, -1)), of_sensors.any(axis=(-2, -1)))
    settled = inside & (time >= rotors.start + SIZE_TIME)
    error = xp.abs(estimate - row.rotor_effectiveness)
    off: Array = row.position - row.position_reference
    away = (off**2).sum(axis=-1)  # m²
    early = there & (time < rotors.start)
    return Tally(
        sums={
            "rotors_confusion": 1.0 * (counted & rotor_confusion(faulty, named, *any_sensor)),
            "rotors_healthy": 1.0 * healthy,
            "rotors_misnamings": 1.0 * (wrong & ~last["rotors_named"]),
            "rotors_misnamed": 1.0 * wrong,
            "rotor_delivered": 1.0 * inside,
            "rotor_named": 1.0 * (inside & named),
            "rotor_misnamed": 1.0 * (inside & misnamed),
            "rotor_settled": 1.0 * settled,
            "rotor_error": xp.where(settled, error, 0.0),  # 1
        },
        ever={},
        largest={
            "rotor_error_max": xp.where(settled, error, 0.0),  # 1
            "rotor_away": xp.where(inside, away, 0.0),  # m²
        },
        smallest={"rotor_named_at": xp.where(inside & named, time, np.inf)},  # s
        last={
            "rotors_named": xp.where(there, named, last["rotors_named"]),
            "rotor_already": xp.where(early, named, last["rotor_already"]),
        },
    )


def _naming(row: Row) -> Naming:
    """Return what is said of the sensors; where nothing is said of one, it is taken for healthy."""
    sensors, state = row.estimate.sensors, row.estimate.state
    no = namespace(state).zeros_like(state, dtype=bool)
    if sensors is None:
        return name_sensors((state, 0 * state, 0 * state), (no, no, no))
    states = (sensors.attitude.state, sensors.gyro.state, sensors.accelerometer.state)
    return name_sensors(states, (sensors.attitude.ambiguous, sensors.gyro.ambiguous, no))


def _tally_attitude(row: Row, schedule: Schedule, last: Arrays) -> Tally:
    """Tally motion, torque and the diagnosis of the attitude."""
    xp = namespace(row.angles)
    there, time, torque, state = row.delivered, row.time, row.output.torque, row.estimate.state
    # what the diagnosis says, and how far it is off where the true fault is finite
    declared, trusted = (state == FAULTY) | (state == RECOVERING), (state == HEALTHY) | (state == SUSPECT)
    size, known = xp.abs(row.estimate.fault), there & xp.isfinite(row.fault)
    error = xp.where(known, wrap(row.estimate.fault - row.fault), 0.0)
    above, tracking, cosine = size >= ABOVE, xp.abs(wrap(row.angles - row.reference)), xp.cos(row.angles)
    # which faults act, have ended with no other begun, and are still to come; healthy: none acts or just did
    inside, over = (schedule.start <= time) & (time < schedule.stop), schedule.stop <= time
    event, after, early = there & inside, there & over & (time < schedule.following), time < schedule.start
    healthy = there & ~(inside | (over & (time < schedule.stop + GRACE_TIME))).any(axis=-2)
    one, event_known = 1.0 * there, event & known
    count = 1.0 * event_known
    sums = {
        "delivered": one,
        "tracking": one * tracking**2,  # rad²
        "disturbance": one * (row.disturbance_estimate - row.disturbance) ** 2,  # rad²/s⁴
        "known": 1.0 * known,
        "estimate": error**2,  # rad²
        "torque": one * torque**2,  # N² m²
        "variation": xp.where(there & last["begun"], xp.abs(torque - last["torque"]), 0.0),  # N m
        "saturated": 1.0 * (there & row.output.saturated),
        "starting": 1.0 * (there & ~(declared | trusted)),
        "healthy": 1.0 * healthy,
        "alarms": 1.0 * (healthy & declared & ~last["declared"]),
        "alarmed": 1.0 * (healthy & declared),
        "event_known": count,
        "event_error": count * error,  # rad
        "event_squares": count * error**2,  # rad²
        "event_tracking": 1.0 * event * tracking**2,  # rad²
        "event_delivered": 1.0 * event,
        "event_declared": 1.0 * (event & declared),
    }
    magnitude = (xp.abs(row.angles) + size + xp.abs(row.disturbance_estimate) + xp.abs(torque)).sum(axis=-1)
    ever = {
        "unusable": there & ~(magnitude < UNUSABLE),  # the closed loop restarts a law then
        "event_sized": event_known & (row.fault != 0.0),  # the fault changes the reading
    }
    largest = {
        "tracking": xp.where(there, tracking, 0.0),  # rad
        "estimate": xp.abs(error),  # rad
        "score": xp.where(healthy, size, 0.0),  # rad
        "event_error": xp.where(event_known, xp.abs(error), 0.0),  # rad
        "event_score": xp.where(event, size, 0.0),  # rad
    }
    smallest = {
        "upright": cosine[..., 0] * cosine[..., 1],  # cosine of the angle to the vertical
        "event_detected": xp.where(event & declared, time, np.inf),  # s
        "event_above": xp.where(event & above, time, np.inf),  # s
        "event_trusted": xp.where(after & trusted, time, np.inf),  # s
    }
    new_last = {
        "torque": xp.where(there, torque, last["torque"]),  # N m
        "begun": last["begun"] | there,
        "declared": xp.where(there, declared, last["declared"]),
        "event_already": xp.where(there & early, declared, last["event_already"]),  # before the fault
        "event_already_above": xp.where(there & early, above, last["event_already_above"]),
    }
    return Tally(sums, ever, largest, smallest, new_last)


def schedule_of(flights: Sequence[Sequence[FaultEvent]], rotors: int = 0) -> Schedule:
    """Return the schedule of flights with these faults, arrays (sensors, events, 3, flights).

    In free flight they have so many ``rotors``.
    """
    of_axes = {
        (sensor, axis, flight): [one for one in events if (one.component, one.axis) == (component, name)]
        for flight, events in enumerate(flights)
        for sensor, component in enumerate(SENSORS)
        for axis, name in enumerate(AXES)
    }
    most = max(1, *map(len, of_axes.values()))  # at least one, to have something to compute with
    shape = len(SENSORS), most, len(AXES), len(flights)
    columns = [np.full(shape, value) for value in (np.inf, np.inf, np.inf, 0.0)]
    for (sensor, axis, flight), events in of_axes.items():
        for place, event in enumerate(events):
            following = min((one.start for one in events if one.start >= event.stop), default=np.inf)
            unseen = float(UNSEEN in event.kind)
            values = (event.start, event.stop, following, unseen)
            for column, value in zip(columns, values, strict=True):
                column[sensor, place, axis, flight] = value
    return Schedule(*columns, rotors=_rotor_schedule(flights, rotors) if rotors else None)


def _rotor_schedule(flights: Sequence[Sequence[FaultEvent]], rotors: int) -> RotorSchedule:
    """Return the schedule of the faults of rotors, arrays (events, rotors, flights)."""
    of_rotors = {
        (rotor, flight): [one for one in events if (one.component, one.axis) == (ROTOR, str(rotor + 1))]
        for flight, events in enumerate(flights)
        for rotor in range(rotors)
    }
    most = max(1, *map(len, of_rotors.values()))
    schedule = RotorSchedule(*(np.full((most, rotors, len(flights)), np.inf) for _ in range(2)))
    for (rotor, flight), events in of_rotors.items():
        for place, event in enumerate(events):
            schedule.start[place, rotor, flight], schedule.stop[place, rotor, flight] = (
                event.start,
                event.stop,
            )
    return schedule
