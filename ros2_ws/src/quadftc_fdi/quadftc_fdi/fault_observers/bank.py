"""`bank`: one model of the motion, one table of modes, Bayes for the rest: docs/bank.md.

It judges attitude and gyro; accelerometer and rotors are judged beside it (`bank.translation`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.bank import decide, hypotheses, inference, modes, motion, noise, readings, translation, trust
from quadftc_fdi.bank.decide import Probabilities, Seen
from quadftc_fdi.bank.hypotheses import OF_ATTITUDE, OF_GYRO, Bank
from quadftc_fdi.bank.inference import Posterior
from quadftc_fdi.bank.motion import Gains, Motion
from quadftc_fdi.bank.noise import Learning, Noise
from quadftc_fdi.bank.readings import Readings
from quadftc_fdi.bank.translation import Translation
from quadftc_fdi.bank.trust import Scatter, Trust
from quadftc_fdi.fault_observer import LastDiagnosis, register, without_fault
from quadftc_fdi.isolation.flight_law import FlightLaw
from quadftc_model import samples
from quadftc_model.arrays import (
    Array,
    Flag,
    Mask,
    Quaternion,
    Scalar,
    Vector,
    any_of,
    branch,
    clip,
    column,
    components,
    cos,
    exp,
    larger,
    log,
    namespace,
    sin,
    stacked,
    where,
)
from quadftc_model.parameters import parameter
from quadftc_model.rigid_body import gyroscopic_acceleration
from quadftc_model.rotations import earth_z_in_body, euler_from_quaternion, quaternion_from_euler, turn, wrap
from quadftc_model.samples import (
    FaultEstimate,
    FaultObserverInputs,
    ImuSample,
    SensorDiagnosis,
)


class State(NamedTuple):
    """What the observer knows."""

    motion: Motion
    blind: Motion  # the same without the gyro, while the attitude tells of the motion
    learning: Learning
    bank: Bank
    attitude: Trust
    gyro: Trust
    force: Trust  # of the accelerometer, by the tilt that it shows
    scatter: Scatter
    angles_read: Readings  # of the attitude [rad]
    rates_read: Readings  # of the gyro [rad/s]
    worth: Array  # log weight of the hypotheses (..., modes, slots)
    rate: Vector  # reading of the gyro at the last sample [rad/s]
    q_xyzw: Quaternion  # attitude at the last sample: as read, else turned with the gyro since
    lead: Vector  # of the angles over those that follow them, by which the attitude may be late [rad]
    reckoned: Vector  # angles by the turns that were predicted of late [rad]
    torque: Vector  # behind its lag [N m]
    translation: Translation
    failed: Array  # of gyro, attitude, accelerometer: for how long a new fault is likelier [s] (..., 3)


class Measured(NamedTuple):
    """What the readings of a sample have done to bank and motion."""

    bank: Bank
    motion: Motion
    by_attitude: Gains
    off: Vector  # attitude less motion, as Euler angles [rad]
    added: Array  # what a fault of 1 rad or 1 s adds to the rotation vector of the attitude (..., 3, effects)
    lead: Vector  # see `State`
    reckoned: Vector  # see `State`
    tilt: Gains | None  # by gravity; None if it is not felt


@register("bank")
class BankObserver(FlightLaw):
    """Bank of fault modes: joint over sensors, axes and onsets."""

    level: float = parameter(0.997, low=0.5, high=1.0, doc="probability from which a fault is named")
    rotor_lag: float = parameter(0.0, unit="s", low=0.0, doc="time constant of the torque behind its command")
    attitude_from_gyro: bool = parameter(False, doc="the attitude is computed from this gyro")
    gyro_fails: bool = parameter(True, doc="false: what attitude and gyro do not share is the attitude's")
    feels_gravity: bool = parameter(True, doc="the accelerometer, without a position: on a test stand")

    def init(self, inputs: FaultObserverInputs) -> State:
        """Start at a sample."""
        imu = inputs.imu
        learning = noise.start_learning(imu.q_xyzw, imu.body_rate)
        started = motion.start_motion(imu.q_xyzw, imu.body_rate, noise.noise_of(learning, inputs.driven, 0.0))
        bank, full = hypotheses.start_bank(imu.body_rate), trust.full_trust(imu.body_rate)
        zeros = namespace(imu.body_rate).zeros_like(imu.body_rate)
        angles_read = readings.start_readings(euler_from_quaternion(imu.q_xyzw))
        rates_read = readings.start_readings(imu.body_rate)
        return State(
            motion=started,
            blind=started,
            learning=learning,
            bank=bank,
            attitude=full,
            gyro=full,
            force=full,
            scatter=trust.no_scatter(imu.body_rate),
            angles_read=angles_read,
            rates_read=rates_read,
            worth=bank.age[..., modes.EFFECT, :] + hypotheses.LOWEST,
            rate=imu.body_rate,
            q_xyzw=imu.q_xyzw,
            lead=zeros,
            reckoned=euler_from_quaternion(imu.q_xyzw),
            torque=inputs.torque,
            translation=translation.start_translation(
                self.vehicle, self.motion_law, self.rotor_effects, inputs
            ),
            failed=zeros,
        )

    def resumed(self, inputs: FaultObserverInputs, last: LastDiagnosis) -> State:
        """Return the state that resumes where another observer has died: its faults last, its bias holds."""
        state = self.init(without_fault(inputs, last.fault))
        peak = where(last.faulty, abs(last.fault), 0.0)
        zeros = namespace(peak).zeros_like(peak)
        attitude = Trust(last.faulty, last.since, last.fault, peak, zeros, zeros, state.attitude.sums)
        started = state.motion._replace(
            bias=-last.gyro_correction, rate=inputs.imu.body_rate + last.gyro_correction
        )
        return state._replace(motion=started, attitude=attitude)

    def bias_of(self, state: State) -> Vector:
        """Return the gyro bias [rad/s]."""
        return state.motion.bias

    def step(self, state: State, inputs: FaultObserverInputs, dt: float) -> tuple[State, FaultEstimate]:
        """Advance by ``dt`` [s] to a sample."""
        imu, levels = inputs.imu, noise.noise_of(state.learning, inputs.driven, dt)
        attitude_read, gyro_read = self._read(state, imu, dt)
        alone = ~readings.is_witness(attitude_read)
        speaks = ~alone & ~state.attitude.faulty, readings.is_witness(gyro_read)
        good_attitude, good_gyro = speaks[0] & column(imu.attitude_valid), speaks[1] & column(imu.rate_valid)
        read = where(column(imu.rate_valid), imu.body_rate, state.motion.rate + state.motion.bias)
        beside, inputs, turning = self._judge_rotors(state, inputs, ~good_gyro, dt)
        moved, without, known, torque = self._predict(state, inputs, read, turning, levels, dt)
        # what the readings do to motion and bank, and what is to be believed of it
        good = good_gyro, good_attitude
        seen = self._measure(state, imu, moved, without, levels, good, inputs.driven, dt)
        stuck = readings.is_stuck(attitude_read), readings.is_stuck(gyro_read)
        bank, off = _regarded(seen.bank, state, *stuck, speaks[1], inputs.driven), seen.off
        posterior, given, named = self._infer(state, bank, beside, speaks, seen.tilt, inputs.driven)
        p, is_sure, there = given.of_modes, named.any(axis=-1), imu.attitude_valid
        believed, bank, age = branch(
            is_sure,
            lambda: trust.take_over(seen.motion, bank, posterior, named, seen.added, alone, inputs.driven),
            lambda: (seen.motion, bank, p[..., 0] * 0.0),
        )
        # the motion without the gyro follows the believed one while no attitude holds it
        blind = branch(
            any_of(~speaks[0])[..., 0] | self.attitude_from_gyro,
            lambda: believed,
            lambda: motion.take_attitude(without, imu.q_xyzw, levels.attitude, good_attitude)[0],
        )
        attitude, gyro = (
            decide.said_of(sensor, 1.0 * named) > 0.0 for sensor in (modes.ATTITUDE, modes.GYRO)
        )
        # one witness of each axis stays: who names the last takes the other name back
        cleared = gyro & state.attitude.faulty, attitude & state.gyro.faulty
        before = trust.acquitted(state.attitude, cleared[0]), trust.acquitted(state.gyro, cleared[1])
        angle = where(cleared[0] | gyro, trust.off_square(off, imu, believed, good_attitude), 0.0)
        # no torque tells what the bias is meanwhile
        believed = trust.as_before(believed, state.gyro, cleared[1] & ~column(inputs.driven))
        believed = trust.doubted(believed, angle, gyro, named)
        attitude = trust.watch_attitude(
            before[0], attitude, age, off, seen.by_attitude.variance, levels.attitude, there, believed, dt
        )
        beside = translation.follow_fault(beside, off, attitude, before[0].faulty, stuck[0], dt)
        force = self._watch_force(state, seen.tilt, named, age, imu.force_valid, believed, dt)
        louder, bias = noise.louder(state.learning), state.motion.bias
        gyro = trust.watch_gyro(before[1], gyro, age, believed, known, bias, louder, dt)
        believed = motion.untaught(believed, gyro.faulty)
        # learn
        turned = turn(state.q_xyzw, 0.5 * (read + state.rate) * column(dt))
        scatter = trust.watch_scatter(state.scatter, louder, inputs.driven, 1.0 - self.level, dt)
        sound = decide.how_sound(given, bank.age)
        well = (
            sound[0] * (good_gyro & ~(gyro.faulty | scatter.noisy)),
            sound[1] * (good_attitude & ~attitude.faulty),
        )
        learning = noise.learn(
            state.learning, read, state.rate, known, imu.q_xyzw, state.q_xyzw, *well, good_gyro, dt
        )
        after = State(
            motion=believed,
            blind=blind,
            learning=learning,
            bank=inference.learn_temper(bank, namespace(p).stack(well, axis=-2), dt),
            attitude=attitude,
            gyro=gyro,
            force=force,
            scatter=scatter,
            angles_read=attitude_read,
            rates_read=gyro_read,
            worth=posterior.log_weight,
            rate=read,
            q_xyzw=where(column(there), imu.q_xyzw, turned),
            lead=seen.lead,
            reckoned=seen.reckoned,
            torque=torque,
            translation=beside,
            failed=where(
                trust.any_faulty(gyro, attitude, force), trust.AGREES, larger(state.failed - dt, 0.0)
            ),
        )
        # what is flown: the mean over the hypotheses, which has the least expected square of the error
        angle, change = inference.expected_change(
            bank, posterior, given.of_onsets * ~is_sure[..., None, None]
        )
        flown = turn(believed.q_xyzw, angle), believed.rate + change
        of_bias = larger(believed.covariance[..., motion.BETA, motion.BETA], 0.0)
        by_motion = (
            Seen(off, seen.by_attitude.variance, decide.said_of(modes.ATTITUDE, p), column(there)),
            Seen(gyro.size, of_bias, decide.said_of(modes.GYRO, p), column(imu.rate_valid)),
        )
        return self._said(after, inputs, given, flown, *by_motion, dt)

    def _measure(
        self,
        state: State,
        imu: ImuSample,
        moved: Motion,
        blind: Motion,
        levels: Noise,
        good: tuple[Mask, Mask],
        driven: Flag,
        dt: float,
    ) -> Measured:
        """Take gyro and attitude where they are ``good``, and the tilt by gravity.

        ``blind`` is the motion without the gyro.
        """
        good_gyro, good_attitude = good
        bank = hypotheses.move(state.bank, moved.rate, self.attitude_from_gyro, dt)
        bank = hypotheses.open_slots(bank, state.worth, state.failed > 0.0, driven, dt)
        expected = hypotheses.of_gyro(bank, moved.rate, blind.rate + moved.bias)
        moved, by_gyro = motion.take_gyro(moved, imu.body_rate, levels.gyro, good_gyro)
        vague = motion.rate_vagueness(state.blind, blind, dt)
        bank = hypotheses.weigh(bank, OF_GYRO, by_gyro, expected, vague)
        angles = euler_from_quaternion(moved.q_xyzw)
        off = wrap(euler_from_quaternion(imu.q_xyzw) - angles)
        turned = wrap(angles - euler_from_quaternion(state.motion.q_xyzw))
        lead = modes.ahead(state.lead, turned, dt)
        reckoned = motion.reckon(state.reckoned, angles, turned, dt)
        changed = modes.pattern(modes.ATTITUDE) + column(modes.late_by(lead)) * modes.pattern(modes.LATE)
        changed = changed + column(reckoned) * modes.pattern(modes.STRETCHED)
        added = _turning(angles) @ changed
        expected = hypotheses.of_attitude(bank, moved.rate, added)
        # an angle that is not used must not turn the others
        kept = quaternion_from_euler(angles + where(good_attitude, off, 0.0))
        taken = where(any_of(~good_attitude), kept, imu.q_xyzw)
        moved, by_attitude = motion.take_attitude(moved, taken, levels.attitude, good_attitude)
        bank = hypotheses.weigh(bank, OF_ATTITUDE, by_attitude, expected)
        beside, tilt = state.translation, None
        if beside.flight is None and self.feels_gravity:
            feels = imu.force_valid & driven & ~any_of(beside.accelerometer.faulty)[..., 0]
            feels, white = column(feels) & ~state.force.faulty, translation.noise_of_force(beside)
            expected = hypotheses.of_tilt(bank, earth_z_in_body(moved.q_xyzw), modes.pattern(modes.FELT))
            moved, tilt = motion.take_tilt(moved, imu.specific_force, white, feels)
            bank = hypotheses.weigh(bank, OF_ATTITUDE, tilt, expected)
        return Measured(bank, moved, by_attitude, off, added, lead, reckoned, tilt)

    def _watch_force(
        self,
        state: State,
        tilt: Gains | None,
        named: Array,
        age: Scalar,
        there: Flag,
        believed: Motion,
        dt: float,
    ) -> Trust:
        """Watch the tilt that the accelerometer shows by the motion; there may be none."""
        if tilt is None:
            return state.force
        felt = decide.said_of(modes.FELT, 1.0 * named) > 0.0
        noise_of_tilt = translation.noise_of_force(state.translation) / samples.STANDARD_GRAVITY**2
        off = tilt.innovation, tilt.variance, noise_of_tilt
        return trust.watch_attitude(state.force, felt, age, *off, there, believed, dt)

    def _judge_rotors(
        self, state: State, inputs: FaultObserverInputs, faulty: Mask, dt: float
    ) -> tuple[Translation, FaultObserverInputs, Vector]:
        """Judge the rotors; return the torque and thrust that they give, and what they may give besides."""
        moving, vehicle = state.motion, self.vehicle
        turns = self._turns(moving.rate)
        faulty = faulty | state.gyro.faulty
        rate = where(faulty, moving.rate, inputs.imu.body_rate - moving.bias)
        vague = where(faulty, moving.covariance[..., motion.OMEGA, motion.OMEGA], 0.0)
        beside = state.translation
        return translation.judge_rotors(beside, vehicle, self.rotor_effects, inputs, rate, vague, turns, dt)

    def _turns(self, rate: Vector) -> Vector:
        """Angular acceleration [rad/s²] by rotation and drag alone."""
        inertia, rate = self.vehicle.inertia, clip(rate, -samples.MAX_BODY_RATE, samples.MAX_BODY_RATE)
        return gyroscopic_acceleration(inertia, rate) - self.vehicle.rotational_drag * rate / inertia

    def _read(self, state: State, imu: ImuSample, dt: float) -> tuple[Readings, Readings]:
        """Take readings of attitude and gyro."""
        # what is not known yet is nothing: only what is the very same is a repeated reading
        learned = state.learning.attitude, state.learning.gyro
        changes = [where(each.time > inference.SETTLE, each.near, 0.0) for each in learned]
        angles = euler_from_quaternion(imu.q_xyzw)
        attitude = readings.take_reading(state.angles_read, angles, imu.attitude_valid, changes[0], dt)
        gyro = readings.take_reading(state.rates_read, imu.body_rate, imu.rate_valid, changes[1], dt)
        return attitude, gyro

    def _predict(
        self,
        state: State,
        inputs: FaultObserverInputs,
        read: Vector,
        turning: Vector,
        levels: Noise,
        dt: float,
    ) -> tuple[Motion, Motion, Vector, Vector]:
        """Predict the motion, with the gyro and without it.

        Also return the known acceleration [rad/s²] and the torque [N m].

        ``turning`` is the variance of the acceleration that a suspect rotor may give [rad²/s⁴].
        """
        inertia, rotors = self.vehicle.inertia, inputs.rotors
        lag = self.rotor_lag if rotors is None else where(column(rotors.measured), 0.0, self.rotor_lag)
        share = 1.0 - exp(-dt / larger(lag, 1e-9))
        torque = state.torque + share * (inputs.torque - state.torque)
        known = 0.5 * (torque + state.torque) / inertia + self._turns(state.motion.rate)
        between = (torque - state.torque) / inertia  # it may have changed at any time since the last sample
        usual = state.learning.gyro.drift * column(inputs.driven)  # a trim, a centre of mass that is off
        walk = where(state.gyro.faulty, trust.FAULTY_WALK, motion.WALK)
        mean = 0.5 * (read + state.rate)
        repeats = self.attitude_from_gyro
        moves = known + usual, between, inputs.driven, mean, walk, levels, repeats
        moved, without = (
            motion.predict(motion.unsettled(each, motion.D, turning), *moves, dt)
            for each in (state.motion, state.blind)
        )
        return moved, without, known, torque

    def _infer(
        self,
        state: State,
        bank: Bank,
        beside: Translation,
        speaks: tuple[Mask, Mask],
        tilt: Gains | None,
        driven: Flag,
    ) -> tuple[Posterior, Probabilities, Array]:
        """Return the posterior, how likely all is, and which mode is beyond doubt.

        ``speaks``: the axes of attitude and gyro that are believed and tell of the motion.
        """
        held = speaks[0], speaks[0] | (tilt is not None and tilt.used)
        rarer = 2.0 * log(1.0 - self.level)
        failing = state.failed > 0.0
        posterior = inference.believe(bank, *held, driven, failing, rarer, self.gyro_fails)
        posterior, asked = translation.ask_position(beside, bank, posterior)
        given = decide.probabilities(bank, posterior)
        aged = (given.of_onsets * bank.age[..., modes.EFFECT, :]).sum(axis=-1)
        witnesses = asked, speaks[1] & ~state.gyro.faulty, column(driven)
        named = decide.named_mode(given, aged, *witnesses, 1.0 - self.level, self.attitude_from_gyro)
        return posterior, given, named

    def _said(
        self,
        state: State,
        inputs: FaultObserverInputs,
        given: Probabilities,
        flown: tuple[Quaternion, Vector],
        attitude: Seen,
        gyro: Seen,
        dt: float,
    ) -> tuple[State, FaultEstimate]:
        """Judge the accelerometer, and say what is believed of a sample: ``flown`` are attitude and rate."""
        imu, judged = inputs.imu, not self.attitude_from_gyro
        counts = np.isin(modes.NAME, (modes.GYRO, modes.ATTITUDE) if judged else (modes.GYRO,))
        unsure = decide.is_unsure(given, counts, self.level)
        few = 1.0 - self.level
        even = trust.no_scatter(imu.body_rate)
        by_attitude = decide.judge(state.attitude, state.angles_read, even, attitude, unsure & judged, few)
        by_gyro = decide.judge(state.gyro, state.rates_read, state.scatter, gyro, unsure, few)
        doubtful = (by_attitude.onset_age >= 0.0) | (by_gyro.onset_age >= 0.0)
        knows = self.feels_gravity or state.translation.flight is not None
        beside = translation.judge_accelerometer(
            state.translation, self.vehicle, self.motion_law, inputs, flown[0], doubtful, knows, dt
        )
        by_accelerometer, rotors = translation.say(beside, state.force, imu.force_valid)
        corrected = imu._replace(
            q_xyzw=flown[0],
            body_rate=flown[1],
            attitude_valid=imu.attitude_valid | True,
            rate_valid=imu.rate_valid | True,
        )
        # of an attitude that is merely absent there is no estimate
        without = (by_attitude.kind == decide.ABSENT) & ~state.attitude.faulty
        return state._replace(translation=beside), FaultEstimate(
            by_attitude.size,
            by_attitude.std_dev,
            where(without, samples.HEALTHY, by_attitude.state).astype(by_attitude.state.dtype),
            where(without, -1.0, by_attitude.onset_age),
            corrected,
            SensorDiagnosis(by_attitude, by_gyro, by_accelerometer),
            rotors,
        )


def _regarded(
    bank: Bank, state: State, stuck_attitude: Mask, stuck_gyro: Mask, witness: Mask, driven: Flag
) -> Bank:
    """Drop faults that no reading tells; where the gyro is a ``witness`` (..., 3), it has readings.

    Nor has an attitude that is not believed a further one: what it reads does not count.
    """
    untold = state.gyro.faulty | (state.failed[..., :1] > 0.0)
    alone = (~witness | state.gyro.faulty) & ~column(driven)
    unread = stuck_attitude | state.attitude.faulty
    return hypotheses.disregard(bank, unread, stuck_gyro, untold, alone)


def _turning(angles: Vector) -> Array:
    """Rotation vector in body axes of small changes of the Euler angles [rad] (..., 3, 3)."""
    (s_phi, s_theta, _), (c_phi, c_theta, _) = components(sin(angles)), components(cos(angles))
    one, none = namespace(s_phi).ones_like(s_phi), namespace(s_phi).zeros_like(s_phi)
    rows = [
        stacked([one, none, -s_theta]),
        stacked([none, c_phi, s_phi * c_theta]),
        stacked([none, -s_phi, c_phi * c_theta]),
    ]
    return namespace(s_phi).stack(rows, axis=-2)
