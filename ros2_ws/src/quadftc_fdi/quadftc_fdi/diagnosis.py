"""Diagnosis of one vehicle's stream of IMU samples: cleaning, start, resumption, and the fault observer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from quadftc_fdi.fault_observer import FaultObserver, LastDiagnosis
from quadftc_model import samples
from quadftc_model.arrays import Vector
from quadftc_model.samples import (
    ALARMS,
    FAULT_KINDS,
    FaultEstimate,
    FaultObserverInputs,
    ImuSample,
    SensorEstimate,
    sanitised,
)
from quadftc_model.stepper import NANOSECONDS_PER_SECOND, ResumingStepper, seconds

REPORT_PERIOD_NS = 100_000_000  # ns; the topic ``diagnosis`` comes at 10 Hz, and at once on a change
BODY_AXES = ("x", "y", "z")
# of each component that an observer may watch: the names of its elements, and the unit of a fault
COMPONENTS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "attitude": (samples.AXES, "rad"),
    "gyro": (BODY_AXES, "rad/s"),
    "accelerometer": (BODY_AXES, "m/s^2"),
}
_CONFUSED_WITH = {"attitude": "gyro", "gyro": "attitude"}  # on the same axis


class Diagnosis(ResumingStepper[FaultObserverInputs, FaultEstimate, LastDiagnosis]):
    """A fault observer on a stream.

    It starts at the first sample with attitude and rate, also after a gap and an estimate that cannot be
    used. Every later sample with a new stamp gives an estimate and a corrected sample, whatever is wrong with
    it.
    """

    law: FaultObserver

    def __init__(self, law: FaultObserver) -> None:
        super().__init__(law, _usable_estimate)

    def diagnose(self, stamp_ns: int, sample: ImuSample, torque: Vector) -> FaultEstimate | None:
        """Diagnose a sample [ns] as received; None if its stamp is repeated or went back.

        ``torque`` [N m] is the one that acted since the sample before.
        """
        clean = sanitised(sample)
        inputs = FaultObserverInputs(clean, torque)
        last, dt = self.words_for(stamp_ns), self.time_step(stamp_ns)
        complete = clean.attitude_valid and clean.rate_valid
        if last is not None:
            last = last._replace(since=np.array([_age(stamp_ns, onset_ns) for onset_ns in last.onset_ns]))
            if not all(np.all(np.isfinite(part)) for part in last):
                self.drop_words()
            elif complete and dt is not None:
                return self.take_over(stamp_ns, inputs, self.law.resumed(inputs, last))
        if dt == 0.0 and not complete:
            self.reset()
            return _starting_estimate(clean)
        return self.step(stamp_ns, inputs)


class ComponentFault(NamedTuple):
    """A fault that is confirmed and not known to be gone, as quadftc_msgs/ComponentFault says it."""

    component: str  # of `COMPONENTS`
    element: str  # of the component
    kind: str  # of `FAULT_KINDS`
    state: int  # FAULTY or RECOVERING
    size: float  # reading minus truth, in ``unit``
    std_dev: float  # of the size; -1: the observer gives none
    unit: str
    probability: float  # that the element is faulty now [1]; -1: the observer gives none
    ambiguous_with: tuple[str, ...]  # "component/element" that may be the faulty one instead
    onset_ns: int  # stamp of the onset [ns]


class Report(NamedTuple):
    """What is said of all components at a sample, as quadftc_msgs/Diagnosis says it."""

    stamp_ns: int  # of the sample [ns]
    watched: tuple[str, ...]  # components that the observer diagnoses; healthy where there is no fault
    faults: tuple[ComponentFault, ...]


def report_faults(stamp_ns: int, estimate: FaultEstimate) -> Report:
    """Say the confirmed faults of an estimate of one vehicle, of a sample [ns]."""
    sensors = watched_sensors(estimate)
    found = [fault for name, each in sensors.items() for fault in _confirmed(stamp_ns, name, each)]
    return Report(stamp_ns, tuple(sensors), tuple(found))


def is_due(report: Report, last: Report | None) -> bool:
    """Return whether a report is to be published, ``last`` being the one published before.

    It is where a component, state, kind or ambiguity has changed, and with the first sample of every
    `REPORT_PERIOD_NS` of the clock of the stamps.
    """
    if last is None or report.stamp_ns < last.stamp_ns:
        return True
    if report.stamp_ns // REPORT_PERIOD_NS != last.stamp_ns // REPORT_PERIOD_NS:
        return True
    return report.watched != last.watched or _verdicts(report) != _verdicts(last)


def watched_sensors(estimate: FaultEstimate) -> dict[str, SensorEstimate]:
    """Return what an estimate says of each component that its observer diagnoses."""
    if estimate.sensors is not None:
        return estimate.sensors._asdict()
    unknown = np.full_like(estimate.fault, -1.0)
    kind = np.full_like(estimate.state, FAULT_KINDS.index("unknown"))
    clear = np.zeros(estimate.fault.shape, np.bool_)
    state, fault, std_dev, age = estimate.state, estimate.fault, estimate.std_dev, estimate.onset_age
    return {"attitude": SensorEstimate(state, fault, std_dev, age, unknown, kind, clear)}


def onset_ns(stamp_ns: int, age: float) -> int:
    """Return the stamp [ns] of an onset by its age [s] at a sample [ns]; 0: there is none."""
    return stamp_ns - round(age * NANOSECONDS_PER_SECOND) if age >= 0.0 else 0


def _confirmed(stamp_ns: int, component: str, sensor: SensorEstimate) -> Iterator[ComponentFault]:
    if not any(state in ALARMS for state in sensor.state.tolist()):
        return
    elements, unit = COMPONENTS[component]
    columns: list[list[Any]] = [column.tolist() for column in sensor]
    for axis, (state, size, std_dev, age, probability, kind, ambiguous) in enumerate(
        zip(*columns, strict=True)
    ):
        if state not in ALARMS:
            continue
        other = _CONFUSED_WITH.get(component)
        rivals = (f"{other}/{COMPONENTS[other][0][axis]}",) if ambiguous and other else ()
        yield ComponentFault(
            component=component,
            element=elements[axis],
            kind=FAULT_KINDS[kind] or "unknown",
            state=state,
            size=size,
            std_dev=std_dev,
            unit=unit,
            probability=probability,
            ambiguous_with=rivals,
            onset_ns=onset_ns(stamp_ns, age),
        )


def _verdicts(report: Report) -> list[tuple[object, ...]]:
    return [
        (each.component, each.element, each.kind, each.state, each.ambiguous_with) for each in report.faults
    ]


def describe_axes(
    estimate: FaultEstimate, more: Mapping[str, Vector] | None = None
) -> Iterator[tuple[str, int, dict[str, str]]]:
    """Return name, fault state and values for people of each axis of an estimate.

    ``more`` is what the observer says of itself besides, by name.
    """
    columns = (each.tolist() for each in estimate[:4])
    for row, (axis, size, std_dev, state, age) in enumerate(zip(samples.AXES, *columns, strict=True)):
        values = {"size_deg": f"{round(math.degrees(size), 3) + 0.0:.3f}"}  # no -0.000
        if std_dev >= 0.0:
            values["sigma_deg"] = f"{math.degrees(std_dev):.3f}"
        if age >= 0.0:
            values["age_s"] = f"{age:.2f}"
        values |= {name: f"{float(each[row]):.3g}" for name, each in (more or {}).items()}
        yield axis, state, values


def _age(stamp_ns: int, onset_ns: int) -> float:
    return seconds(max(0, stamp_ns - onset_ns)) if onset_ns else 0.0


def _usable_estimate(inputs: FaultObserverInputs, estimate: FaultEstimate) -> FaultEstimate:
    fault, corrected = estimate.fault, estimate.corrected
    usable = samples.is_usable(fault, corrected.q_xyzw, corrected.body_rate)
    for sensor in estimate.sensors or ():
        usable = usable and samples.is_usable(*sensor[1:5])
    return estimate if usable else _starting_estimate(inputs.imu)


def _starting_estimate(clean: ImuSample) -> FaultEstimate:
    """Return the estimate before the observer has started: no fault is known, the sample passes."""
    unknown = np.full(3, -1.0)
    return FaultEstimate(np.zeros(3), unknown, np.full(3, samples.STARTING, np.uint8), unknown, clean)
