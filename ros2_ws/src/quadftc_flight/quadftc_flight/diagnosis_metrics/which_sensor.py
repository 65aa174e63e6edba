"""Which sensor a diagnosis names, held against which is faulty; ``summary["metrics"]["sensors"]``.

A sensor is attitude, gyro or accelerometer, and is judged axis by axis (roll and x are one axis). On an axis
a sensor is *named* when the diagnosis declares it faulty (FAULTY, RECOVERING) and not ambiguous; the axis is
*ambiguous* when a sensor of it is declared faulty, and none is named. *Nothing* is said when no
sensor of the axis is declared. Every metric: docs/diagnosis.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from quadftc_flight.diagnosis_metrics.columns import (
    Columns,
    Floats,
    Mask,
    Metrics,
    Record,
    largest,
    mean,
    median,
    number,
)
from quadftc_flight.fault_schedule import SENSORS, FaultEvent
from quadftc_flight.flight import NO_STATE, Flight
from quadftc_model.arrays import Array, namespace
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES, FAULTY, RECOVERING

GRACE_TIME = 5.0  # s; after the end of a fault, to find out that it is over: neither healthy nor faulty
NOTHING, AMBIGUOUS, TIME = "none", "ambiguous", "time"
TRUE = (NOTHING, *SENSORS)  # rows of the confusion matrix: the one sensor of the axis that is faulty
SAID = (*SENSORS, AMBIGUOUS, NOTHING, TIME)  # its columns: what is said; the time of the row
UNSEEN = "dropout"  # the kind of fault of which the true size is zero

T = TypeVar("T")


class Naming(NamedTuple):
    """What is said in each sample."""

    named: Array  # by sensor and axis (..., 3, 3): declared, and not ambiguous
    ambiguous: Array  # by axis (..., 3)


def name_sensors(states: Sequence[Array], ambiguous: Sequence[Array]) -> Naming:
    """Return what fault states (..., 3) of the sensors say, each with its mask of what is ambiguous."""
    xp = namespace(states[0])
    declared = [(state == FAULTY) | (state == RECOVERING) for state in states]
    clear = [each & ~doubt for each, doubt in zip(declared, ambiguous, strict=True)]
    anything, certain = declared[0] | declared[1] | declared[2], clear[0] | clear[1] | clear[2]
    return Naming(xp.stack(clear, axis=-2), anything & ~certain)


def confusion(faulty: Array, healthy: Array, naming: Naming) -> Array:
    """Return to which entries of the confusion matrix a sample belongs: (..., true, said, axis) of bool.

    ``faulty`` and ``healthy`` say it of each sensor and axis (..., 3, 3). A sample in which one is neither
    does not count, nor does an axis of which two sensors are faulty. Two may be named.
    """
    xp = namespace(faulty)
    first, second, third = (faulty[..., place, :] for place in range(len(SENSORS)))
    alone = (first & ~second & ~third, second & ~first & ~third, third & ~first & ~second)
    true = xp.stack((~(first | second | third), *alone), axis=-2)
    something: Array = naming.named.any(axis=-2) | naming.ambiguous
    columns = [naming.named[..., place, :] for place in range(len(SENSORS))]
    said = xp.stack((*columns, naming.ambiguous, ~something, xp.ones_like(something)), axis=-2)
    counted: Array = xp.all(faulty | healthy, axis=(-2, -1))
    return counted[..., None, None, None] & true[..., :, None, :] & said[..., None, :, :]


def sensor_metrics(
    flight: Flight, events: Sequence[FaultEvent], judged: JudgedSensors | None = None
) -> Metrics:
    """Judge which sensor is named, ready for JSON; of one axis of a sensor, no event overlaps another."""
    judged = judged or JudgedSensors(flight, events)
    records = [judged.record(event) for event in events]
    wrong = judged.naming.named & judged.healthy
    named_before = np.concatenate([np.zeros_like(wrong[:1]), judged.naming.named[:-1]])
    samples = confusion(judged.faulty, judged.healthy, judged.naming).sum(axis=0)
    return {
        **_naming_metrics(records),
        "false_namings": _by_sensor((wrong & ~named_before).sum(axis=(0, 2)).tolist()),
        "false_naming_time_s": _by_sensor(map(judged.seconds, wrong.sum(axis=(0, 2)))),
        "healthy_time_s": _by_sensor(map(judged.seconds, judged.healthy.sum(axis=(0, 2)))),
        "confusion_s": {
            true: {
                said: dict(zip(AXES, map(judged.seconds, samples[row, column]), strict=True))
                for column, said in enumerate(SAID)
            }
            for row, true in enumerate(TRUE)
        },
        "events": records,
    }


def _naming_metrics(records: Sequence[Record]) -> dict[str, dict[str, float | None]]:
    """Sum up the records of faults, of all sensors and of each."""
    groups = {"all": records} | {
        name: [each for each in records if each["component"] == name] for name in SENSORS
    }
    found = {name: summed_up(members, "sensor_faults") for name, members in groups.items()}
    return {key: {name: figures[key] for name, figures in found.items()} for key in found["all"]}


def summed_up(records: Sequence[Record], count: str) -> dict[str, float | None]:
    """Sum up the records of faults, their number as ``count``; those that change no reading do not count."""
    judged = [record for record in records if record["named"] is not None]
    delays = [record["naming_delay_s"] for record in judged if record["naming_delay_s"] is not None]
    return {
        count: len(judged),
        "unnamed": sum(not record["named"] for record in judged),
        "misnamed": sum(float(record["misnamed_share"] or 0.0) > 0.0 for record in judged),
        "naming_delay_median_s": median(delays),
        "naming_delay_max_s": largest(delays),
    }


def summed_confusion(sensors: Metrics) -> dict[str, float]:
    """Return the confusion matrix of a flight over all axes [s], by ``sensors.confusion_s.<true>.<said>``."""
    return {
        f"sensors.confusion_s.{true}.{said}": sum(time or 0.0 for time in axes.values())
        for true, row in sensors["confusion_s"].items()
        for said, axes in row.items()
    }


class JudgedSensors:
    """The samples of a flight of which a state is known: what is said, and which sensors are faulty."""

    def __init__(self, flight: Flight, events: Sequence[FaultEvent]) -> None:
        self.known: Mask = (flight.fault_state != NO_STATE).all(axis=1)  # rows of the flight that count
        known = self.known
        # what says nothing of sensors tells of the attitude alone, and not whether it is absent
        of_attitude = np.where(flight.attitude_state == NO_STATE, flight.fault_state, flight.attitude_state)
        states = (of_attitude, flight.gyro_state, flight.accelerometer_state)
        ambiguous = (flight.attitude_ambiguous, flight.gyro_ambiguous, np.zeros_like(flight.gyro_ambiguous))
        self._time, self._period = flight.time[known], Columns(flight).period
        self.naming = name_sensors([each[known] for each in states], [each[known] for each in ambiguous])
        self._truth = [each[known] for each in (flight.fault, flight.gyro_fault, flight.accelerometer_fault)]
        self._error = attitude_error(flight)[known]
        self.faulty = np.zeros(self.naming.named.shape, np.bool_)
        doubtful = self.faulty.copy()
        for event in events:
            sensor, axis = SENSORS.index(event.component), AXES.index(event.axis)
            self.faulty[self.rows(event.start, event.stop), sensor, axis] = True
            doubtful[self.rows(event.stop, event.stop + GRACE_TIME), sensor, axis] = True
        self.healthy: Mask = ~self.faulty & ~doubtful

    def seconds(self, rows: int | np.int_) -> float | None:
        """Return the time of so many rows [s]."""
        return number(rows * self._period)

    def record(self, event: FaultEvent) -> Record:
        """Judge one fault; ``named`` is None where it leaves the reading as it is."""
        sensor, axis = SENSORS.index(event.component), AXES.index(event.axis)
        rows = self.rows(event.start, event.stop)
        named, ambiguous = self.naming.named[:, sensor, axis], self.naming.ambiguous[:, axis]
        anything = self.naming.named[:, :, axis].any(axis=1) | ambiguous
        wrong = (self.naming.named & self.healthy)[rows, :, axis].any(axis=1)
        changes = UNSEEN in event.kind or bool(np.any(self._truth[sensor][rows, axis] != 0.0))  # NaN, too
        is_judged = changes and rows.stop > rows.start
        return {
            **self.naming_of(event, named, is_judged),
            "alarm_delay_s": self._delay(np.asarray(anything), rows, event.start) if is_judged else None,
            "ambiguous_share": mean(ambiguous[rows]),
            "misnamed_share": mean(wrong),
            "attitude_error_max_deg": largest(self._error[rows]),
        }

    def naming_of(self, event: FaultEvent, named: Mask, is_judged: bool = True) -> Record:
        """Judge when a faulty element is named (n,)."""
        rows = self.rows(event.start, event.stop)
        is_judged, already = is_judged and rows.stop > rows.start, bool(named[: rows.start][-1:].any())
        return {
            **event._asdict(),
            "named": bool(named[rows].any()) if is_judged else None,
            "already_named": already if is_judged else None,
            "naming_delay_s": self._delay(named, rows, event.start) if is_judged and not already else None,
            "named_share": mean(named[rows]),
        }

    def rows(self, start: float, stop: float) -> slice:
        """Return the rows with start <= time < stop."""
        first, last = np.searchsorted(self._time, (start, stop), side="left").tolist()
        return slice(first, max(first, last))

    def _delay(self, says: Mask, rows: slice, start: float) -> float | None:
        """Return when it is first said in some rows, since a start [s]; None: never."""
        hits = np.flatnonzero(says[rows])
        return number(float(self._time[rows.start + hits[0]]) - start) if len(hits) else None


def attitude_error(flight: Flight) -> Floats:
    """Return the size of the true attitude error, angles less reference, over all axes [deg] (n,)."""
    return np.degrees(np.sqrt(np.sum(wrap(flight.angles - flight.reference) ** 2, axis=1)))


def _by_sensor(values: Iterable[T]) -> dict[str, T]:
    return dict(zip(SENSORS, values, strict=True))
