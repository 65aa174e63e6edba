"""Diagnosis of one vehicle's stream of IMU samples: cleaning, start, resumption, and the fault observer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.fault_observer import FaultObserver, LastDiagnosis
from quadftc_fdi.observation import Observation, ObservationInputs
from quadftc_model import samples
from quadftc_model.arrays import Vector, rows_of
from quadftc_model.fade import Fade
from quadftc_model.guarded import ResumingStepper
from quadftc_model.rotations import rotation_between, turn
from quadftc_model.samples import (
    ALARMS,
    FAULT_KINDS,
    NO_PLACE,
    ComponentFault,
    DiagnosisReport,
    FaultEstimate,
    ImuSample,
    PositionSample,
    RotorEstimate,
    RotorReading,
    SensorEstimate,
    has_attitude,
    has_rate,
)
from quadftc_model.stepper import NANOSECONDS_PER_SECOND, Engine, NumpyRunner, seconds

REPORT_PERIOD_NS = 100_000_000  # ns; the topic ``diagnosis`` comes at 10 Hz, and at once on a change
SEVEREST_FIRST = (samples.FAULTY, samples.RECOVERING, samples.SUSPECT, samples.STARTING, samples.HEALTHY)
BODY_AXES = ("x", "y", "z")
# of each component that an observer may watch: the names of its elements, and the unit of a fault
COMPONENTS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "attitude": (samples.AXES, "rad"),
    "gyro": (BODY_AXES, "rad/s"),
    "accelerometer": (BODY_AXES, "m/s^2"),
}
_NO_TORQUE = np.zeros(3)
_UNKNOWN = np.full(3, -1.0)
_UNKNOWN_KIND = np.full(3, FAULT_KINDS.index("unknown"), np.uint8)
_CLEAR = np.zeros(3, np.bool_)
_SHOWN_IN = {"gyro": ("deg_s", math.degrees(1.0)), "rotor": ("percent", 100.0)}
_CONFUSED_WITH = {"attitude": "gyro", "gyro": "attitude"}  # on the same axis


class Diagnosis(ResumingStepper[ObservationInputs, FaultEstimate, LastDiagnosis]):
    """A fault observer on a stream.

    It starts at the first sample with attitude and rate, also after a gap and an estimate that cannot be
    used. Every later sample with a new stamp gives an estimate and a corrected sample, whatever is wrong with
    it. ``engine`` runs the observer; ``flies`` says whether it is in free flight.
    """

    def __init__(self, observer: FaultObserver, engine: Engine = NumpyRunner, flies: bool = False) -> None:
        super().__init__(Observation(observer, flies), engine)
        self._flies = flies
        self._published: DiagnosisReport | None = None
        self._decided: tuple[object, ...] = ()  # what decides whether a report is due, at the last sample
        self._next: FaultObserver | None = None  # takes over with the next complete sample
        self._fade = Fade()  # of turn [rad] and body rate [rad/s], (6,)

    @property
    def observer(self) -> FaultObserver:
        """The observer that runs."""
        return cast("Observation", self.law).observer

    def switch(self, observer: FaultObserver) -> None:
        """Go on with changed parameters, or have another law take over from what is known, without a jump."""
        if type(observer) is type(self.observer):
            self._use(observer)
        else:
            self._next = observer

    def offer(self, stamp_ns: int, words: LastDiagnosis) -> None:
        """Offer what an observer that has died said last [stamp in ns], to resume from."""
        if all(np.all(np.isfinite(part)) for part in words):
            super().offer(stamp_ns, words)

    def diagnose(
        self,
        stamp_ns: int,
        sample: ImuSample,
        torque: Vector | None = None,
        rotors: RotorReading | None = None,
        place: PositionSample | None = None,
    ) -> FaultEstimate | None:
        """Diagnose a sample [ns] as received; None if its stamp is repeated or went back.

        On the test stand, ``torque`` [N m] is the one that acted since the sample before; None: unknown. In
        free flight, ``rotors`` say what acted, and ``place`` what the position sensor says; None: nothing.
        """
        if rotors is not None:
            inputs = ObservationInputs(sample, None, rotors, NO_PLACE if place is None else place)
        else:
            known = np.bool_(torque is not None)
            inputs = ObservationInputs(sample, _NO_TORQUE if torque is None else torque, driven=known)
        last, dt = self.words_for(stamp_ns), self.time_step(stamp_ns)
        if self._next is not None and dt == 0.0:
            self._use(self._next)
        if last is not None and dt is not None and _is_complete(sample):
            since = last.since + last.faulty * seconds(stamp_ns - self._words_ns)
            return self.take_over(stamp_ns, inputs, last._replace(since=since))
        said = self.step(stamp_ns, inputs)
        if said is None:
            return None
        estimate = self._faded(stamp_ns, said)
        if self._next is None or not _is_complete(sample):
            return estimate
        return self._hand_over(stamp_ns, inputs, estimate, self._next)

    def _hand_over(
        self, stamp_ns: int, inputs: ObservationInputs, before: FaultEstimate, observer: FaultObserver
    ) -> FaultEstimate:
        """Start another observer at a sample [ns] of which the present one has said ``before``.

        No fault is confirmed, so it starts at the attitude that is read. The gyro bias is handed over.
        """
        last, bias = before.corrected, self._bias
        correction = last.body_rate - inputs.sample.body_rate if bias is None else -bias
        begun = samples.STARTING not in before.state.tolist() and correction.any()
        known = LastDiagnosis(np.zeros(3), _UNKNOWN, _CLEAR, correction, np.zeros(3))
        self._use(observer)
        estimate = self.begin(stamp_ns, inputs, known if begun else None)
        turn = rotation_between(estimate.corrected.q_xyzw, last.q_xyzw)
        self._fade.begin(stamp_ns, np.concatenate([turn, last.body_rate - estimate.corrected.body_rate]))
        return self._faded(stamp_ns, estimate)

    def _use(self, observer: FaultObserver) -> None:
        law = Observation(observer, self._flies)
        self.replace_law(law, law.example())
        self._next = None

    @property
    def _bias(self) -> Vector | None:
        """Gyro bias [rad/s] that the observer knows."""
        state = self.state
        return None if state is None else self.observer.bias_of(state)

    def _faded(self, stamp_ns: int, estimate: FaultEstimate) -> FaultEstimate:
        """Add to a corrected sample what is left of the difference between two laws."""
        left = self._fade.at(stamp_ns)
        if left is None:
            return estimate
        corrected = estimate.corrected
        q_xyzw, body_rate = turn(corrected.q_xyzw, left[:3]), corrected.body_rate + left[3:]
        return estimate._replace(corrected=corrected._replace(q_xyzw=q_xyzw, body_rate=body_rate))

    def gyro_bias(self, sample: ImuSample, estimate: FaultEstimate) -> Vector | None:
        """Return what the body rate of a sample is off by [rad/s] (3,): its bias, and all of a gyro fault.

        A new bias leaves the corrected rate little by little, so it cannot be seen there at first. None where
        the sample has no body rate.
        """
        if not has_rate(sample):
            return None
        taken_off = sample.body_rate - estimate.corrected.body_rate
        bias = self._bias
        if bias is None or estimate.sensors is None:
            return taken_off if bias is None else bias
        return np.where(np.isin(estimate.sensors.gyro.state, ALARMS), taken_off, bias)

    def report(self, stamp_ns: int, estimate: FaultEstimate) -> DiagnosisReport | None:
        """Return the report on a sample [ns]; None if none is due. Call it with every estimate."""
        decided = (self.observer.has_detector, *_all_that_decides(stamp_ns, estimate))
        if decided == self._decided:  # mostly; to say it in words takes several times as long
            return None
        self._decided = decided
        report = report_faults(stamp_ns, watched_sensors(self.observer, estimate))
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


def _is_complete(sample: ImuSample) -> bool:
    """Whether a sample has attitude and body rate, as an observer needs them to start."""
    return has_attitude(sample) and has_rate(sample)
