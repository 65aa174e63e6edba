"""What a batch keeps of the samples of a flight: sums and extremes, (events, 3) of faults."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadftc_campaign.batch.judged import JudgeInputs, Motion
from quadftc_campaign.batch.schedule import RotorSchedule, Schedule
from quadftc_flight.diagnosis_metrics import GRACE_TIME
from quadftc_flight.diagnosis_metrics.which_rotor import SIZE_TIME, name_rotors, rotor_confusion
from quadftc_flight.diagnosis_metrics.which_sensor import Naming, confusion, name_sensors
from quadftc_flight.metrics import LOST
from quadftc_model.arrays import Array, namespace
from quadftc_model.rotations import wrap
from quadftc_model.samples import FAULTY, HEALTHY, RECOVERING, SUSPECT, UNUSABLE
from quadftc_sim.rotor_fault import true_effectiveness

Arrays = dict[str, Array]
Parts = tuple[Arrays, Arrays, Arrays, Arrays, Arrays]  # what a sample adds to each part of a tally


class Sums(NamedTuple):
    """Sums over the samples, (3,) but where that is said.

    Those called event_ are of each fault of the attitude, (events, 3); those called fault_ of each fault of a
    sensor, (sensors, events, 3); those called rotor_ of each fault of a rotor, (events, n).
    """

    delivered: Array  # ()
    tracking: Array  # rad²
    disturbance: Array  # rad²/s⁴
    known: Array
    estimate: Array  # rad²
    torque: Array  # N² m²
    variation: Array  # N m
    saturated: Array
    starting: Array
    healthy: Array
    alarms: Array
    alarmed: Array
    event_known: Array
    event_error: Array  # rad
    event_squares: Array  # rad²
    event_tracking: Array  # rad²
    event_delivered: Array
    event_declared: Array
    confusion: Array  # (true, said, 3)
    sensors_healthy: Array  # (sensors,), as the next two
    misnamings: Array
    misnamed: Array
    fault_delivered: Array
    fault_named: Array
    fault_ambiguous: Array
    fault_misnamed: Array
    # in free flight
    position: Array | None = None  # m²
    position_estimate: Array | None = None  # m²
    rotors_confusion: Array | None = None  # (true, said)
    rotors_healthy: Array | None = None  # (n,), as the next two
    rotors_misnamings: Array | None = None
    rotors_misnamed: Array | None = None
    rotor_delivered: Array | None = None
    rotor_named: Array | None = None
    rotor_misnamed: Array | None = None
    rotor_settled: Array | None = None
    rotor_error: Array | None = None  # 1


class Ever(NamedTuple):
    """What was so in some sample, bool."""

    unusable: Array  # () the motion is no number any more
    restarted: Array  # () a law gave what could not be used
    lost: Array  # ()
    event_sized: Array  # the fault changes the reading
    fault_sized: Array
    astray: Array | None = None  # () in free flight: the position is no number any more


class Largest(NamedTuple):
    """Largest values, (3,) but where that is said."""

    tracking: Array  # rad
    estimate: Array  # rad
    error: Array  # () rad
    event_error: Array  # rad
    fault_error: Array  # rad
    position: Array | None = None  # () m²
    rotor_error_max: Array | None = None  # 1
    rotor_away: Array | None = None  # m²


class Smallest(NamedTuple):
    """Smallest values; times [s] are those of the first sample at which something is so."""

    upright: Array  # () cosine of the angle to the vertical
    event_detected: Array
    event_trusted: Array
    fault_named_at: Array
    fault_alarm_at: Array
    rotor_named_at: Array | None = None


class Last(NamedTuple):
    """What was so at the last sample that came, bool but the torque; before a fault where that is said."""

    torque: Array  # (3,) N m
    begun: Array  # () one has come
    declared: Array  # (3,)
    named: Array  # (sensors, 3)
    event_already: Array  # declared before the fault
    fault_already: Array  # named before the fault
    rotors_named: Array | None = None  # (n,)
    rotor_already: Array | None = None  # named before the fault


class Tally(NamedTuple):
    """What is kept of the samples of a flight."""

    sums: Sums
    ever: Ever
    largest: Largest
    smallest: Smallest
    last: Last


def add_tallies(before: Tally, now: Tally) -> Tally:
    """Return the tally of the samples so far and of another one."""
    xp = namespace(now.last.torque)
    return Tally(
        sums=merge(operator.add, before.sums, now.sums),
        ever=merge(xp.logical_or, before.ever, now.ever),
        largest=merge(xp.maximum, before.largest, now.largest),
        smallest=merge(xp.minimum, before.smallest, now.smallest),
        last=now.last,
    )


def tally_sample(inputs: JudgeInputs, motion: Motion, schedule: Schedule, last: Last) -> Tally:
    """Tally one sample, after those of which the last is given."""
    parts = (
        _tally_attitude(inputs, motion, schedule.of_attitude, last),
        _tally_sensors(inputs, motion, schedule, last),
        _tally_position(inputs, motion),
        _tally_rotors(inputs, motion, schedule, last),
    )
    sums, ever, largest, smallest, last_now = (
        {name: value for each in group for name, value in each.items()} for group in zip(*parts, strict=True)
    )
    return Tally(Sums(**sums), Ever(**ever), Largest(**largest), Smallest(**smallest), Last(**last_now))


def merge(operation: Callable[[Array, Array], Array], one: Any, other: Any) -> Any:
    """Return an operation on the arrays of two NamedTuples alike."""
    pairs = zip(one, other, strict=True)
    return type(one)(*(None if a is None else operation(a, b) for a, b in pairs))


def _tally_attitude(inputs: JudgeInputs, motion: Motion, schedule: Schedule, last: Last) -> Parts:
    """Tally motion, torque and the diagnosis of the attitude."""
    xp = namespace(inputs.torque)
    there, time, torque, state = inputs.delivered, inputs.time, inputs.torque, inputs.state
    angles, fault = motion.angles, inputs.faults.attitude
    # what the diagnosis says, and how far it is off where the true fault is finite
    declared, trusted = (state == FAULTY) | (state == RECOVERING), (state == HEALTHY) | (state == SUSPECT)
    known = there & xp.isfinite(fault)
    error = xp.where(known, wrap(inputs.estimate - fault), 0.0)
    tracking, cosine = xp.abs(wrap(angles - inputs.reference)), xp.cos(angles)
    # which faults act, have ended with no other begun, and are still to come; healthy: none acts or just did
    inside, over = (schedule.start <= time) & (time < schedule.stop), schedule.stop <= time
    event, after, early = there & inside, there & over & (time < schedule.following), time < schedule.start
    healthy = there & ~(inside | (over & (time < schedule.stop + GRACE_TIME))).any(axis=-2)
    one, event_known = 1.0 * there, event & known
    count = 1.0 * event_known
    sums = {
        "delivered": one,
        "tracking": one * tracking**2,
        "disturbance": one * (inputs.disturbance - motion.disturbance) ** 2,
        "known": 1.0 * known,
        "estimate": error**2,
        "torque": one * torque**2,
        "variation": xp.where(there & last.begun, xp.abs(torque - last.torque), 0.0),
        "saturated": 1.0 * (there & inputs.saturated),
        "starting": 1.0 * (there & ~(declared | trusted)),
        "healthy": 1.0 * healthy,
        "alarms": 1.0 * (healthy & declared & ~last.declared),
        "alarmed": 1.0 * (healthy & declared),
        "event_known": count,
        "event_error": count * error,
        "event_squares": count * error**2,
        "event_tracking": 1.0 * event * tracking**2,
        "event_delivered": 1.0 * event,
        "event_declared": 1.0 * (event & declared),
    }
    ever = {
        "unusable": there & ~(xp.abs(angles).sum(axis=-1) < UNUSABLE),
        "restarted": there & xp.stack(inputs.failed, axis=-1).any(axis=-1),
        "event_sized": event_known & (fault != 0.0),
    }
    largest = {
        "tracking": xp.where(there, tracking, 0.0),
        "estimate": xp.abs(error),
        "event_error": xp.where(event_known, xp.abs(error), 0.0),
    }
    smallest = {
        "upright": xp.where(inputs.left, cosine[..., 0] * cosine[..., 1], 1.0),
        "event_detected": xp.where(event & declared, time, np.inf),
        "event_trusted": xp.where(after & trusted, time, np.inf),
    }
    new_last = {
        "torque": xp.where(there, torque, last.torque),
        "begun": last.begun | there,
        "declared": xp.where(there, declared, last.declared),
        "event_already": xp.where(there & early, declared, last.event_already),
    }
    return sums, ever, largest, smallest, new_last


def _tally_sensors(inputs: JudgeInputs, motion: Motion, schedule: Schedule, last: Last) -> Parts:
    """Tally which sensor is named, as `quadftc_flight.diagnosis_metrics.which_sensor` judges it."""
    xp = namespace(inputs.torque)
    there, time, naming = inputs.delivered, inputs.time, _naming(inputs)
    # which faults act, by sensor and axis, and which sensors are healthy
    inside, faulty, healthy = _truth(inputs, schedule)
    named, wrong = naming.named, naming.named & healthy
    anything = naming.named.any(axis=-2) | naming.ambiguous
    truth = xp.stack(inputs.faults, axis=-2)
    error = xp.abs(wrap(motion.angles - inputs.reference))
    size = xp.sqrt((error**2).sum(axis=-1))
    tilted, wanted = (xp.cos(x[..., 0]) * xp.cos(x[..., 1]) for x in (motion.angles, inputs.reference))
    limit = math.cos(LOST)
    lost = (tilted < limit) & (wanted >= limit) | (error > LOST).any(axis=-1)
    sums = {
        "confusion": 1.0 * confusion(faulty, healthy, naming),
        "sensors_healthy": 1.0 * healthy.sum(axis=-1),
        "misnamings": 1.0 * (wrong & ~last.named).sum(axis=-1),
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
        "error": xp.where(there, size, 0.0),
        "fault_error": xp.where(inside, size, 0.0),
    }
    smallest = {
        "fault_named_at": xp.where(inside & named[..., None, :], time, np.inf),
        "fault_alarm_at": xp.where(inside & anything, time, np.inf),
    }
    early = there & (time < schedule.start)
    new_last = {
        "named": xp.where(there, named, last.named),
        "fault_already": xp.where(early, named[..., None, :], last.fault_already),
    }
    return sums, ever, largest, smallest, new_last


def _tally_position(inputs: JudgeInputs, motion: Motion) -> Parts:
    """Tally where a vehicle is in free flight."""
    if inputs.place is None:
        return {}, {}, {}, {}, {}
    there = namespace(inputs.torque).where
    off, wrong = (
        there(inputs.delivered, (motion.position - other) ** 2, 0.0)
        for other in (inputs.place.reference, inputs.place.estimate)
    )
    distance, sums = off.sum(axis=-1), {"position": off, "position_estimate": wrong}
    astray = ~(distance + wrong.sum(axis=-1) < UNUSABLE)
    return sums, {"astray": astray}, {"position": distance}, {}, {}


def _tally_rotors(inputs: JudgeInputs, motion: Motion, schedule: Schedule, last: Last) -> Parts:
    """Tally which rotor is named, as `quadftc_flight.diagnosis_metrics.which_rotor` judges it."""
    rotors, said = schedule.rotors, inputs.rotors
    if rotors is None or said is None or inputs.place is None or last.rotors_named is None:
        return {}, {}, {}, {}, {}
    xp, there, time = namespace(inputs.torque), inputs.delivered, inputs.time
    # which rotors are named, and where that, or naming a sensor, is wrong
    named = name_rotors(said.state, said.ambiguous)
    inside, faulty, healthy = _truth(inputs, rotors)
    _, sensor_faulty, sensor_healthy = _truth(inputs, schedule)
    of_sensors = _naming(inputs).named
    wrong = named & healthy
    misnamed = wrong.any(axis=-1) | (of_sensors & sensor_healthy).any(axis=(-2, -1))
    counted = xp.all(faulty | healthy, axis=-1) & xp.all(sensor_faulty | sensor_healthy, axis=(-2, -1))
    any_sensor = (sensor_faulty.any(axis=(-2, -1)), of_sensors.any(axis=(-2, -1)))
    # the size counts once the diagnosis has had `SIZE_TIME`, the place all the time
    settled = inside & (time >= rotors.start + SIZE_TIME)
    error = xp.abs(said.effectiveness - true_effectiveness(said.condition))
    away = ((motion.position - inputs.place.reference) ** 2).sum(axis=-1)
    early = there & (time < rotors.start)
    sums = {
        "rotors_confusion": 1.0 * (counted & rotor_confusion(faulty, named, *any_sensor)),
        "rotors_healthy": 1.0 * healthy,
        "rotors_misnamings": 1.0 * (wrong & ~last.rotors_named),
        "rotors_misnamed": 1.0 * wrong,
        "rotor_delivered": 1.0 * inside,
        "rotor_named": 1.0 * (inside & named),
        "rotor_misnamed": 1.0 * (inside & misnamed),
        "rotor_settled": 1.0 * settled,
        "rotor_error": xp.where(settled, error, 0.0),
    }
    largest = {
        "rotor_error_max": xp.where(settled, error, 0.0),
        "rotor_away": xp.where(inside, away, 0.0),
    }
    smallest = {"rotor_named_at": xp.where(inside & named, time, np.inf)}
    new_last = {
        "rotors_named": xp.where(there, named, last.rotors_named),
        "rotor_already": xp.where(early, named, last.rotor_already),
    }
    return sums, {}, largest, smallest, new_last


def _truth(inputs: JudgeInputs, schedule: Schedule | RotorSchedule) -> tuple[Array, Array, Array]:
    """Return which faults act (..., events, elements), and which elements are faulty and which healthy."""
    there, time = inputs.delivered, inputs.time
    inside = there & (schedule.start <= time) & (time < schedule.stop)
    grace = (schedule.stop <= time) & (time < schedule.stop + GRACE_TIME)
    faulty = inside.any(axis=-2)
    return inside, faulty, there & ~(faulty | grace.any(axis=-2))


def _naming(inputs: JudgeInputs) -> Naming:
    """Return what is said of the sensors."""
    of_attitude, of_gyro = inputs.ambiguous
    return name_sensors(inputs.sensors, (of_attitude, of_gyro, of_gyro & False))
