"""The closed loop of one flight as a pure step: `quadftc_flight.closed_loop` for any array library.

    plant -> fault injector -> fault observer -> disturbance observer, reference -> controller -> plant

In free flight a position sensor and a position controller come in (`quadftc_campaign.batch.steering`).

It calls the same laws in the same order. Where the closed loop decides by stamps (withheld samples, a start
after bad samples, gaps), the step gets a mask or a time step with the sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

from quadftc_campaign.batch.parts import Loop
from quadftc_campaign.batch.steering import Given, Wanted, advance, steering_of
from quadftc_fdi.fault_observer import await_rotors, await_start
from quadftc_model.arrays import Array, chosen, namespace
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import (
    ControllerInputs,
    ControllerOutput,
    DisturbanceObserverInputs,
    FaultEstimate,
    FaultObserverInputs,
    ImuSample,
    PositionSample,
    RotorReading,
    effectiveness_of,
    sanitised,
)
from quadftc_model.stepper import seconds
from quadftc_sim.flying_plant import FlyingPlant
from quadftc_sim.injector import FaultDraws, Faulty, InjectionState, begin, inject
from quadftc_sim.position_sensor import PositionSensorState
from quadftc_sim.rotor_fault import true_effectiveness
from quadftc_sim.sensor_draws import TurnOn
from quadftc_sim.sensors import ImuState


class Times(NamedTuple):
    """Scenario times of a step, the same in all flights."""

    before: Array  # () of the sample before [s]
    now: Array  # () [s]
    taken: Array  # () when the sample was taken that leaves the IMU now [s]
    due: Array | None  # () bool: the position sensor measures; None without one


class Delivery(NamedTuple):
    """Which samples arrive, for flights that lose some."""

    arrives: Array  # () bool
    dt: Array  # () since the last one that arrived [s]
    restarts: Array  # () bool: it is the first, or arrives after a long gap
    elapsed: Array  # () since the first one that arrived [s]


class FirstDraws(NamedTuple):
    """Random numbers that the sensors begin with."""

    imu: TurnOn
    place: Array | None  # (rows, 3) of the position sensor; None without one


class StepInputs(NamedTuple):
    """Random numbers of a step, and whether its sample arrives."""

    draws: tuple[Array, ...]  # of (3,), standard normal, for the IMU: see `quadftc_sim.sensor_draws`
    faults: tuple[FaultDraws | None, ...]  # of each injection
    delivery: Delivery | None  # None: every sample arrives
    place: Array | None  # (rows, 3), standard normal, of the position sensor; None without one


class AvionicsState(NamedTuple):
    """State of everything behind the IMU."""

    started: Array | None  # () bool: the diagnosis has begun; None: it has in all flights
    observer: Any
    disturbance_observer: Any
    guidance: Any  # of the position controller; None without one
    controller: Any
    given: Given


class Motion(NamedTuple):
    """How the vehicle moves, as in `Row`."""

    angles: Array
    body_rate: Array
    disturbance: Array
    position: Array | None
    rotor_speeds: Array | None  # (n,) in free flight [rad/s]


class LoopState(NamedTuple):
    """The closed loop after a sample."""

    plant: Any
    sensor: ImuState
    place: PositionSensorState | None  # None without one
    pending: tuple[Motion, ...]  # of the samples inside the IMU, oldest first
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
    # in free flight, (3,) [m]; None on the test stand
    position: Array | None = None
    position_reference: Array | None = None
    position_estimate: Array | None = None
    rotor_effectiveness: Array | None = None  # (n,) true [1]


class ClosedLoop:
    """The closed loop of one flight; the numbers of its parts may be tracers."""

    def __init__(self, loop: Loop, late_start: bool) -> None:
        # late start: the diagnosis may have to wait for a good sample, at the start or after a gap
        self.loop, self._late_start, self._dt = loop, late_start, seconds(loop.period_ns)
        self._steering = steering_of(loop)

    def begin(self, drawn: FirstDraws, first: Sequence[tuple[StepInputs, Times]]) -> tuple[LoopState, Row]:
        """Fly the first samples, one more than the IMU delays, and react to the one that leaves it.

        ``drawn`` are the random numbers that the sensors begin with.
        """
        zeros, loop = namespace(drawn.imu.uniform).zeros_like(drawn.imu.uniform), self.loop
        plant = loop.plant.init(quaternion_from_euler(zeros), zeros)
        avionics = AvionicsState(None, None, None, None, None, self._steering.first(plant, zeros))
        sensors = loop.sensor.turn_on(drawn.imu), self._place_at_first(drawn.place)
        state = LoopState(plant, *sensors, (), (), avionics)
        state, sample, place = self._measure(state, *first[0])
        for inputs, times in first[1:]:
            state, sample, place = self._measure(self._move(state, times), inputs, times)
        if sample is None:
            raise ValueError(f"{len(first)} samples: the IMU delays more")
        state = state._replace(injections=begin(loop.injections, sample))
        return self._react(state, sample, place, *first[-1], first=True)

    def step(self, state: LoopState, inputs: StepInputs, times: Times) -> tuple[LoopState, Row]:
        """Fly to the next sample, and react to the one that leaves the IMU then."""
        state, sample, place = self._measure(self._move(state, times), inputs, times)
        return self._react(state, cast("ImuSample", sample), place, inputs, times, first=False)

    def _move(self, state: LoopState, times: Times) -> LoopState:
        command = state.avionics.given.command
        return state._replace(plant=self.loop.plant.step(state.plant, command, times.before, self._dt))

    def _place_at_first(self, drawn: Array | None) -> PositionSensorState | None:
        """Return the state of the position sensor with as many samples on their way as there always are."""
        place = self.loop.place
        if place is None or drawn is None:
            return None
        state = place.sensor.turn_on(drawn)
        nothing = 0.0 * state.wander
        none = PositionSample(nothing, nothing, nothing[0] > 0.0)
        return state._replace(pending=(none,) * place.behind)

    def _measure(
        self, state: LoopState, inputs: StepInputs, times: Times
    ) -> tuple[LoopState, ImuSample | None, PositionSample | None]:
        """Put a sample into the sensors; return what leaves them."""
        q_xyzw, body_rate = state.plant.q_xyzw, state.plant.body_rate
        draws = namespace(q_xyzw).stack(inputs.draws, axis=-2)
        force = self.loop.plant.specific_force(state.plant, times.now)
        sensor, sample = self.loop.sensor.step(state.sensor, q_xyzw, body_rate, force, draws, self._dt)
        disturbance = self.loop.plant.disturbance_acceleration(times.now, body_rate)
        position = place = speeds = None
        known = state.place
        if self.loop.place is not None and known is not None:
            law, behind = self.loop.place.sensor, self.loop.place.behind
            position, velocity, speeds = state.plant.position, state.plant.velocity, state.plant.speeds
            known, place = law.step(known, position, velocity, times.due, inputs.place, behind, self._dt)
        motion = Motion(euler_from_quaternion(q_xyzw), body_rate, disturbance, position, speeds)
        state = state._replace(sensor=sensor, place=known, pending=(*state.pending, motion))
        return state, sample, place

    def _react(
        self,
        state: LoopState,
        sample: ImuSample,
        place: PositionSample | None,
        inputs: StepInputs,
        times: Times,
        first: bool,
    ) -> tuple[LoopState, Row]:
        """Put the faults on a sample and run the avionics over it; with the first one every law begins."""
        loop, delivery, before = self.loop, inputs.delivery, state.avionics
        injections, faulty = inject(
            loop.injections, state.injections, sample, times.taken, 0.0 if first else self._dt, inputs.faults
        )
        restarts: Array | bool = first or (False if delivery is None else delivery.restarts)
        dt = self._dt if delivery is None else delivery.dt
        # fault observer
        motion = state.pending[0]
        rotors = self._steering.rotors(before.given, motion.rotor_speeds)
        seen = (faulty.sample, place, rotors)
        started, observer, estimate = self._diagnose(before, *seen, dt, restarts, first)
        corrected, effectiveness = estimate.corrected, effectiveness_of(estimate.rotors)
        # disturbance observer
        rate_inputs = DisturbanceObserverInputs(
            corrected.body_rate, corrected.rate_valid, before.given.torque
        )
        disturbance_observer, disturbance = advance(
            loop.disturbance_observer, before.disturbance_observer, rate_inputs, dt, restarts
        )
        # reference and controller
        elapsed = times.taken if delivery is None else delivery.elapsed
        guidance, wanted = self._steering.wanted(before.guidance, corrected, place, elapsed, dt, restarts)
        rotor_torque = self._steering.rotor_torque(motion.rotor_speeds, effectiveness)
        inputs_now = ControllerInputs(corrected, wanted.attitude, disturbance, rotor_torque, effectiveness)
        controller, output = advance(self._steering.controller, before.controller, inputs_now, dt, restarts)
        given, output = self._steering.actuated(wanted, output, effectiveness)
        after = AvionicsState(started, observer, disturbance_observer, guidance, controller, given)
        if delivery is not None:
            # a withheld sample changes nothing; if it is the first, the states begun with it stay unused
            unstarted = None if started is None else started & False
            unchanged = after._replace(started=unstarted, given=before.given) if first else before
            after = chosen(delivery.arrives, after, unchanged)
        delivered = namespace(elapsed).asarray(True) if delivery is None else delivery.arrives
        said = (estimate, disturbance, output)
        row = _row((times.taken, delivered), motion, faulty, wanted, said)
        if motion.rotor_speeds is not None:
            ones = namespace(elapsed).ones_like(motion.rotor_speeds)
            true = ones if faulty.rotors is None else true_effectiveness(faulty.rotors)
            row = row._replace(rotor_effectiveness=true)
        plant = state.plant
        if isinstance(loop.plant, FlyingPlant):
            plant = loop.plant.with_rotors(plant, faulty.rotors)
        rest = {"pending": state.pending[1:], "injections": injections, "avionics": after}
        return state._replace(plant=plant, **rest), row

    def _diagnose(
        self,
        before: AvionicsState,
        sample: ImuSample,
        place: PositionSample | None,
        rotors: RotorReading | None,
        dt: Any,
        restarts: Array | bool,
        first: bool,
    ) -> tuple[Array | None, Any, FaultEstimate]:
        """Advance the fault observer; it begins with the first sample that has attitude and rate."""
        clean = sanitised(sample)
        started, ready = before.started, clean.attitude_valid & clean.rate_valid
        begins = restarts if first or started is None else restarts | ~started
        inputs = FaultObserverInputs(clean, *self._steering.acted(before.given), place, rotors)
        observer, estimate = advance(self.loop.observer, before.observer, inputs, dt, begins)
        if not (self._late_start if first else started is not None):
            return None, observer, estimate
        # until it can begin: as `quadftc_fdi.diagnosis.Diagnosis` says it
        waiting = await_start(clean, of_sensors=estimate.sensors is not None)
        if estimate.rotors is not None:
            waiting = waiting._replace(rotors=await_rotors(estimate.rotors))
        estimate = chosen(begins & ~ready, waiting, estimate)
        return ready if first else ready | ~cast("Array", begins), observer, estimate


def may_start_late(loop: Loop) -> bool:
    """Tell whether a fault may leave nothing to begin with: on the first sample, or on one after a gap."""
    return any(
        fault.channel == "imu" or (fault.start <= 0.0 and fault.channel in ("attitude", "gyro"))
        for fault in loop.injections
    )


def _row(
    at: tuple[Array, Array], motion: Motion, faulty: Faulty, wanted: Wanted, said: tuple[Any, Array, Any]
) -> Row:
    """Return what is known of a sample: when it was taken, and whether it came; and what was said of it."""
    estimate, disturbance, output = said
    return Row(
        *at,
        *(motion.angles, motion.body_rate, motion.disturbance),
        *(faulty.attitude, faulty.gyro, faulty.accelerometer),
        wanted.attitude.angles,
        estimate,
        disturbance,
        output,
        *(motion.position, wanted.position, wanted.position_estimate),
    )
