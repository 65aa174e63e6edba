"""The closed loop of one flight as a pure step: `quadftc_flight.closed_loop` for any array library.

    plant -> fault injector -> fault observer -> disturbance observer, reference -> controller -> plant

The same laws are called in the same order. What there depends on stamps (samples withheld, a start after bad
samples, gaps) is here a mask or a time step given with the sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from quadftc_campaign.batch.parts import Loop
from quadftc_control.reference import combined
from quadftc_model.arrays import Array, chosen, namespace
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import (
    STARTING,
    AttitudeReference,
    ControllerInputs,
    ControllerOutput,
    DisturbanceObserverInputs,
    FaultEstimate,
    FaultObserverInputs,
    ImuSample,
    sanitised,
)
from quadftc_model.stepper import seconds
from quadftc_sim.injection_step import FaultDraws, InjectionState, begin, inject
from quadftc_sim.plant import PlantState
from quadftc_sim.sensors import ImuState


class Given(NamedTuple):
    """What a step is given from outside: times and random numbers."""

    before: Array  # () scenario time of the sample before [s]
    now: Array  # () scenario time now [s]
    taken: Array  # () scenario time of the sample that comes out now [s]
    draws: tuple[Array, ...]  # four of (3,), standard normal: attitude, gyro, accelerometer, bias
    faults: tuple[FaultDraws | None, ...]  # of each injection
    delivery: Delivery | None  # None: every sample comes


class Delivery(NamedTuple):
    """Which samples come, for flights that lose some."""

    comes: Array  # () bool
    dt: Array  # () since the last one that came [s]
    anew: Array  # () bool: it is the first, or comes after a long gap
    elapsed: Array  # () since the first one that came [s]


class Truth(NamedTuple):
    """How the vehicle moved when a sample was taken."""

    angles: Array  # (3,) [rad]
    body_rate: Array  # (3,) [rad/s]
    disturbance: Array  # (3,) [rad/s²]


class Avionics(NamedTuple):
    """What is behind the IMU."""

    started: Array | None  # () bool: the diagnosis has begun; None: it has in all flights
    observer: Any
    disturbance_observer: Any
    controller: Any
    torque: Array  # (3,) command [N m]


class LoopState(NamedTuple):
    """The closed loop after a sample."""

    plant: PlantState
    sensor: ImuState
    pending: tuple[Truth, ...]  # of the samples that are on their way, oldest first
    injections: tuple[InjectionState, ...]
    avionics: Avionics


class Row(NamedTuple):
    """What a flight shows of a sample; what is not known of a withheld one is not to be used."""

    time: Array  # () scenario time at which it was taken [s]
    delivered: Array  # () bool
    angles: Array  # (3,) true Euler angles [rad]
    body_rate: Array  # (3,) true [rad/s]
    disturbance: Array  # (3,) true [rad/s²]
    fault: Array  # (3,) true fault of the attitude [rad]
    reference: Array  # (3,) Euler angles [rad]
    estimate: FaultEstimate
    disturbance_estimate: Array  # (3,) [rad/s²]
    output: ControllerOutput


class _Reaction(NamedTuple):
    estimate: FaultEstimate
    disturbance: Array  # (3,) [rad/s²]
    reference: AttitudeReference
    output: ControllerOutput


class ClosedLoop:
    """The closed loop of one flight.

    Parameters
    ----------
    loop : Loop
        Its parts; their numbers may be those of a compiler.
    late_start : bool
        Whether there may be a flight in which the diagnosis cannot begin with the first sample.
    """

    def __init__(self, loop: Loop, late_start: bool) -> None:
        self.loop = loop
        self._late_start = late_start
        self._dt = seconds(loop.period_ns)

    def begin(self, bias: Array, given: Sequence[Given]) -> tuple[LoopState, Row]:
        """Fly until a sample comes out of the IMU, and react to it.

        Parameters
        ----------
        bias : array (3,)
            Turn-on bias of the gyro, uniform in [-1, 1].
        given : sequence of Given
            Of the first samples: one more than the IMU delays.
        """
        zeros = namespace(bias).zeros_like(bias)
        plant = self.loop.plant.init(quaternion_from_euler(zeros), zeros)
        sensor = self.loop.sensor.init(self.loop.sensor.turn_on_bias(bias))
        pending: Any = ()
        sample = None
        for index, each in enumerate(given):
            if index > 0:
                plant = self.loop.plant.step(plant, zeros, each.before, self._dt)
            sensor, sample, pending = self._measured(plant, sensor, pending, each)
        if sample is None:
            raise ValueError(f"{len(given)} samples: the IMU delays more")
        first, truth, later = given[-1], pending[0], pending[1:]
        injections = begin(self.loop.injections, sample)
        injections, faulty = inject(self.loop.injections, injections, sample, first.taken, 0.0, first.faults)
        avionics, reaction = self._first(faulty.sample, zeros, first)
        if first.delivery is not None:
            avionics = chosen(first.delivery.comes, avionics, avionics._replace(torque=zeros))
        state = LoopState(plant, sensor, later, injections, avionics)
        return state, self._row(truth, first, faulty.attitude, reaction)

    def step(self, state: LoopState, given: Given) -> tuple[LoopState, Row]:
        """Fly to the next sample, and react to the one that comes out of the IMU then."""
        loop, before = self.loop, state.avionics
        plant = loop.plant.step(state.plant, before.torque, given.before, self._dt)
        sensor, sample, pending = self._measured(plant, state.sensor, state.pending, given)
        if sample is None:
            raise ValueError("the IMU delays more than at the start")
        injections, faulty = inject(
            loop.injections, state.injections, sample, given.taken, self._dt, given.faults
        )
        avionics, reaction = self._next(before, faulty.sample, given)
        if given.delivery is not None:
            avionics = chosen(given.delivery.comes, avionics, before)
        new = LoopState(plant, sensor, pending[1:], injections, avionics)
        return new, self._row(pending[0], given, faulty.attitude, reaction)

    def _measured(
        self, plant: PlantState, sensor: ImuState, pending: Sequence[Truth], given: Given
    ) -> tuple[ImuState, ImuSample | None, tuple[Truth, ...]]:
        xp = namespace(plant.q_xyzw)
        draws = xp.stack(given.draws, axis=-2)
        sensor, sample = self.loop.sensor.step(sensor, plant.q_xyzw, plant.body_rate, draws, self._dt)
        disturbance = self.loop.plant.disturbance_acceleration(given.now, plant.body_rate)
        truth = Truth(euler_from_quaternion(plant.q_xyzw), plant.body_rate, disturbance)
        return sensor, sample, (*pending, truth)

    def _first(self, sample: ImuSample, torque: Array, given: Given) -> tuple[Avionics, _Reaction]:
        """React to the first sample."""
        clean = sanitised(sample)
        observer, estimate, _ = self._observer_begun(clean, torque)
        started = None
        if self._late_start:
            valid = clean.attitude_valid & clean.rate_valid
            estimate = chosen(valid, estimate, _starting(clean))
            started = valid if given.delivery is None else valid & given.delivery.comes
        disturbance_inputs = _disturbance_inputs(estimate, torque)
        law = self.loop.disturbance_observer
        disturbance_observer, disturbance = law.step(law.init(disturbance_inputs), disturbance_inputs, 0.0)
        reference = self._reference(given)
        inputs = ControllerInputs(estimate.corrected, reference, disturbance)
        controller, output = self.loop.controller.step(self.loop.controller.init(inputs), inputs, 0.0)
        return (
            Avionics(started, observer, disturbance_observer, controller, output.torque),
            _Reaction(estimate, disturbance, reference, output),
        )

    def _next(self, before: Avionics, sample: ImuSample, given: Given) -> tuple[Avionics, _Reaction]:
        """React to a later sample, or, in flights where everything begins anew with it, as to the first."""
        delivery, torque = given.delivery, before.torque
        dt = self._dt if delivery is None else delivery.dt
        anew = None if delivery is None else delivery.anew
        clean = sanitised(sample)
        observer, estimate = self.loop.observer.step(before.observer, FaultObserverInputs(clean, torque), dt)
        started = before.started
        if started is not None:
            begins = ~started if anew is None else anew | ~started
            fresh, at_start, valid = self._observer_begun(clean, torque)
            observer = chosen(begins, fresh, observer)
            estimate = chosen(begins, chosen(valid, at_start, _starting(clean)), estimate)
            started = valid | ~begins
        disturbance_inputs = _disturbance_inputs(estimate, torque)
        disturbance_observer, disturbance = self._stepped(
            self.loop.disturbance_observer, before.disturbance_observer, disturbance_inputs, dt, anew
        )
        reference = self._reference(given)
        inputs = ControllerInputs(estimate.corrected, reference, disturbance)
        controller, output = self._stepped(self.loop.controller, before.controller, inputs, dt, anew)
        return (
            Avionics(started, observer, disturbance_observer, controller, output.torque),
            _Reaction(estimate, disturbance, reference, output),
        )

    def _observer_begun(self, clean: ImuSample, torque: Array) -> tuple[Any, FaultEstimate, Array]:
        """State and estimate of an observer that begins with a sample, and whether it can."""
        inputs = FaultObserverInputs(clean, torque)
        state, estimate = self.loop.observer.step(self.loop.observer.init(inputs), inputs, 0.0)
        return state, estimate, clean.attitude_valid & clean.rate_valid

    @staticmethod
    def _stepped(law: Any, state: Any, inputs: Any, dt: Any, anew: Array | None) -> tuple[Any, Any]:
        after = law.step(state, inputs, dt)
        return after if anew is None else chosen(anew, law.step(law.init(inputs), inputs, 0.0), after)

    def _reference(self, given: Given) -> AttitudeReference:
        elapsed = given.taken if given.delivery is None else given.delivery.elapsed
        xp = namespace(elapsed)
        reference = combined(self.loop.references, elapsed)
        return AttitudeReference(*(xp.asarray(each, dtype=elapsed.dtype) for each in reference))

    @staticmethod
    def _row(truth: Truth, given: Given, fault: Array, reaction: _Reaction) -> Row:
        delivery = given.delivery
        there = namespace(fault).asarray(True) if delivery is None else delivery.comes
        return Row(
            time=given.taken,
            delivered=there,
            angles=truth.angles,
            body_rate=truth.body_rate,
            disturbance=truth.disturbance,
            fault=fault,
            reference=reaction.reference.angles,
            estimate=reaction.estimate,
            disturbance_estimate=reaction.disturbance,
            output=reaction.output,
        )


def _disturbance_inputs(estimate: FaultEstimate, torque: Array) -> DisturbanceObserverInputs:
    return DisturbanceObserverInputs(estimate.corrected.body_rate, estimate.corrected.rate_valid, torque)


def _starting(clean: ImuSample) -> FaultEstimate:
    """What is said until the diagnosis can begin, as `quadftc_fdi.diagnosis.Diagnosis` says it."""
    xp = namespace(clean.body_rate)
    zeros = xp.zeros_like(clean.body_rate)
    state = xp.full_like(clean.body_rate, STARTING, dtype=xp.uint8)
    return FaultEstimate(zeros, zeros - 1.0, state, zeros - 1.0, clean)
