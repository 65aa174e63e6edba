"""When sensors and rotors of a flight are faulty, as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from quadftc_flight.diagnosis_metrics.which_sensor import UNSEEN
from quadftc_flight.fault_schedule import SENSORS, FaultEvent
from quadftc_model.arrays import Array
from quadftc_model.samples import AXES
from quadftc_sim.rotor_fault import ROTOR


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
