"""The closed loop of one flight as a pure step: `quadftc_flight.closed_loop` for any array library.

    plant -> fault injector -> fault observer -> disturbance observer, reference -> controller -> plant

It calls the same laws in the same order. Where the closed loop decides by stamps (withheld samples, a start
after bad samples, gaps), the step gets a mask or a time step with the sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

from quadftc_campaign.batch.parts import Loop
from quadftc_control.reference import combined
from quadftc_fdi.fault_observer import await_start
from quadftc_model.arrays import Array, chosen, namespace
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import (
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
from quadftc_sim.injector import FaultDraws, InjectionState, begin, inject
from quadftc_sim.sensor_draws import TurnOn
from quadftc_sim.sensors import ImuState


class Times(NamedTuple):
    """Scenario times of a step, the same in all flights."""

    before: Array  # () of the sample before [s]
    now: Array  # () [s]
    taken: Array  # () when the sample was taken that leaves the IMU now [s]


class Delivery(NamedTuple):
    """Which samples arrive, for flights that lose some."""

    arrives: Array  # () bool
    dt: Array  # () since the last one that arrived [s]
    restarts: Array  # () bool: it is the first, or arrives after a long gap
    elapsed: Array  # () since the first one that arrived [s]


class StepInputs(NamedTuple):
    """Random numbers of a step, and whether its sample arrives."""

    draws: tuple[Array, ...]  # of (3,), standard normal, for the IMU: see `quadftc_sim.sensor_draws`
    faults: tuple[FaultDraws | None, ...]  # of each injection
    delivery: Delivery | None  # None: every sample arrives


class AvionicsState(NamedTuple):
    """State of everything behind the IMU."""

    started: Array | None  # () bool: the diagnosis has begun; None: it has in all flights
    observer: Any
    disturbance_observer: Any
    controller: Any
    torque: Array  # (3,) command [N m]


class LoopState(NamedTuple):
    """The closed loop after a sample."""

    plant: Any
    sensor: ImuState
    # of the samples inside the IMU, oldest first: true Euler angles, body rate and disturbance, as in `Row`
    pending: tuple[tuple[Array, Array, Array], ...]
    injections: tuple[InjectionState, ...]
    avionics: AvionicsState


class Row(NamedTuple):
    """One sample of a flight; of a withheld one, only time and motion mean something."""

    time: Array  # () scenario time at which it was taken [s]
    delivered: Array  # () bool
    angles: Array  # (3,) true Euler angles [rad]
    body_rate: Array  # (3,) true [rad/s]
    disturbance: Array  # (3,) true [rad/s²]
    fault: Array  # (3,) true fault of the attitude [rad]
    gyro_fault: Array  # (3,) [rad/s]
    accelerometer_fault: Array  # (3,) [m/s²]
    reference: Array  # (3,) Euler angles [rad]
    estimate: FaultEstimate
    disturbance_estimate: Array  # (3,) [rad/s²]
    output: ControllerOutput


class ClosedLoop:
    """The closed loop of one flight; the numbers of its parts may be tracers."""

    def __init__(self, loop: Loop, late_start: bool) -> None:
        # late start: the diagnosis may have to wait for a good sample, at the start or after a gap
        self.loop, self._late_start, self._dt = loop, late_start, seconds(loop.period_ns)

    def begin(self, turn_on: TurnOn, first: Sequence[tuple[StepInputs, Times]]) -> tuple[LoopState, Row]:
        """Fly the first samples, one more than the IMU delays, and react to the one that leaves it.

        ``turn_on`` are the random numbers that the IMU begins with.
        """
        zeros, loop = namespace(turn_on.uniform).zeros_like(turn_on.uniform), self.loop
        plant = loop.plant.init(quaternion_from_euler(zeros), zeros)
        avionics = AvionicsState(None, None, None, None, zeros)
        state = LoopState(plant, loop.sensor.turn_on(turn_on), (), (), avionics)
        state, sample = self._measure(state, *first[0])
        for inputs, times in first[1:]:
            state, sample = self._measure(self._move(state, times), inputs, times)
        if sample is None:
            raise ValueError(f"{len(first)} samples: the IMU delays more")
        state = state._replace(injections=begin(loop.injections, sample))
        return self._react(state, sample, *first[-1], first=True)

    def step(self, state: LoopState, inputs: StepInputs, times: Times) -> tuple[LoopState, Row]:
        """Fly to the next sample, and react to the one that leaves the IMU then."""
        state, sample = self._measure(self._move(state, times), inputs, times)
        return self._react(state, cast("ImuSample", sample), inputs, times, first=False)

    def _move(self, state: LoopState, times: Times) -> LoopState:
        torque = state.avionics.torque
        return state._replace(plant=self.loop.plant.step(state.plant, torque, times.before, self._dt))

    def _measure(
        self, state: LoopState, inputs: StepInputs, times: Times
    ) -> tuple[LoopState, ImuSample | None]:
        """Put a sample into the IMU; return the one that leaves it."""
        q_xyzw, body_rate = state.plant.q_xyzw, state.plant.body_rate
        draws = namespace(q_xyzw).stack(inputs.draws, axis=-2)
        force = self.loop.plant.specific_force(state.plant, times.now)
        sensor, sample = self.loop.sensor.step(state.sensor, q_xyzw, body_rate, force, draws, self._dt)
        disturbance = self.loop.plant.disturbance_acceleration(times.now, body_rate)
        motion = (euler_from_quaternion(q_xyzw), body_rate, disturbance)
        return state._replace(sensor=sensor, pending=(*state.pending, motion)), sample

    def _react(
        self, state: LoopState, sample: ImuSample, inputs: StepInputs, times: Times, first: bool
    ) -> tuple[LoopState, Row]:
        """Put the faults on a sample and run the avionics over it; with the first one every law begins."""
        loop, delivery, before = self.loop, inputs.delivery, state.avionics
        injections, faulty = inject(
            loop.injections, state.injections, sample, times.taken, 0.0 if first else self._dt, inputs.faults
        )
        restarts: Array | bool = first or (False if delivery is None else delivery.restarts)
        dt = self._dt if delivery is None else delivery.dt
        # fault observer
        started, observer, estimate = self._diagnose(before, faulty.sample, dt, restarts, first)
        corrected = estimate.corrected
        # disturbance observer
        rate_inputs = DisturbanceObserverInputs(corrected.body_rate, corrected.rate_valid, before.torque)
        disturbance_observer, disturbance = _advance(
            loop.disturbance_observer, before.disturbance_observer, rate_inputs, dt, restarts
        )
        # reference and controller
        elapsed = times.taken if delivery is None else delivery.elapsed
        wanted = combined(loop.references, elapsed)
        asarray = namespace(elapsed).asarray
        reference = AttitudeReference(*(asarray(each, dtype=elapsed.dtype) for each in wanted))
        inputs_now = ControllerInputs(corrected, reference, disturbance)
        controller, output = _advance(loop.controller, before.controller, inputs_now, dt, restarts)
        after = AvionicsState(started, observer, disturbance_observer, controller, output.torque)
        if delivery is not None:
            # a withheld sample changes nothing; if it is the first, the states begun with it stay unused
            unstarted = None if started is None else started & False
            unchanged = after._replace(started=unstarted, torque=before.torque) if first else before
            after = chosen(delivery.arrives, after, unchanged)
        delivered = asarray(True) if delivery is None else delivery.arrives
        said = (estimate, disturbance, output)
        truth = (faulty.attitude, faulty.gyro, faulty.accelerometer)
        row = Row(times.taken, delivered, *state.pending[0], *truth, reference.angles, *said)
        return state._replace(pending=state.pending[1:], injections=injections, avionics=after), row

    def _diagnose(
        self, before: AvionicsState, sample: ImuSample, dt: Any, restarts: Array | bool, first: bool
    ) -> tuple[Array | None, Any, FaultEstimate]:
        """Advance the fault observer; it begins with the first sample that has attitude and rate."""
        clean = sanitised(sample)
        started, ready = before.started, clean.attitude_valid & clean.rate_valid
        begins = restarts if first or started is None else restarts | ~started
        inputs = FaultObserverInputs(clean, before.torque)
        observer, estimate = _advance(self.loop.observer, before.observer, inputs, dt, begins)
        if not (self._late_start if first else started is not None):
            return None, observer, estimate
        # until it can begin: as `quadftc_fdi.diagnosis.Diagnosis` says it
        waiting = await_start(clean, of_sensors=estimate.sensors is not None)
        estimate = chosen(begins & ~ready, waiting, estimate)
        return ready if first else ready | ~cast("Array", begins), observer, estimate


def _advance(law: Any, state: Any, inputs: Any, dt: Any, begins: Array | bool) -> tuple[Any, Any]:
    """Step a law; where ``begins`` holds, it begins with this sample."""
    if begins is True:
        return law.step(law.init(inputs), inputs, 0.0)
    after = law.step(state, inputs, dt)
    return after if begins is False else chosen(begins, law.step(law.init(inputs), inputs, 0.0), after)
