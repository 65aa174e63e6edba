r"""Supervised diagnosis: learn the gyro while the attitude is healthy, fly on the gyro while it is not.

The paper's observer does not know the bias of a real gyro (docs/theory.md, sections 4 and 8). Here a Kalman
filter estimates the gyro's errors against the attitude of the healthy axes, and tests watch its residuals. On
a faulty axis the gyro carries the angle on: measured minus predicted angle is the fault. docs/supervised.md
explains the states of an axis and the reasons; the parts are in `quadftc_fdi.supervision`:

    inertial_filter    predict by the gyro (`transition`), correct by the healthy axes (`measurement`)
    gravity            what the accelerometer knows of the tilt
    coasting           correct by gravity, and learn the gyro, while an axis is faulty
    anchors            earlier states of the filter, to which it goes back
    sensor_noise       learn the noise of the attitude
    reading            the measured attitude beside the predicted ones
    residual_tests     collect evidence, declare faults
    fault_track        follow the fault, judge when the axis is trusted again
    judgement          both, where an axis is faulty or suspect

The noise of the attitude is learned. What is assumed of the gyro fits MEMS IMUs of every grade.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi import fault_observer
from quadftc_fdi.fault_observer import FaultObserver, correct_sample, register, without_fault
from quadftc_fdi.supervision import (
    anchors,
    coasting,
    fault_track,
    gravity,
    inertial_filter,
    measurement,
    residual_tests,
    sensor_noise,
)
from quadftc_fdi.supervision.inertial_filter import GAP, estimate_rate
from quadftc_fdi.supervision.judgement import STARTED, Limits, Tested, Verdict, all_healthy, judge
from quadftc_fdi.supervision.reading import Reading, compare, noise_of
from quadftc_fdi.supervision.transition import BIAS, SIZE, FilterState, ProcessNoise, Transition
from quadftc_model import samples
from quadftc_model.arrays import (
    Column,
    Flag,
    Mask,
    Scalar,
    Vector,
    any_of,
    branch,
    clip,
    column,
    exp,
    larger,
    namespace,
    norm,
    product,
    sqrt,
    where,
)
from quadftc_model.numbers import prepared
from quadftc_model.parameters import parameter
from quadftc_model.samples import FaultEstimate, FaultObserverInputs, ImuSample

DEG = math.pi / 180.0
UNKNOWN = 10.0  # 1; standard deviations of the attitude's noise: as good as nothing known
KEPT = 0.05 * DEG  # rad/s; a gyro bias taken over from an observer that has died is known to this
RESTING, MOVING = 0.2, 0.6  # rad/s; a vehicle rests below, and moves above, as far as slow errors go
MOVED = 2.0  # s; how long it counts as moving afterwards (time constant)
FADING = 2.0  # s; in which a new gyro bias leaves the corrected rate: at once, it would jolt the flight
KNOCK = 0.5  # rad/s; a rate that bends by more from sample to sample has passages that the gyro misses
MISSED = 0.3  # 1; share of such a bend that is missed
PITCH = np.array([False, True, False])
SHOWN = 0.3  # 1; share of the recovery time from which an axis is shown as recovering
# which part of a covariance is neither of the rotation nor of the bias
OF_REST = np.outer(np.arange(SIZE) >= BIAS.stop, np.arange(SIZE) >= BIAS.stop)


class State(NamedTuple):
    """Observer state at the last sample."""

    filter: FilterState
    anchors: anchors.Anchors
    gyro: Vector  # [rad/s]
    gyro_before: Vector  # of the sample before [rad/s]
    activity: Column  # decaying maximum of the body rate [rad/s]
    motion: Column  # rest 0, motion 1
    noise: sensor_noise.SensorNoise
    evidence: residual_tests.Evidence
    faulty: Mask
    passing: Mask  # pitch was too close to a pole to be tested
    track: fault_track.Track
    raw: Column  # share of the gyro as it is in the corrected body rate
    rejected: Mask  # the last sample was an outlier
    outliers: Vector  # outliers so far, and bursts of them
    gravity: gravity.Gravity
    coasting: coasting.Coasting


class Rate(NamedTuple):
    """The body rate that carries the attitude on: of the gyro, or of what may take its place."""

    value: Vector  # [rad/s]
    ambiguous: Mask  # (..., 1) a fault may be the gyro's
    doubt: Vector | None = None  # [rad²] of a rotation in this step, besides a gyro's noise; None: it is one


@register("supervised")
class Supervised(FaultObserver):
    """Estimates the gyro's errors while an axis is healthy, and dead-reckons it while it is not."""

    gyro_noise: float = parameter(0.007 * DEG, unit="rad/sqrt(s)", low=1e-8, doc="angle random walk N")
    gyro_moving: float = parameter(0.0004, unit="sqrt(s)", low=0.0, doc="what N grows by per body rate")
    gyro_shift: float = parameter(0.025 * DEG, unit="rad/s", low=0.0, doc="gyro bias by motion, 1 sigma")
    gyro_bias: float = parameter(1.5 * DEG, unit="rad/s", low=1e-6, doc="turn-on gyro bias, 1 sigma")
    gyro_bias_walk: float = parameter(2e-4 * DEG, unit="rad/s/sqrt(s)", low=0.0, doc="rate random walk K")
    gyro_scale: float = parameter(0.005, unit="1", low=0.0, doc="scale errors, 1 sigma")
    gyro_alignment: float = parameter(
        0.01, unit="rad", low=0.0, doc="angle of the attitude sensor against the gyro, 1 sigma"
    )
    gyro_scale_walk: float = parameter(
        3e-5, unit="1/sqrt(rad)", low=0.0, doc="random walk of both, by rotation"
    )
    delay: float = parameter(0.01, unit="s", low=0.0, doc="delay of attitude against gyro, 1 sigma")
    threshold: float = parameter(5.5, unit="1", low=1.0, doc="standard deviations at which an axis is faulty")
    anchor_age: float = parameter(6.0, unit="s", low=0.1, doc="how old an anchor gets")
    tracking: float = parameter(0.06, unit="s", low=1e-3, doc="averaging time of the estimate of a fault")
    recovery: float = parameter(0.6, unit="s", low=0.0, doc="how long a faulty axis must look healthy")
    patience: float = parameter(120.0, unit="s", low=1.0, doc="after which a fault that stands still ends")

    def init(self, inputs: FaultObserverInputs) -> State:
        """Start on the measurement, with the gyro unknown but for its data sheet."""
        imu = inputs.imu
        zeros = namespace(imu.body_rate).zeros_like(imu.body_rate)
        estimate = inertial_filter.start_filter(imu.q_xyzw, self.first_covariance)
        return State(
            filter=estimate,
            anchors=anchors.set_anchors(estimate.P),
            gyro=imu.body_rate,
            gyro_before=imu.body_rate,
            activity=zeros[..., :1],
            motion=zeros[..., :1],
            noise=sensor_noise.start_noise(zeros),
            evidence=residual_tests.start_evidence(zeros),
            faulty=zeros > 1.0,
            passing=zeros > 1.0,
            track=fault_track.start_track(zeros),
            raw=zeros[..., :1] + 1.0,
            rejected=zeros > 1.0,
            outliers=zeros,
            gravity=gravity.start_gravity(zeros),
            coasting=coasting.start_coasting(zeros),
        )

    def resumed(self, inputs: FaultObserverInputs, last: fault_observer.LastDiagnosis) -> State:
        """Resume with the gyro bias as it was, and with the faults taken off the faulty axes."""
        xp, faulty = namespace(inputs.imu.body_rate), last.faulty
        fault = where(faulty, last.fault, 0.0)
        fresh = Supervised.init(self, without_fault(inputs, fault))  # also for an observer that extends it
        # the angles of faulty axes are known as well as their faults, the bias better than at a start
        known = larger(last.std_dev, 0.0) ** 2 + sensor_noise.WHITE**2
        rotation = where(faulty, known, (UNKNOWN * sensor_noise.WHITE) ** 2)
        variances = xp.concatenate([rotation, xp.full_like(fault, KEPT**2)], axis=-1)
        P = fresh.filter.P * OF_REST + (variances @ np.eye(BIAS.stop, SIZE))[..., None] * np.eye(SIZE)
        x = xp.concatenate([-last.gyro_correction, fresh.filter.x[..., 3:]], axis=-1)
        return fresh._replace(
            filter=fresh.filter._replace(x=x, P=P),
            anchors=anchors.set_anchors(P),
            faulty=faulty,
            track=fresh.track._replace(
                fault=fault, means=xp.stack([fault, fault], axis=-1), age=where(faulty, last.since, 0.0)
            ),
            raw=xp.zeros_like(fresh.raw),
        )

    def bias_of(self, state: State) -> Vector:
        """Return the gyro bias [rad/s] of a state."""
        return state.filter.x[..., :3]

    def step(self, state: State, inputs: FaultObserverInputs, dt: float) -> tuple[State, FaultEstimate]:
        """Advance by ``dt`` [s] to the sample. An absent gyro keeps its last value."""
        imu = inputs.imu
        gyro = where(column(imu.rate_valid), imu.body_rate, state.gyro)
        ambiguous = namespace(gyro).zeros_like(gyro[..., :1], dtype=bool)
        return self.advance(state, imu, Rate(gyro, ambiguous), dt)

    def advance(self, state: State, imu: ImuSample, rate: Rate, dt: Scalar) -> tuple[State, FaultEstimate]:
        """Advance by ``dt`` [s] on a body rate in place of the sample's."""
        weights = residual_tests.averaging_weights(dt)

        # 1. Predict: the gyro carries filter and anchors to this sample.
        estimate, earlier, F, omega, activity, motion = self._predict(state, rate, dt)

        # 2. Test the residuals of the trusted axes, and learn from healthy ones.
        by_rate, known = sensor_noise.rate_weights(activity), state.noise
        reading = compare(estimate, earlier, imu, omega, known)
        tested = self._test(state, reading, by_rate, rate, weights, dt)
        evidence, scores, _, odd, noise = tested

        # 3. Declare faults; 4. track them, and judge which axes are trusted again, where there may be any.
        limits = Limits(self.threshold, self.tracking, self.recovery, self.patience)
        seen = state.faulty, state.track, estimate, earlier, reading, tested, known, by_rate, dt
        verdict = branch(
            any_of(state.faulty | odd)[..., 0],
            lambda: judge(limits, *seen),
            lambda: all_healthy(state.faulty, state.track, estimate, reading),
        )

        # 5. Correct the filter by the axes that are neither faulty nor suspect. Where one is faulty, correct
        # it by gravity, too, and by what swings with the vehicle.
        white = weights.white * sensor_noise.lasting(by_rate, known.colour)
        estimate, dx, factors = _correct(reading, verdict, odd, white, rate)
        trusted = ~any_of(state.faulty[..., :2])[..., 0]
        felt, horizontal, there = gravity.feel(
            state.gravity, estimate.q_xyzw, imu.specific_force, imu.force_valid, trusted, dt
        )

        def coast() -> tuple[coasting.Coasting, FilterState, inertial_filter.Errors]:
            known = _known(state, reading, verdict, felt, horizontal, there, white, rate)
            return coasting.coast(state.coasting, estimate, dx, factors, F, verdict.prediction, known, dt)

        states, estimate, dx = branch(
            any_of(verdict.faulty)[..., 0], coast, lambda: (state.coasting, estimate, dx)
        )

        # 6. Renew the anchors; restart the tests where what they remember no longer counts.
        earlier, promoted = anchors.update_anchors(
            earlier, estimate.P, dx, verdict.restart, verdict.hold, dt, self.anchor_age
        )
        # the filter's own correction is no change of the sensor
        shift = measurement.turned_angles(verdict.prediction, dx)
        outdated = verdict.faulty | verdict.recovered | verdict.restart | (dt > GAP)
        evidence = residual_tests.update_evidence(
            evidence._replace(base=evidence.base - shift), verdict.residual - shift, promoted, outdated
        )
        starting = verdict.bias > STARTED**2
        after = State(
            filter=estimate,
            anchors=earlier,
            gyro=rate.value,
            gyro_before=state.gyro,
            activity=activity,
            motion=motion,
            noise=sensor_noise.settle_noise(noise, promoted, verdict.alarm, verdict.short, by_rate),
            evidence=evidence,
            faulty=verdict.faulty,
            passing=reading.valid & ~reading.testable & PITCH,
            track=verdict.track,
            raw=where(starting, state.raw, state.raw * exp(-dt / FADING)),
            rejected=scores.outlier,
            outliers=_count_outliers(state, scores.outlier, verdict.faulty, verdict.short),
            gravity=felt,
            coasting=states,
        )
        return after, self._report(after, imu, scores.suspect, starting, verdict, reading)

    def _test(
        self,
        state: State,
        reading: Reading,
        by_rate: sensor_noise.Weights,
        rate: Rate,
        weights: residual_tests.AveragingWeights,
        dt: Scalar,
    ) -> Tested:
        """Test the residuals of the trusted axes, and learn from those that are healthy."""
        known, gain = state.noise, reading.prediction.gain
        spread = product(reading.predicted, weights.predicted) * known.seen
        trusted = ~state.faulty & reading.testable
        # across a pole the residual of pitch changes its sign
        evidence = residual_tests.restart(state.evidence, reading.residuals[..., 0], state.passing)
        evidence, scores, squares = residual_tests.collect_evidence(
            *(evidence, reading.residuals, reading.sensor + spread, known.colour, trusted),
            *(weights, dt, self.threshold),
        )
        odd = scores.suspect | scores.outlier
        sound = trusted & ~odd
        if rate.doubt is not None:
            sound = sound & (rate.doubt == 0.0)
        noise = sensor_noise.learn_noise(known, squares, gain, spread, by_rate, sound, dt)
        return Tested(evidence, scores, trusted, odd, noise)

    def describe(self, state: State) -> dict[str, Vector]:
        """Return what is learned of the sensor and counted, for people, by name and axis."""
        noise_deg = sqrt(state.noise.exact) / DEG
        return {
            "outliers": state.outliers,
            "noise_deg": noise_deg[..., sensor_noise.SAMPLE],
            "slow_noise_deg": noise_deg[..., sensor_noise.LONG],
        }

    @prepared
    def first_covariance(self) -> NDArray[np.float64]:
        """Covariance (16, 16) of the error state before the first measurement."""
        gyro = self.gyro_bias, self.gyro_scale, self.gyro_alignment
        return inertial_filter.start_covariance(UNKNOWN * sensor_noise.WHITE, *gyro, self.delay)

    def _predict(
        self, state: State, rate: Rate, dt: Scalar
    ) -> tuple[FilterState, anchors.Anchors, Transition, Vector, Column, Column]:
        """Carry filter and anchors by the mean of two gyro samples.

        Also return the transition, rate, activity and motion.
        """
        gyro = rate.value
        omega, change = estimate_rate(state.filter.x, gyro), gyro - state.gyro
        measured = norm(gyro)
        activity = larger(norm(omega), state.activity * exp(-dt / MOVED))
        motion = clip((activity - RESTING) / (MOVING - RESTING), 0.0, 1.0)
        bend = norm(change - (state.gyro - state.gyro_before))
        walk = (self.gyro_noise**2 + (self.gyro_moving * measured) ** 2) * dt
        walk = walk + (MISSED * dt * larger(bend - KNOCK, 0.0)) ** 2
        # by how far off the rate may be in a gap
        walk = walk + where(dt > GAP, ((0.5 * norm(change) + 0.1 * measured) * dt) ** 2, 0.0)
        bias = self.gyro_bias_walk**2 * dt + self.gyro_shift**2 * abs(motion - state.motion)
        scale = self.gyro_scale_walk**2 * measured * dt
        noise = ProcessNoise(walk if rate.doubt is None else walk + rate.doubt, bias, scale)
        mean = gyro - 0.5 * change
        estimate, P, F = inertial_filter.predict(state.filter, state.anchors.P, mean, change, noise, dt)
        earlier = anchors.Anchors(F.of(state.anchors.corrections), P, state.anchors.age)
        return estimate, earlier, F, omega, activity, motion

    def _report(
        self, state: State, imu: ImuSample, suspect: Mask, starting: Mask, verdict: Verdict, reading: Reading
    ) -> FaultEstimate:
        faulty, track = state.faulty, state.track
        omega = estimate_rate(state.filter.x, state.gyro)
        corrected = correct_sample(imu, state.filter.q_xyzw, omega + state.raw * (state.gyro - omega))
        started = where(suspect, samples.SUSPECT, samples.HEALTHY)
        trusted = where(starting, samples.STARTING, started)
        out = where(track.calm > SHOWN * self.recovery, samples.RECOVERING, samples.FAULTY)
        states = where(faulty, out, trusted).astype(namespace(track.fault).uint8)
        tracked = where(faulty, fault_track.track_variance(track, reading.sensor), 0.0)
        # an outlier is a fault of one sample
        fault = track.fault + where(state.rejected & ~faulty, verdict.residual, 0.0)
        std_dev = sqrt(larger(verdict.predicted, 0.0) + tracked)
        return FaultEstimate(fault, std_dev, states, where(faulty, track.age, -1.0), corrected)


def _correct(
    reading: Reading, verdict: Verdict, odd: Mask, white: Vector, rate: Rate
) -> tuple[FilterState, inertial_filter.Errors, inertial_filter.Factors]:
    """Correct the filter by the axes that are neither faulty nor ``odd``; also return correction and factors.

    ``white`` is of `noise_of`.
    """
    used, noise = reading.valid & ~(verdict.faulty | odd), noise_of(reading, white)
    before, prediction, residual = verdict[:3]
    after, dx, factors = inertial_filter.correct(before, prediction, residual, noise, used)
    if rate.doubt is None:
        return after, dx, factors
    return *inertial_filter.keep_gyro(before, after, dx, any_of(rate.doubt > 0.0)), factors


def _known(
    state: State,
    reading: Reading,
    verdict: Verdict,
    felt: gravity.Gravity,
    horizontal: gravity.Horizontal,
    there: Flag,
    white: Vector,
    rate: Rate,
) -> coasting.Known:
    """Return what is known where an axis is faulty."""
    anew, counts = verdict.restart, column(there)
    if rate.doubt is not None:  # the virtual gyro's errors are others
        virtual = any_of(rate.doubt > 0.0)
        anew, counts = anew | virtual, counts & ~virtual
    fresh = anew | ~state.faulty | (verdict.track.samples < 1.0)
    begins = anew | ~(counts & any_of(state.faulty[..., :2]))
    seen = verdict.residual, noise_of(reading, white), reading.valid, verdict.faulty
    return coasting.Known(felt, horizontal, counts, *seen, fresh, begins, rate.ambiguous)


def _count_outliers(state: State, outlier: Mask, faulty: Mask, short: Mask) -> Vector:
    """Count an outlier when the next sample agrees, and a burst of them when its fault has ended soon."""
    return state.outliers + ((state.rejected & ~outlier & ~faulty) | short)
