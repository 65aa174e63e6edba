r"""Which sensor lies? `supervised`, with a judge of its gyro and of the accelerometer.

Per axis, with attitude a, gyro g, torque u and inertia J, there are three residuals:

    r1 = a' - g               test of the attitude: `supervised`
    r2 = g' - u / J - d       test of the gyro: `gyro_monitor`
    r3 = a'' - u / J - d      its filter without the gyro, a virtual gyro

An attitude fault shows in r1 and r3, a gyro fault in r1 and r2. What is too slow for r2 and r3 is ambiguous
(`hypotheses`): it is flown so that the error is bounded whoever lies. docs/isolating.md explains the rules
and their limits; docs/isolability.md says what is possible.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from quadftc_fdi.fault_observer import SHORTEST, LastDiagnosis, register
from quadftc_fdi.fault_observers import supervised
from quadftc_fdi.fault_observers.supervised import Rate, Supervised
from quadftc_fdi.isolation import (
    accelerometer_monitor,
    free_flight,
    gyro_monitor,
    hypotheses,
    naming,
    rate_filter,
    reading_test,
    rotor_watch,
)
from quadftc_fdi.isolation.accelerometer_monitor import AccelerometerMonitor
from quadftc_fdi.isolation.flight_law import FlightLaw
from quadftc_fdi.isolation.free_flight import FreeFlight
from quadftc_fdi.isolation.gyro_monitor import AttitudeReading, GyroMonitor, GyroReading
from quadftc_fdi.isolation.hypotheses import Hypotheses
from quadftc_fdi.isolation.reading_test import Channels, Flags, ReadingTest, Verdict, start_test
from quadftc_fdi.isolation.rotor_watch import RotorWatch
from quadftc_fdi.rotor_diagnosis.monitor import estimate_rotors
from quadftc_fdi.supervision import sensor_noise
from quadftc_fdi.supervision.inertial_filter import estimate_rate
from quadftc_fdi.supervision.transition import ROTATION
from quadftc_model import samples
from quadftc_model.arrays import (
    Mask,
    Scalar,
    Vector,
    any_of,
    branch,
    column,
    diagonal,
    larger,
    namespace,
    stacked,
    where,
)
from quadftc_model.parameters import parameter
from quadftc_model.rigid_body import gyroscopic_acceleration
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, turn
from quadftc_model.samples import FaultEstimate, FaultObserverInputs, ImuSample, SensorDiagnosis

DEG = math.pi / 180.0
CORRELATED = 0.06  # s; how long an error of the virtual gyro lasts
LOST = 10.0  # rad²; variance of an attitude of which nothing is known: more means nothing
UNDRIVEN = 30.0  # rad/s²/sqrt(s); random walk of the acceleration, at least, where the torque is unknown
UNTESTED = 1e6  # rad²/s²; variance of a prediction that tests no gyro
TWICE_LONG: float = 2.0 * sensor_noise.AVERAGED[sensor_noise.LONG].item()  # s
VOTED = 1.0  # 1; log-odds of the position from which it has decided for the gyro
# rad/s; standard deviation of a virtual gyro, alone for long without an attitude, that is worse than a gyro
LOST_RATE = 1.0
# s, rad; a fault of the attitude so soon after the gyro's, and so small, is what that one did to the filter
LED, SMALL = 0.3, 1.5 * DEG
SLOW = 1.0  # rad/s; bandwidth in which an attitude made of the gyro can replace it


GYRO, FORCE, ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9)  # channels of the readings
# rad/s, m/s², rad; noise at first, and squared: in flight at least (vibration comes and goes), of the best
# sensor; of one that may repeat itself. A test of the attitude by itself finds only whether it is stuck
PRIOR = np.repeat((0.02, accelerometer_monitor.NOISE, 1e-3), 3)
FLOOR, LEAST, NOISY = (
    np.repeat(each, 3) ** 2
    for each in (
        (0.005, accelerometer_monitor.LEAST, 10.0),
        (1e-5, accelerometer_monitor.LEAST, 1e-9),
        (1e-4, 0.0, 1e-6),
    )
)


class State(NamedTuple):
    """Observer state at the last sample."""

    attitude: supervised.State
    readings: ReadingTest  # of gyro, accelerometer and attitude, nine channels
    gyro: GyroMonitor
    accelerometer: AccelerometerMonitor
    hypotheses: Hypotheses
    missing: Mask  # the attitude is absent, or was a moment ago
    flight: FreeFlight | None  # None on the test stand
    rotors: RotorWatch | None  # None on the test stand


class Judged(NamedTuple):
    """What the readings of a sample say of all but the attitude."""

    readings: ReadingTest
    gyro: GyroMonitor
    accelerometer: AccelerometerMonitor
    verdict: Verdict
    flight: FreeFlight | None
    rotors: RotorWatch | None


@register("isolating")
class Isolating(FlightLaw, Supervised):
    """Tells faults of attitude, gyro and accelerometer apart, and flies on what is left."""

    disturbance: float = parameter(
        1.0, unit="rad/s^2/sqrt(s)", low=1e-6, doc="random walk of the unknown acceleration"
    )
    belief: float = parameter(
        5.0 * DEG, unit="rad", low=1e-6, doc="ambiguous fault of the attitude up to which the gyro is flown"
    )
    rotor_lag: float = parameter(0.0, unit="s", low=0.0, doc="time constant of the torque behind its command")
    attitude_from_gyro: bool = parameter(False, doc="the attitude is computed from this gyro")

    def init(self, inputs: FaultObserverInputs) -> Any:
        """Start on the measurement."""
        return self._start(super().init(inputs), inputs)

    def resumed(self, inputs: FaultObserverInputs, last: LastDiagnosis) -> Any:
        """Resume with what was known of the attitude; gyro and accelerometer start as healthy."""
        return self._start(super().resumed(inputs, last), inputs)

    def bias_of(self, state: Any) -> Vector:
        """Return the gyro bias [rad/s] of a state."""
        return super().bias_of(state.attitude)

    def describe(self, state: Any) -> dict[str, Vector]:
        """Return what the observer of the attitude knows besides."""
        return super().describe(state.attitude)

    def _start(self, attitude: supervised.State, inputs: FaultObserverInputs) -> State:
        imu, drive = inputs.imu, inputs.torque / self.vehicle.inertia
        rate = estimate_rate(attitude.filter.x, imu.body_rate)
        flight = rotors = None
        if inputs.thrust is not None:
            flight = free_flight.start_flight(
                self.motion_law, free_flight.motion_inputs(inputs), inputs.thrust
            )
        if inputs.rotors is not None:
            rotors = rotor_watch.start_watch(self.vehicle, self.rotor_effects, imu, inputs.rotors)
        return State(
            attitude,
            start_test(_channels(imu), PRIOR),
            gyro_monitor.start_monitor(imu.q_xyzw, rate, drive, sensor_noise.WHITE**2),
            accelerometer_monitor.start_accelerometer(imu.specific_force),
            hypotheses.start_hypotheses(attitude.faulty),
            namespace(attitude.faulty).zeros_like(attitude.faulty),
            flight,
            rotors,
        )

    def step(self, state: Any, inputs: FaultObserverInputs, dt: float) -> tuple[Any, FaultEstimate]:
        """Advance by ``dt`` [s] to the sample."""
        imu, before = inputs.imu, state.attitude
        judged = branch(
            dt > 0.0, lambda: self._judge_readings(state, inputs, dt), lambda: _begin_judging(state)
        )
        readings, monitor, accelerometer, verdict, flight, rotors = judged

        # the attitude against the gyro, or the virtual one
        rate = monitor.filter.rate
        flown = where(monitor.bad, rate + before.filter.x[..., :3], imu.body_rate)
        known = diagonal(before.filter.P)[..., ROTATION] < LOST
        doubt = where(monitor.bad & known, 2.0 * CORRELATED * dt * monitor.filter.rr, 0.0)
        turns = Rate(flown, any_of(state.hypotheses.ambiguous), doubt)
        attitude, estimate = self.advance(before, imu, turns, dt)

        # whose is a fault of the attitude? Where it is the gyro's, the attitude is acquitted
        believed, monitor, flight, attitude, estimate = branch(
            any_of(attitude.faulty)[..., 0] & (dt > 0.0),
            lambda: self._blame(state, inputs, judged, attitude, estimate, dt),
            lambda: (hypotheses.start_hypotheses(attitude.faulty), monitor, flight, attitude, estimate),
        )

        missing = verdict.odd[..., ATTITUDE] | (state.missing & verdict.late[..., ATTITUDE])
        state = State(attitude, readings, monitor, accelerometer, believed, missing, flight, rotors)
        return state, estimate._replace(
            corrected=self._fly(estimate, rate, believed),
            sensors=self._name(state, imu, estimate),
            rotors=None if rotors is None else estimate_rotors(rotors.monitor),
        )

    def _blame(
        self,
        state: State,
        inputs: FaultObserverInputs,
        judged: Judged,
        attitude: supervised.State,
        estimate: FaultEstimate,
        dt: Scalar,
    ) -> tuple[Hypotheses, GyroMonitor, FreeFlight | None, supervised.State, FaultEstimate]:
        """Judge whose a fault of the attitude is, and acquit the attitude where it is the gyro's."""
        monitor, flight, fault = judged.gyro, judged.flight, estimate.fault
        new, abrupt = attitude.faulty & ~state.attitude.faulty, attitude.track.still < 1.0
        vote = namespace(fault).zeros_like(fault)
        if flight is not None:
            flight = free_flight.follow_tilt(flight, fault, estimate.onset_age, new, dt)
            vote = free_flight.vote(flight, judged.accelerometer, fault, estimate.std_dev)
        trace, rate = monitor.trace, monitor.filter.rate
        led = new & any_of(monitor.faulty & (monitor.fault.age < LED)) & (abs(fault) < SMALL)
        seen = hypotheses.Evidence(
            abrupt & ~monitor.faulty,
            judged.verdict.stuck[..., ATTITUDE],
            trace.bend,
            trace.jump,
            trace.deviation,
            monitor.filter.rr,
            monitor.filter.acceleration,
            monitor.filter.dd,
            trace.needed,
            trace.scatter,
            vote,
            attitude.faulty & column(inputs.driven) & (not self.attitude_from_gyro),
        )
        faulty = attitude.faulty & ~led
        believed, guilty = hypotheses.weigh(state.hypotheses, faulty, new, fault, seen, dt)
        acquitted = guilty | led

        def acquit() -> tuple[GyroMonitor, supervised.State, FaultEstimate]:
            slight, large = gyro_monitor.gyro_error(fault, estimate.onset_age)
            # where the position says that the attitude is right, a slight error is a bias
            bias = attitude.filter.x[..., :3] + guilty * (vote > VOTED) * slight
            followed = reading_test.begin_deviation(monitor.fault, large, guilty)
            named = monitor._replace(faulty=monitor.faulty | guilty, fault=followed)
            return named, *self._acquit(attitude, estimate, inputs, rate, acquitted, bias)

        monitor, attitude, estimate = branch(
            any_of(acquitted)[..., 0], acquit, lambda: (monitor, attitude, estimate)
        )
        return believed, monitor, flight, attitude, estimate

    def _judge_readings(self, state: State, inputs: FaultObserverInputs, dt: float) -> Judged:
        """Test the readings of all sensors, and judge rotors, gyro and accelerometer."""
        imu, before, inertia = inputs.imu, state.attitude, self.vehicle.inertia
        xp, rate, rotors = namespace(imu.body_rate), state.gyro.filter.rate, inputs.rotors
        omega, there = estimate_rate(before.filter.x, imu.body_rate), _there(imu)
        gyroscopic, least = gyroscopic_acceleration(inertia, rate), self.disturbance**2
        driven, measured = column(inputs.driven), False if rotors is None else rotors.measured
        q = where(driven, least, larger(least, UNDRIVEN**2))
        # predict
        state, inputs = self._watch_rotors(state, inputs, omega, gyroscopic, dt)
        drive = (inputs.torque - self.vehicle.rotational_drag * rate) / inertia
        lag = where(measured, 0.0, self.rotor_lag)
        ahead = gyro_monitor.predict_monitor(state.gyro, drive, gyroscopic, q, lag, dt)
        # where the gyro is believed again, go on at its rate
        wanted, faulty = ~state.hypotheses.ambiguous, state.gyro.faulty
        forgiven = faulty & there[..., GYRO] & (state.gyro.filter.rr > LOST_RATE**2)
        state = state._replace(gyro=state.gyro._replace(faulty=faulty & ~forgiven))
        returns = (state.gyro.alone & wanted & ~state.gyro.faulty) | forgiven
        adopted = omega, FLOOR[GYRO], state.gyro.trace.needed, returns
        ahead = ahead._replace(filter=rate_filter.adopt_gyro(ahead.filter, *adopted))
        # test
        q_xyzw, watched = turn(before.filter.q_xyzw, dt * omega), (state.flight, state.accelerometer)
        flight, off, unsure = free_flight.force_deviation(*watched, self.vehicle, inputs, q_xyzw, dt)
        raw = _channels(imu)
        moved = raw[..., ATTITUDE] - state.readings.reading[..., ATTITUDE]
        square = xp.concatenate([omega - ahead.filter.rate, off, moved], axis=-1) ** 2
        # without the torque, or with an attitude that may be wrong, predictions test nothing
        variance = ahead.filter.rr + UNTESTED * (~driven | ~wanted)
        predicted = xp.concatenate([variance, unsure + UNTESTED * ~driven, xp.zeros_like(off)], axis=-1)
        noise = larger(state.readings.variance, FLOOR)
        readings, verdict = reading_test.test_reading(
            state.readings, raw, there, square, predicted, noise, NOISY, dt
        )
        # judge
        known = noise[..., GYRO], readings.suspicion[..., GYRO], there[..., GYRO]
        gyro = GyroReading(omega, *known, wanted, *verdict.of(GYRO)[:3])
        attitude = self._attitude_reading(imu, before, there[..., ATTITUDE], dt)
        monitor, white, taught = gyro_monitor.step_monitor(state.gyro, ahead, gyro, attitude, dt)
        force = (
            off,
            noise[..., FORCE],
            readings.suspicion[..., FORCE],
            there[..., FORCE],
            verdict.of(FORCE),
            before.faulty | monitor.faulty | ~driven,
            dt,
        )
        if flight is None:
            accelerometer, learned = accelerometer_monitor.step_accelerometer(state.accelerometer, *force)
        else:
            flight, accelerometer, learned = free_flight.step_flight(
                flight, self.motion_law, state.accelerometer, free_flight.motion_inputs(inputs), *force
            )
        used = xp.concatenate([taught, learned, there[..., ATTITUDE]], axis=-1)
        square = xp.concatenate([white, square[..., FORCE.start :]], axis=-1)
        readings = reading_test.learn_noise(readings, square, predicted, used, LEAST, dt)
        return Judged(readings, monitor, accelerometer, verdict, flight, state.rotors)

    def _watch_rotors(
        self, state: State, inputs: FaultObserverInputs, omega: Vector, gyroscopic: Vector, dt: Scalar
    ) -> tuple[State, FaultObserverInputs]:
        """Judge the rotors; return the torque and the thrust that they give, with what is unknown of them."""
        if state.rotors is None or inputs.rotors is None:
            return state, inputs
        xp, vehicle, gyro, flight = namespace(omega), self.vehicle, state.gyro, state.flight
        turns = gyroscopic - vehicle.rotational_drag * gyro.filter.rate / vehicle.inertia
        lost = gyro.faulty | ~column(inputs.imu.rate_valid)
        rate, vague = where(lost, gyro.filter.rate, omega), where(lost, gyro.filter.rr, 0.0)
        rotors, acts = rotor_watch.step_watch(
            *(state.rotors, vehicle, self.rotor_effects, inputs, inputs.rotors),
            *(rate, vague, turns, state.accelerometer.faulty[..., 2], dt),
        )
        # what a suspect rotor may do is no evidence against a sensor, nor is a reading an outlier for it
        unknown = gyro.filter._replace(dd=larger(gyro.filter.dd, acts.turning))
        none = xp.zeros_like(omega)
        pushing = xp.concatenate([none[..., :2], column(acts.pushing)], axis=-1)
        held = state.readings.held + xp.concatenate([acts.turning * dt**2, pushing, none], axis=-1)
        if flight is not None:
            flight = flight._replace(unsure=larger(flight.unsure, pushing))
        state = state._replace(
            readings=state.readings._replace(held=held),
            gyro=gyro._replace(filter=unknown),
            flight=flight,
            rotors=rotors,
        )
        return state, inputs._replace(torque=acts.torque, thrust=acts.thrust)

    def _attitude_reading(
        self, imu: ImuSample, before: supervised.State, there: Mask, dt: Scalar
    ) -> AttitudeReading:
        """Return the attitude of a sample, with what is known of it."""
        noise, step = before.noise.exact, larger(dt, SHORTEST)
        single, long = noise[..., sensor_noise.SAMPLE], noise[..., sensor_noise.LONG]
        # a slow error of the attitude counts as white noise of the same density at low frequency
        variance = larger(single, long * (TWICE_LONG + dt) / step)
        if self.attitude_from_gyro:
            variance = larger(variance, self.disturbance**2 / (SLOW**6 * step))
        return AttitudeReading(imu.q_xyzw, single, variance, there, ~before.faulty)

    def _acquit(
        self,
        attitude: supervised.State,
        estimate: FaultEstimate,
        inputs: FaultObserverInputs,
        rate: Vector,
        acquitted: Mask,
        bias: Vector,
    ) -> tuple[supervised.State, FaultEstimate]:
        """Start again on measured angles, virtual rate and a gyro ``bias`` where the fault is the gyro's."""
        xp, kept = namespace(estimate.fault), attitude.faulty & ~acquitted
        fault, since = where(kept, attitude.track.fault, 0.0), where(kept, attitude.track.age, 0.0)
        last = LastDiagnosis(fault, xp.zeros_like(fault), kept, -bias, since)
        fresh = (
            super()
            .resumed(inputs, last)
            ._replace(
                gyro=attitude.gyro,
                gyro_before=attitude.gyro_before,
                activity=attitude.activity,
                motion=attitude.motion,
                noise=attitude.noise,
                outliers=attitude.outliers,
            )
        )
        corrected = estimate.corrected._replace(
            q_xyzw=fresh.filter.q_xyzw, body_rate=where(acquitted, rate, estimate.corrected.body_rate)
        )
        return fresh, estimate._replace(
            fault=where(acquitted, 0.0, estimate.fault),
            state=where(acquitted, samples.SUSPECT, estimate.state).astype(xp.uint8),
            onset_age=where(acquitted, -1.0, estimate.onset_age),
            corrected=corrected,
        )

    def _fly(self, estimate: FaultEstimate, rate: Vector, believed: Hypotheses) -> ImuSample:
        """Return the sample for the controller."""
        corrected = estimate.corrected
        beyond = believed.ambiguous & (abs(estimate.fault) > self.belief)
        shift, share = hypotheses.flown(estimate.fault, believed.ambiguous, self.belief)
        shifted = quaternion_from_euler(euler_from_quaternion(corrected.q_xyzw) + shift)
        return corrected._replace(
            q_xyzw=where(any_of(beyond), shifted, corrected.q_xyzw),
            body_rate=corrected.body_rate + share * (rate - corrected.body_rate),
            rate_valid=corrected.rate_valid | True,
        )

    def _name(self, state: State, imu: ImuSample, estimate: FaultEstimate) -> SensorDiagnosis:
        """Say what is known of each sensor."""
        believed = state.hypotheses
        if self.attitude_from_gyro:  # a fault of the gyro is in both
            believed = believed._replace(ambiguous=believed.ambiguous | state.gyro.faulty)
        return SensorDiagnosis(
            naming.name_attitude(estimate, believed, state.readings.suspicion[..., ATTITUDE], state.missing),
            naming.name_gyro(state.gyro, state.readings, GYRO, imu.rate_valid, estimate, believed),
            naming.name_accelerometer(state.accelerometer, state.readings, FORCE, imu.force_valid),
        )


def _begin_judging(state: State) -> Judged:
    """Return what is judged of the first sample: nothing yet."""
    no = state.readings.time < 0.0
    verdict = Verdict(~no, no, no, no)
    return Judged(state.readings, state.gyro, state.accelerometer, verdict, state.flight, state.rotors)


def _channels(imu: ImuSample) -> Channels:
    """Return the readings of the nine channels."""
    angles = euler_from_quaternion(imu.q_xyzw)
    return namespace(angles).concatenate([imu.body_rate, imu.specific_force, angles], axis=-1)


def _there(imu: ImuSample) -> Flags:
    """Whether each of the nine channels has a reading."""
    return stacked([flag for flag in (imu.rate_valid, imu.force_valid, imu.attitude_valid) for _ in range(3)])
