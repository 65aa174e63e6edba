"""Which rotor a diagnosis names, held against which is faulty; ``summary["metrics"]["rotors"]``.

A rotor is *named* when the diagnosis declares it faulty (FAULTY, RECOVERING) and not ambiguous. It is
*misnamed* time in which a healthy rotor or a healthy sensor is named. The confusion matrix holds the kinds of
components against each other: nothing, a sensor or a rotor is faulty. See docs/rotors.md, section 4.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadftc_flight.diagnosis_metrics.columns import Metrics, Record, largest, mean, median
from quadftc_flight.diagnosis_metrics.which_sensor import GRACE_TIME, JudgedSensors, summed_up
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import Flight
from quadftc_model.arrays import Array, namespace
from quadftc_model.samples import FAULTY, RECOVERING

SIZE_TIME = 1.0  # s; after the onset, from when on the estimated effectiveness is judged
UNSIZED = ("stuck", "saturated")  # kinds of faults that leave the thrust at a given speed as it is
TRUE = ("none", "sensor", "rotor")  # rows of the confusion matrix: what alone is faulty
SAID = ("faulty_rotor", "healthy_rotor", "sensor", "none", "time")  # its columns: what is named


def name_rotors(state: Array, ambiguous: Array) -> Array:
    """Return which rotors are named (..., n) by their fault states and what is ambiguous (..., n)."""
    return ((state == FAULTY) | (state == RECOVERING)) & ~ambiguous


def rotor_confusion(faulty: Array, named: Array, sensor_faulty: Array, sensor_named: Array) -> Array:
    """Return to which entries of the confusion matrix a sample belongs: (..., true, said) of bool.

    ``faulty`` and ``named`` are of the rotors (..., n), the others of any sensor (...). A sample in which
    both a sensor and a rotor are faulty does not count.
    """
    xp = namespace(faulty)
    weak = faulty.any(axis=-1)
    right, wrong = (named & faulty).any(axis=-1), (named & ~faulty).any(axis=-1)
    nothing = ~(right | wrong | sensor_named)
    true = xp.stack((~(weak | sensor_faulty), sensor_faulty & ~weak, weak & ~sensor_faulty), axis=-1)
    said = xp.stack((right, wrong, sensor_named, nothing, xp.ones_like(nothing)), axis=-1)
    return true[..., :, None] & said[..., None, :]


def is_sized(event: FaultEvent) -> bool:
    """Return whether a fault changes the effectiveness of the rotor."""
    return not {*event.kind.split("+")} & {*UNSIZED}


def rotor_metrics(flight: Flight, events: Sequence[FaultEvent], of_sensors: JudgedSensors) -> Metrics:
    """Judge which rotor is named, ready for JSON; of one rotor, no event overlaps another."""
    judged = _JudgedRotors(flight, events, of_sensors)
    records = [judged.record(event) for event in events]
    sizes = [each["size_error_mean"] for each in records if each["size_error_mean"] is not None]
    wrong = judged.named & judged.healthy
    before = np.concatenate([np.zeros_like(wrong[:1]), judged.named[:-1]])
    sensors = (of_sensors.faulty.any(axis=(1, 2)), of_sensors.naming.named.any(axis=(1, 2)))
    samples = rotor_confusion(judged.faulty, judged.named, *sensors)
    counted = (judged.faulty | judged.healthy).all(axis=1) & (of_sensors.faulty | of_sensors.healthy).all(
        axis=(1, 2)
    )
    seconds = samples[counted].sum(axis=0)
    return {
        **summed_up(records, "rotor_faults"),
        "size_error_median": median(sizes),
        "size_error_max": largest(sizes),
        "false_namings": int((wrong & ~before).sum()),
        "false_naming_time_s": of_sensors.seconds(wrong.sum()),
        "healthy_time_s": of_sensors.seconds(judged.healthy.sum()),
        "confusion_s": {
            true: {said: of_sensors.seconds(seconds[row, column]) for column, said in enumerate(SAID)}
            for row, true in enumerate(TRUE)
        },
        "events": records,
    }


class _JudgedRotors:
    """The samples of a flight of which a state is known: which rotors are named, and which are faulty."""

    def __init__(self, flight: Flight, events: Sequence[FaultEvent], of_sensors: JudgedSensors) -> None:
        known = of_sensors.known
        self._sensors = of_sensors
        self.named = name_rotors(flight.rotor_state, flight.rotor_ambiguous)[known]
        # what is not diagnosed is taken for healthy
        estimate = np.where(np.isfinite(flight.rotor_estimate), flight.rotor_estimate, 1.0)
        self._size_error = np.abs(estimate - flight.rotor_effectiveness)[known]
        self._distance = np.linalg.norm(flight.position - flight.position_reference, axis=1)[known]
        self.faulty = np.zeros(self.named.shape, np.bool_)
        doubtful = self.faulty.copy()
        for event in events:
            rotor = int(event.axis) - 1
            self.faulty[of_sensors.rows(event.start, event.stop), rotor] = True
            doubtful[of_sensors.rows(event.stop, event.stop + GRACE_TIME), rotor] = True
        self.healthy = ~self.faulty & ~doubtful

    def record(self, event: FaultEvent) -> Record:
        """Judge one fault."""
        rotor, of_sensors = int(event.axis) - 1, self._sensors
        rows = of_sensors.rows(event.start, event.stop)
        settled = of_sensors.rows(event.start + SIZE_TIME, event.stop)
        wrong = (self.named & self.healthy).any(axis=1) | (of_sensors.naming.named & of_sensors.healthy).any(
            axis=(1, 2)
        )
        error = self._size_error[settled if is_sized(event) else slice(0), rotor]
        return {
            **of_sensors.naming_of(event, self.named[:, rotor]),
            "misnamed_share": mean(wrong[rows]),
            "size_error_mean": mean(error),
            "size_error_max": largest(error),
            "position_error_max_m": largest(self._distance[rows]),
        }
