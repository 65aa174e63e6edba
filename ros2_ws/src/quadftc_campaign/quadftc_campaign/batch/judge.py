"""What a batch keeps of each flight: sums and extremes of its samples.

A law adds them up sample by sample, in C as in JAX. Metrics come from them in `batch.records`.
"""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_flight.diagnosis_metrics import GRACE_TIME
from quadftc_flight.diagnosis_metrics.which_rotor import SIZE_TIME, name_rotors, rotor_confusion
from quadftc_flight.diagnosis_metrics.which_sensor import UNSEEN, Naming, confusion, name_sensors
from quadftc_flight.fault_schedule import SENSORS, FaultEvent
from quadftc_flight.metrics import LOST
from quadftc_model.arrays import Array, Components, Flag, Mask, Scalar, States, Vector, branch, namespace
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES, FAULTY, HEALTHY, RECOVERING, SUSPECT, UNUSABLE, RotorCondition
from quadftc_sim.delay_line import fill_line, shift_line
from quadftc_sim.rotor_fault import ROTOR, healthy_rotors, true_effectiveness

Arrays = dict[str, Array]
Parts = tuple[Arrays, Arrays, Arrays, Arrays, Arrays]  # what a sample adds to each part of a tally


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


class Motion(NamedTuple):
    """How a vehicle moves, true."""

    angles: Vector  # Euler angles [rad]
    disturbance: Vector  # [rad/s²]
    position: Vector | None  # [m]; None: on the test stand


class OfSensors(NamedTuple):
    """Something of each sensor."""

    attitude: Array
    gyro: Array
    accelerometer: Array


class Place(NamedTuple):
    """Where a vehicle in free flight shall be, and where it takes itself to be."""

    reference: Vector  # [m]
    estimate: Vector  # [m]


class Rotors(NamedTuple):
    """The rotors, and what is said of them."""

    condition: RotorCondition  # true
    state: States
    effectiveness: Components  # estimated [1]
    ambiguous: Mask


class JudgeInputs(NamedTuple):
    """A sample that is taken, and what is known of the one that leaves the IMU then."""

    motion: Motion  # at the sample that is taken
    left: Flag  # one has left the IMU; if not, the rest says nothing
    delivered: Flag  # and no fault has withheld it
    time: Scalar  # when that one was taken [s]
    faults: OfSensors  # true: [rad], [rad/s], [m/s²]
    reference: Vector  # Euler angles [rad]
    estimate: Vector  # of the fault of the attitude [rad]
    state: States  # of the attitude
    sensors: OfSensors  # states of each
    ambiguous: tuple[Mask, Mask]  # of attitude and gyro
    disturbance: Vector  # estimated [rad/s²]
    torque: Vector  # [N m]
    saturated: Mask
    failed: tuple[Flag, ...]  # laws that restart
    place: Place | None  # None: on the test stand
    rotors: Rotors | None  # None: on the test stand


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


class JudgeState(NamedTuple):
    """A tally, and the motion at the samples that are inside the IMU, oldest first."""

    pending: Motion
    tally: Tally


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Judge:
    """A law that tallies the samples of a flight."""

    schedule: Schedule
    delay: int  # samples that are inside the IMU

    def example(self) -> JudgeInputs:
        """Return the inputs at a first sample."""
        zeros, no, yes = np.zeros(3), np.zeros(3, np.bool_), np.True_
        states, place, rotors = np.zeros(3, np.uint8), None, None
        if self.schedule.rotors is not None:
            each = np.zeros(self.schedule.rotors.start.shape[1])
            rotors = Rotors(healthy_rotors(each), each.astype(np.uint8), each, each > 0.0)
            place = Place(zeros, zeros)
        motion = Motion(zeros, zeros, None if place is None else zeros)
        return JudgeInputs(
            *(motion, yes, yes, 0.0, OfSensors(zeros, zeros, zeros), zeros, zeros, states),
            *(OfSensors(states, states, states), (no, no), zeros, zeros, no, (~yes,) * 3, place, rotors),
        )

    def init(self, inputs: JudgeInputs) -> JudgeState:
        """Return the state before the first sample: what a sample adds that is not there."""
        none = self.schedule.start != self.schedule.start
        never = (
            None if self.schedule.rotors is None else self.schedule.rotors.start != self.schedule.rotors.start
        )
        already, named = none[0], none[:, 0]
        last = Last(
            torque=0.0 * inputs.torque,
            begun=inputs.left & False,
            declared=already[0],
            named=named,
            event_already=already,
            fault_already=none,
            rotors_named=None if never is None else never[0],
            rotor_already=never,
        )
        absent = inputs._replace(left=inputs.left & False, delivered=inputs.delivered & False)
        return JudgeState(fill_line(inputs.motion, self.delay, 0), self._tally(absent, inputs.motion, last))

    def step(self, state: JudgeState, inputs: JudgeInputs, dt: float) -> tuple[JudgeState, tuple[()]]:
        """Add a sample to the tally, if one leaves the IMU."""
        pending, motion = shift_line(state.pending, inputs.motion, 0)
        tally = branch(inputs.left, lambda: self._add(state.tally, inputs, motion), lambda: state.tally)
        return JudgeState(pending, tally), ()

    def _add(self, before: Tally, inputs: JudgeInputs, motion: Motion) -> Tally:
        xp, now = namespace(inputs.torque), self._tally(inputs, motion, before.last)
        return Tally(
            sums=merge(operator.add, before.sums, now.sums),
            ever=merge(xp.logical_or, before.ever, now.ever),
            largest=merge(xp.maximum, before.largest, now.largest),
            smallest=merge(xp.minimum, before.smallest, now.smallest),
            last=now.last,
        )

    def _tally(self, inputs: JudgeInputs, motion: Motion, last: Last) -> Tally:
        """Tally one sample, after those of which the last is given."""
        parts = (
            _tally_attitude(inputs, motion, self.schedule.of_attitude, last),
            _tally_sensors(inputs, motion, self.schedule, last),
            _tally_position(inputs, motion),
            _tally_rotors(inputs, motion, self.schedule, last),
        )
        sums, ever, largest, smallest, last_now = (
            {name: value for each in group for name, value in each.items()}
            for group in zip(*parts, strict=True)
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


def schedule_of(events: Sequence[FaultEvent], rotors: int = 0) -> Schedule:
    """Return the schedule of a flight with these faults; in free flight it has so many ``rotors``.

    There is room for one, two, four ... faults of an axis, so that most flights have one shape.
    """
    of_axes = {(part, name): [*_of(events, part, name)] for part in SENSORS for name in AXES}
    shape = len(SENSORS), _room(of_axes.values()), len(AXES)
    columns = [np.full(shape, value) for value in (np.inf, np.inf, np.inf, 0.0)]
    for (component, name), own in of_axes.items():
        for place, event in enumerate(own):
            following = min((one.start for one in own if one.start >= event.stop), default=np.inf)
            values = (event.start, event.stop, following, float(UNSEEN in event.kind))
            for column, value in zip(columns, values, strict=True):
                column[SENSORS.index(component), place, AXES.index(name)] = value
    return Schedule(*columns, rotors=_rotor_schedule(events, rotors) if rotors else None)


def _rotor_schedule(events: Sequence[FaultEvent], rotors: int) -> RotorSchedule:
    of_rotors = [[*_of(events, ROTOR, str(rotor + 1))] for rotor in range(rotors)]
    schedule = RotorSchedule(*(np.full((_room(of_rotors), rotors), np.inf) for _ in range(2)))
    for rotor, own in enumerate(of_rotors):
        for place, event in enumerate(own):
            schedule.start[place, rotor], schedule.stop[place, rotor] = event.start, event.stop
    return schedule


def _of(events: Sequence[FaultEvent], component: str, axis: str) -> Iterator[FaultEvent]:
    return (event for event in events if (event.component, event.axis) == (component, axis))


def _room(groups: Iterable[Sequence[FaultEvent]]) -> int:
    """Return a power of two that is at least the number of faults of each group."""
    return 1 << max(max(map(len, groups)) - 1, 0).bit_length()
