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
from quadftc_sim.injector import FaultDraws, InjectionState, begin, inject
from quadftc_sim.plant import PlantState
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

    draws: tuple[Array, ...]  # four of (3,), standard normal: attitude, gyro, accelerometer, gyro bias
    faults: tuple[FaultDraws | None, ...]  # of each injection
    delivery: Delivery | None  # None: every sample arrives


class Truth(NamedTuple):
    """Motion of the vehicle when a sample was taken."""

    angles: Array  # (3,) [rad]
    body_rate: Array  # (3,) [rad/s]
    disturbance: Array  # (3,) [rad/s²]


class AvionicsState(NamedTuple):
    """State of everything behind the IMU."""

    started: Array | None  # () bool: the diagnosis has begun; None: it has in all flights
    observer: Any
    disturbance_observer: Any
    controller: Any
    torque: Array  # (3,) command [N m]


class LoopState(NamedTuple):
    """The closed loop after a sample."""

    plant: PlantState
    sensor: ImuState
    pending: tuple[Truth, ...]  # of the samples inside the IMU, oldest first
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
    reference: Array  # (3,) Euler angles [rad]
    estimate: FaultEstimate
    disturbance_estimate: Array  # (3,) [rad/s²]
    output: ControllerOutput


class ClosedLoop:
    """The closed loop of one flight.

    Parameters
    ----------
    loop : Loop
        Its parts; their numbers may be tracers.
    late_start : bool
        Whether there may be a flight in which the diagnosis cannot begin with the first sample.
    """

    def __init__(self, loop: Loop, late_start: bool) -> None:
        self.loop = loop
        self._late_start = late_start
        self._dt = seconds(loop.period_ns)

    def begin(self, bias: Array, first: Sequence[tuple[StepInputs, Times]]) -> tuple[LoopState, Row]:
        """Fly until a sample leaves the IMU, and react to it.

        Parameters
        ----------
        bias : array (3,)
            Turn-on bias of the gyro, uniform in [-1, 1].
        first : sequence of (StepInputs, Times)
            Of the first samples: one more than the IMU delays.
        """
        zeros = namespace(bias).zeros_like(bias)
        plant = self.loop.plant.init(quaternion_from_euler(zeros), zeros)
        sensor = self.loop.sensor.init(self.loop.sensor.turn_on_bias(bias))
        sample, pending = None, ()
        for index, (inputs, times) in enumerate(first):
            if index > 0:
                plant = self.loop.plant.step(plant, zeros, times.before, self._dt)
            sensor, sample, pending = self._measure(plant, sensor, pending, inputs, times)
        if sample is None:
            raise ValueError(f"{len(first)} samples: the IMU delays more")
        state = LoopState(
            plant,
            sensor,
            pending,
            begin(self.loop.injections, sample),
            AvionicsState(None, None, None, None, zeros),
        )
        return self._finish(state, sample, *first[-1], first=True)

    def step(self, state: LoopState, inputs: StepInputs, times: Times) -> tuple[LoopState, Row]:
        """Fly to the next sample, and react to the one that leaves the IMU then."""
        plant = self.loop.plant.step(state.plant, state.avionics.torque, times.before, self._dt)
        sensor, sample, pending = self._measure(plant, state.sensor, state.pending, inputs, times)
        if sample is None:
            raise ValueError("the IMU delays more than at the start")
        state = state._replace(plant=plant, sensor=sensor, pending=pending)
        return self._finish(state, sample, inputs, times, first=False)

    def _measure(
        self,
        plant: PlantState,
        sensor: ImuState,
        pending: tuple[Truth, ...],
        inputs: StepInputs,
        times: Times,
    ) -> tuple[ImuState, ImuSample | None, tuple[Truth, ...]]:
        draws = namespace(plant.q_xyzw).stack(inputs.draws, axis=-2)
        sensor, sample = self.loop.sensor.step(sensor, plant.q_xyzw, plant.body_rate, draws, self._dt)
        disturbance = self.loop.plant.disturbance_acceleration(times.now, plant.body_rate)
        truth = Truth(euler_from_quaternion(plant.q_xyzw), plant.body_rate, disturbance)
        return sensor, sample, (*pending, truth)

    def _finish(
        self, state: LoopState, sample: ImuSample, inputs: StepInputs, times: Times, first: bool
    ) -> tuple[LoopState, Row]:
        """Put the faults on a sample, react to it, and show it."""
        dt = 0.0 if first else self._dt
        injections, faulty = inject(
            self.loop.injections, state.injections, sample, times.taken, dt, inputs.faults
        )
        truth, delivery = state.pending[0], inputs.delivery
        avionics, reaction = self._react(state.avionics, faulty.sample, delivery, times, first)
        row = Row(
            time=times.taken,
            delivered=namespace(sample.body_rate).asarray(True) if delivery is None else delivery.arrives,
            angles=truth.angles,
            body_rate=truth.body_rate,
            disturbance=truth.disturbance,
            fault=faulty.attitude,
            **reaction,
        )
        return LoopState(state.plant, state.sensor, state.pending[1:], injections, avionics), row

    def _react(
        self, before: AvionicsState, sample: ImuSample, delivery: Delivery | None, times: Times, first: bool
    ) -> tuple[AvionicsState, dict[str, Any]]:
        """Run the avionics over a sample; with the first one every law begins."""
        restarts: Array | bool = first or (False if delivery is None else delivery.restarts)
        dt = self._dt if delivery is None else delivery.dt
        clean = sanitised(sample)
        started, observer, estimate = self._diagnose(before, clean, dt, restarts, first)
        disturbance_inputs = DisturbanceObserverInputs(
            estimate.corrected.body_rate, estimate.corrected.rate_valid, before.torque
        )
        disturbance_observer, disturbance = _advance(
            self.loop.disturbance_observer, before.disturbance_observer, disturbance_inputs, dt, restarts
        )
        reference = self._reference(times.taken if delivery is None else delivery.elapsed)
        controller_inputs = ControllerInputs(estimate.corrected, reference, disturbance)
        controller, output = _advance(
            self.loop.controller, before.controller, controller_inputs, dt, restarts
        )
        after = AvionicsState(started, observer, disturbance_observer, controller, output.torque)
        if delivery is not None:
            # a withheld sample changes nothing; if it is the first, the states begun with it stay unused
            unstarted = None if started is None else started & False
            unchanged = after._replace(started=unstarted, torque=before.torque) if first else before
            after = chosen(delivery.arrives, after, unchanged)
        return after, {
            "reference": reference.angles,
            "estimate": estimate,
            "disturbance_estimate": disturbance,
            "output": output,
        }

    def _diagnose(
        self, before: AvionicsState, clean: ImuSample, dt: Any, restarts: Array | bool, first: bool
    ) -> tuple[Array | None, Any, FaultEstimate]:
        """Advance the fault observer; it begins with the first sample that has attitude and rate."""
        started, ready = before.started, clean.attitude_valid & clean.rate_valid
        begins: Array | bool = first or (False if started is None else restarts | ~started)
        inputs = FaultObserverInputs(clean, before.torque)
        observer, estimate = _advance(self.loop.observer, before.observer, inputs, dt, begins)
        if not (self._late_start if first else started is not None):
            return None, observer, estimate
        estimate = chosen(begins & ~ready, _starting(clean), estimate)
        return ready if first else ready | ~cast("Array", begins), observer, estimate

    def _reference(self, elapsed: Array) -> AttitudeReference:
        xp = namespace(elapsed)
        reference = combined(self.loop.references, elapsed)
        return AttitudeReference(*(xp.asarray(each, dtype=elapsed.dtype) for each in reference))


def _advance(law: Any, state: Any, inputs: Any, dt: Any, begins: Array | bool) -> tuple[Any, Any]:
    """Step a law; where ``begins`` holds, it begins with this sample."""
    if begins is True:
        return law.step(law.init(inputs), inputs, 0.0)
    after = law.step(state, inputs, dt)
    return after if begins is False else chosen(begins, law.step(law.init(inputs), inputs, 0.0), after)


def _starting(clean: ImuSample) -> FaultEstimate:
    """Estimate until the diagnosis can begin, as `quadftc_fdi.diagnosis.Diagnosis` gives it."""
    xp = namespace(clean.body_rate)
    zeros = xp.zeros_like(clean.body_rate)
    state = xp.full_like(clean.body_rate, STARTING, dtype=xp.uint8)
    return FaultEstimate(zeros, zeros - 1.0, state, zeros - 1.0, clean)
