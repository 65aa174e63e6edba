"""Diagnosis of one vehicle's stream of IMU samples: cleaning, start, resumption, and the fault observer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.fault_observer import FaultObserver, LastDiagnosis, await_start
from quadftc_model import samples
from quadftc_model.arrays import Scalar, Vector, rows_of
from quadftc_model.fade import Fade
from quadftc_model.rotations import rotation_between, turn
from quadftc_model.samples import (
    ALARMS,
    FAULT_KINDS,
    NO_PLACE,
    ComponentFault,
    DiagnosisReport,
    FaultEstimate,
    FaultObserverInputs,
    ImuSample,
    PositionSample,
    RotorEstimate,
    RotorReading,
    SensorEstimate,
    sanitised,
)
from quadftc_model.stepper import NANOSECONDS_PER_SECOND, ResumingStepper, seconds

REPORT_PERIOD_NS = 100_000_000  # ns; the topic ``diagnosis`` comes at 10 Hz, and at once on a change
SEVEREST_FIRST = (samples.FAULTY, samples.RECOVERING, samples.SUSPECT, samples.STARTING, samples.HEALTHY)
BODY_AXES = ("x", "y", "z")
# of each component that an observer may watch: the names of its elements, and the unit of a fault
COMPONENTS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "attitude": (samples.AXES, "rad"),
    "gyro": (BODY_AXES, "rad/s"),
    "accelerometer": (BODY_AXES, "m/s^2"),
}
_AT_REST = np.zeros(3)
_UNKNOWN = np.full(3, -1.0)
_UNKNOWN_KIND = np.full(3, FAULT_KINDS.index("unknown"), np.uint8)
_CLEAR = np.zeros(3, np.bool_)
_SHOWN_IN = {"gyro": ("deg_s", math.degrees(1.0)), "rotor": ("percent", 100.0)}
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
        self._published: DiagnosisReport | None = None
        self._decided: tuple[object, ...] = ()  # what decides whether a report is due, at the last sample
        self._next: FaultObserver | None = None  # takes over with the next complete sample
        self._fade = Fade()  # of turn [rad] and body rate [rad/s], (6,)

    def compile_for(self, flies: bool) -> None:
        """Run the observer compiled for what it sees on the test stand, or in free flight.

        ValueError if it cannot be compiled.
        """
        inputs, vehicle = FaultObserverInputs(samples.level_sample(), np.zeros(3)), self.law.vehicle
        if flies:
            speeds = np.full(len(vehicle.rotors.positions), vehicle.hover_speed)
            rotors = RotorReading(speeds, speeds)
            inputs = inputs._replace(thrust=vehicle.weight, position=NO_PLACE, rotors=rotors)
        self.compile(inputs)

    def switch(self, law: FaultObserver) -> None:
        """Go on with changed parameters, or have another law take over from what is known, without a jump."""
        if type(law) is type(self.law):
            self.law, self._next = law, None
        else:
            self._next = law

    def diagnose(
        self,
        stamp_ns: int,
        sample: ImuSample,
        torque: Vector | None,
        thrust: Scalar | None = None,
        place: PositionSample | None = None,
        rotors: RotorReading | None = None,
    ) -> FaultEstimate | None:
        """Diagnose a sample [ns] as received; None if its stamp is repeated or went back.

        ``torque`` [N m] and ``thrust`` [N] are those that acted since the sample before; None: the torque is
        unknown. ``place`` is what the position sensor says with the sample, ``rotors`` what is known of the
        rotors. Without thrust, place and rotors, None: on the test stand.
        """
        clean = sanitised(sample)
        if thrust is not None and place is None:
            place = NO_PLACE
        driven = torque is not None
        inputs = FaultObserverInputs(clean, torque if driven else _AT_REST, thrust, place, rotors, driven)
        last, dt = self.words_for(stamp_ns), self.time_step(stamp_ns)
        complete = clean.attitude_valid and clean.rate_valid
        if self._next is not None and dt == 0.0:
            self.law, self._next = self._next, None
        if last is not None:
            last = last._replace(since=np.array([_age(stamp_ns, onset_ns) for onset_ns in last.onset_ns]))
            if not all(np.all(np.isfinite(part)) for part in last):
                self.drop_words()
            elif complete and dt is not None:
                return self.take_over(stamp_ns, inputs, self.law.resumed(inputs, last))
        if dt == 0.0 and not complete:
            self.reset()
            return await_start(clean, of_sensors=False)
        estimate = self._faded(stamp_ns, self.step(stamp_ns, inputs))
        if self._next is None or estimate is None or not complete:
            return estimate
        return self._hand_over(stamp_ns, inputs, estimate, self._next)

    def _hand_over(
        self, stamp_ns: int, inputs: FaultObserverInputs, before: FaultEstimate, law: FaultObserver
    ) -> FaultEstimate | None:
        """Start another law at a sample [ns] of which the present one has said ``before``.

        No fault is confirmed, so it starts at the attitude that is read. The gyro bias is handed over.
        """
        last, bias = before.corrected, None if self.state is None else self.law.bias_of(self.state)
        self.law, self._next = law, None
        correction = last.body_rate - inputs.imu.body_rate if bias is None else -bias
        known = LastDiagnosis(np.zeros(3), _UNKNOWN, _CLEAR, correction)
        begun = samples.STARTING not in before.state.tolist() and correction.any()
        state = law.resumed(inputs, known) if begun else law.init(inputs)
        estimate = self.resume(stamp_ns, inputs, state)
        turn = rotation_between(estimate.corrected.q_xyzw, last.q_xyzw)
        self._fade.begin(stamp_ns, np.concatenate([turn, last.body_rate - estimate.corrected.body_rate]))
        return self._faded(stamp_ns, estimate)

    def _faded(self, stamp_ns: int, estimate: FaultEstimate | None) -> FaultEstimate | None:
        """Add to a corrected sample what is left of the difference between two laws."""
        left = self._fade.at(stamp_ns)
        if estimate is None or left is None:
            return estimate
        corrected = estimate.corrected
        q_xyzw, body_rate = turn(corrected.q_xyzw, left[:3]), corrected.body_rate + left[3:]
        return estimate._replace(corrected=corrected._replace(q_xyzw=q_xyzw, body_rate=body_rate))

    def gyro_bias(self, sample: ImuSample, estimate: FaultEstimate) -> Vector | None:
        """Return what the body rate of a sample is off by [rad/s] (3,): its bias, and all of a gyro fault.

        A new bias leaves the corrected rate little by little, so it cannot be seen there at first. None where
        the sample has no body rate.
        """
        if not sanitised(sample).rate_valid:
            return None
        taken_off = sample.body_rate - estimate.corrected.body_rate
        bias = None if self.state is None else self.law.bias_of(self.state)
        if bias is None or estimate.sensors is None:
            return taken_off if bias is None else bias
        return np.where(np.isin(estimate.sensors.gyro.state, ALARMS), taken_off, bias)

    def report(self, stamp_ns: int, estimate: FaultEstimate) -> DiagnosisReport | None:
        """Return the report on a sample [ns]; None if none is due. Call it with every estimate."""
        decided = (self.law.has_detector, *_all_that_decides(stamp_ns, estimate))
        if decided == self._decided:  # mostly; to say it in words takes several times as long
            return None
        self._decided = decided
        report = report_faults(stamp_ns, watched_sensors(self.law, estimate))
        if not is_due(report, self._published):
            return None
        self._published = report
        return report


def report_faults(stamp_ns: int, sensors: Mapping[str, SensorEstimate]) -> DiagnosisReport:
    """Return the confirmed faults of the components of one vehicle at a sample [ns].

    A component is watched once the observer has converged on all its elements.
    """
    watched = [name for name, sensor in sensors.items() if samples.STARTING not in sensor.state.tolist()]
    found = [fault for name, sensor in sensors.items() for fault in _confirmed(stamp_ns, name, sensor)]
    return DiagnosisReport(stamp_ns, tuple(watched), tuple(found))


def is_due(report: DiagnosisReport, last: DiagnosisReport | None) -> bool:
    """Return whether a report is to be published, ``last`` being the one published before.

    It is where a component, state, kind or ambiguity has changed, and with the first sample of every
    `REPORT_PERIOD_NS` of the clock of the stamps.
    """
    if last is None or report.stamp_ns < last.stamp_ns:
        return True
    if report.stamp_ns // REPORT_PERIOD_NS != last.stamp_ns // REPORT_PERIOD_NS:
        return True
    return report.watched != last.watched or _verdicts(report) != _verdicts(last)


def report_flight(
    law: FaultObserver, stamp_ns: NDArray[np.int64], estimates: FaultEstimate
) -> list[DiagnosisReport]:
    """Return the reports that are due on the estimates of a flight, one for each sample [ns] (n,)."""
    sensors = watched_sensors(law, estimates).items()
    codes = [np.zeros((len(stamp_ns), 1), np.int64), *(_verdict_codes(*each) for each in sensors)]
    verdicts = np.concatenate(codes, axis=1)
    due = np.diff(stamp_ns // REPORT_PERIOD_NS, prepend=-1) != 0
    due[1:] |= np.any(verdicts[1:] != verdicts[:-1], axis=1)
    rows = np.flatnonzero(due).tolist()
    said = [watched_sensors(law, rows_of(estimates, row)) for row in rows]
    return [report_faults(int(stamp_ns[row]), each) for row, each in zip(rows, said, strict=True)]


def watched_sensors(law: FaultObserver, estimate: FaultEstimate) -> dict[str, SensorEstimate]:
    """Return what the estimate of an observer says of each component that it diagnoses."""
    if not law.has_detector:
        return {}
    rotors = {} if estimate.rotors is None else {"rotor": _as_sensor(estimate.rotors)}
    if estimate.sensors is not None:
        return {**estimate.sensors._asdict(), **rotors}
    state, fault, std_dev, age = estimate.state, estimate.fault, estimate.std_dev, estimate.onset_age
    attitude = SensorEstimate(state, fault, std_dev, age, _UNKNOWN, _UNKNOWN_KIND, _CLEAR)
    return {"attitude": attitude, **rotors}


def _as_sensor(rotors: RotorEstimate) -> SensorEstimate:
    """Return what is said of the rotors as of a sensor; the size is the share of thrust that is lost."""
    return SensorEstimate(rotors.state, 1.0 - rotors.effectiveness, *rotors[2:])


def elements_of(component: str, count: int) -> tuple[tuple[str, ...], str]:
    """Return the names of the ``count`` elements of a component, and the unit of a fault."""
    if component == "rotor":
        return tuple(str(number + 1) for number in range(count)), "1"
    return COMPONENTS[component]


def onset_ns(stamp_ns: int, age: float) -> int:
    """Return the stamp [ns] of an onset by its age [s] at a sample [ns]; 0: there is none."""
    return stamp_ns - round(age * NANOSECONDS_PER_SECOND) if age >= 0.0 else 0


def _confirmed(stamp_ns: int, component: str, sensor: SensorEstimate) -> Iterator[ComponentFault]:
    if not any(state in ALARMS for state in sensor.state.tolist()):
        return
    elements, unit = elements_of(component, len(sensor.state))
    rows: Any = zip(*(column.tolist() for column in sensor), strict=True)
    for axis, (state, size, std_dev, age, probability, kind, ambiguous) in enumerate(rows):
        if state not in ALARMS:
            continue
        other = _CONFUSED_WITH.get(component)
        rivals = (f"{other}/{elements_of(other, 0)[0][axis]}",) if ambiguous and other else ()
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


def _all_that_decides(stamp_ns: int, estimate: FaultEstimate) -> tuple[int, bytes]:
    """Return what a report can only become due by: the period, and all states, kinds and doubts."""
    sensors, rotors = estimate.sensors or (), estimate.rotors
    columns = [estimate.state]
    for part in sensors if rotors is None else (*sensors, rotors):
        columns += part.state, part.kind, part.ambiguous
    return stamp_ns // REPORT_PERIOD_NS, b"".join([column.tobytes() for column in columns])


def _verdicts(report: DiagnosisReport) -> list[tuple[object, ...]]:
    return [
        (each.component, each.element, each.kind, each.state, each.ambiguous_with) for each in report.faults
    ]


def _verdict_codes(component: str, sensor: SensorEstimate) -> NDArray[np.int64]:
    """Return a number (n, 3) for all that a report says of each element besides sizes and times."""
    state, kind = np.int64(sensor.state), np.int64(sensor.kind)
    kind = np.where(kind == 0, FAULT_KINDS.index("unknown"), kind)
    code = 256 * state + 2 * kind + (sensor.ambiguous & (component in _CONFUSED_WITH))
    return np.where(np.isin(state, ALARMS), code, state == samples.STARTING)


def describe_axes(
    estimate: FaultEstimate, more: Mapping[str, Vector] | None = None
) -> Iterator[tuple[str, int, dict[str, str]]]:
    """Return name, fault state and values for people of each axis of an estimate.

    ``more`` is what the observer says of itself besides, by name.
    """
    columns = (each.tolist() for each in estimate[:4])
    named = _confirmed(0, "attitude", estimate.sensors.attitude) if estimate.sensors else ()
    doubts = {fault.element: _describe_doubts(fault) for fault in named}
    for row, (axis, size, std_dev, state, age) in enumerate(zip(samples.AXES, *columns, strict=True)):
        values = {"size_deg": f"{round(math.degrees(size), 3) + 0.0:.3f}"}  # no -0.000
        if std_dev >= 0.0:
            values["sigma_deg"] = f"{math.degrees(std_dev):.3f}"
        if age >= 0.0:
            values["age_s"] = f"{age:.2f}"
        values |= {name: f"{float(each[row]):.3g}" for name, each in (more or {}).items()}
        values |= doubts.get(axis, {})
        yield axis, state, values


def describe_component(component: str, sensor: SensorEstimate) -> tuple[int, dict[str, str]]:
    """Return the fault state of a component that is worst, and for people the values of its faulty elements.

    Those of the gyro are in deg/s, those of the rotors in percent of thrust.
    """
    elements, _ = elements_of(component, len(sensor.state))
    name, scale = _SHOWN_IN.get(component, ("m_s2", 1.0))
    values: dict[str, str] = {}
    for fault in _confirmed(0, component, sensor):
        element, age = fault.element, sensor.onset_age[elements.index(fault.element)]
        values[element] = f"{samples.FAULT_STATE_NAMES[fault.state]}, {fault.kind}"
        values[f"{element}_size_{name}"] = f"{scale * fault.size:.3f}"
        if fault.std_dev >= 0.0:
            values[f"{element}_sigma_{name}"] = f"{scale * fault.std_dev:.3f}"
        if age >= 0.0:
            values[f"{element}_age_s"] = f"{age:.2f}"
        values |= {f"{element}_{key}": text for key, text in _describe_doubts(fault).items()}
    states = sensor.state.tolist()
    return next(state for state in SEVEREST_FIRST if state in states), values


def _describe_doubts(fault: ComponentFault) -> dict[str, str]:
    doubts = {"probability": f"{fault.probability:.2f}"} if fault.probability >= 0.0 else {}
    return doubts | ({"or": ", ".join(fault.ambiguous_with)} if fault.ambiguous_with else {})


def _age(stamp_ns: int, onset_ns: int) -> float:
    return seconds(max(0, stamp_ns - onset_ns)) if onset_ns else 0.0


def _usable_estimate(inputs: FaultObserverInputs, estimate: FaultEstimate) -> FaultEstimate:
    fault, corrected = estimate.fault, estimate.corrected
    usable = samples.is_usable(fault, corrected.q_xyzw, corrected.body_rate)
    for sensor in estimate.sensors or ():
        usable = usable and samples.is_usable(*sensor[1:5])
    if estimate.rotors is not None:
        usable = usable and samples.is_usable(*estimate.rotors[1:5])
    return estimate if usable else await_start(inputs.imu, of_sensors=False)
