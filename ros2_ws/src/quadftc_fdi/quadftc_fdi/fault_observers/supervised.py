r"""Supervised diagnosis: learn the gyro while the attitude is healthy, fly on the gyro while it is not.

What the paper's observer lacks on a real gyro (docs/theory.md, sections 4 and 8) is a knowledge of the gyro's
bias. Here a Kalman filter (`quadftc_fdi.inertial_filter`) estimates bias, scale, alignment and delay of the
gyro against the attitude of the healthy axes. Tests (`quadftc_fdi.supervision`) watch its residuals:

    STARTING -> HEALTHY <-> SUSPECT -> FAULTY <-> RECOVERING -> HEALTHY

* SUSPECT: a test is above its level of suspicion. The axis is not used to correct the filter.
* FAULTY: a test is above its threshold. Unless the fault came suddenly, what the filter has taken from it is
  undone: it goes back to an anchor (`quadftc_fdi.anchors`), a state of at most ``anchor_age`` ago that has
  run on the gyro since. From then on the axis is dead-reckoned; measured minus dead-reckoned angle is the
  fault, the filter's covariance its uncertainty.
* RECOVERING: the fault is within what dead reckoning knows, and stands still; after ``recovery`` seconds the
  axis is trusted again, after several times that if the fault never visibly moved. A fault that stands
  still for ``patience`` seconds is taken for an error of ours.

The defaults are for a MEMS IMU on a vehicle that moves, with an attitude that wanders (optical markers, a
filter), and a gyro whose bias changes a little when it starts to move. A simulated sensor without such errors
is described by ``wander = wander_moving = gyro_moving = gyro_shift = 0``.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.anchors import Anchors, anchored, carried, own_variances, renewed, returned
from quadftc_fdi.dead_reckoning import comparable
from quadftc_fdi.fault_observer import FaultObserver, LastWords, register, without_fault
from quadftc_fdi.inertial_filter import (
    MEASURED,
    ROTATION,
    FilterState,
    bias_variance,
    initial,
    measurement_matrix,
    predicted_angles,
    process_noise,
    propagated,
    rate,
    updated,
)
from quadftc_fdi.supervision import (
    Settings,
    Sizes,
    Tests,
    Track,
    Weights,
    begun_anew,
    recovered,
    spread_of,
    tested,
    track_of,
    tracked,
    weights,
)
from quadftc_model.arrays import Array, any_of, changed_where, exp, namespace, norm, product
from quadftc_model.parameters import parameter
from quadftc_model.rotations import euler_from_quaternion, wrap
from quadftc_model.samples import (
    FAULTY,
    HEALTHY,
    RECOVERING,
    STARTING,
    SUSPECT,
    FaultEstimate,
    FaultObserverInputs,
)

DEG = math.pi / 180.0
UNKNOWN = 10.0  # 1; standard deviations of the attitude's noise: as good as nothing known
STARTED = 0.1 * DEG  # rad/s; the gyro bias is known to this when the observer has started
KEPT = 0.05 * DEG  # rad/s; a gyro bias taken over from an observer that has died is known to this
RESTING = 0.1  # rad/s; below, a vehicle rests
MOVING = 0.35  # rad/s; from here on a vehicle moves, as far as the sensor's slow error goes
MOVED = 8.0  # s; how long it counts as moving afterwards (time constant)
FADING = (
    2.0  # s; in which a gyro bias just found leaves the corrected rate: at once, it would jolt the flight
)
# s; longer than the period of any IMU: what the rate was in it is guessed, and what is off by that is not
# averaged with what follows
GAP = 0.15
SHOWN = 0.3  # 1; share of the recovery time from which an axis is shown as recovering
# what a wrong rotation has made wrong: itself, the bias by as much at a rate of 0.1 rad/s, the alignment
DOUBTED = np.diag([1.0] * 3 + [0.1**2] * 3 + [1.0] * 9 + [0.0])


class SupervisedState(NamedTuple):
    """Observer state at the last sample."""

    filter: FilterState
    anchors: Anchors
    gyro: Array  # (..., 3) [rad/s]
    activity: Array  # (..., 1) decaying maximum of the body rate [rad/s]
    motion: Array  # (..., 1) rest 0, motion 1
    tests: Tests
    faulty: Array  # (..., 3) bool
    track: Track
    raw: Array  # (..., 1) share of the gyro as it is in the corrected body rate


class _Sample(NamedTuple):
    """A sample against the filter, propagated to it."""

    H: Array  # (..., 3, 16)
    residuals: Array  # (..., 3, 5) [rad]
    sizes: Sizes
    comparable: Array  # (..., 1) bool: away from 90 deg of pitch


@register("supervised")
@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Supervised(FaultObserver):
    """Estimates the gyro's errors while an axis is healthy, and dead-reckons it while it is not."""

    attitude_noise: float = parameter(
        0.1 * DEG, unit="rad", low=1e-6, doc="white noise of the attitude, 1 sigma of a sample"
    )
    wander: float = parameter(0.1 * DEG, unit="rad", low=0.0, doc="slow error of the attitude, 1 sigma")
    wander_moving: float = parameter(0.2 * DEG, unit="rad", low=0.0, doc="the same while moving")
    wander_memory: float = parameter(0.15, unit="s", low=1e-3, doc="correlation time of the slow error")
    gyro_noise: float = parameter(0.007 * DEG, unit="rad/sqrt(s)", low=1e-8, doc="angle random walk N")
    gyro_moving: float = parameter(0.001, unit="sqrt(s)", low=0.0, doc="what N grows by per body rate")
    gyro_shift: float = parameter(
        0.02 * DEG, unit="rad/s", low=0.0, doc="what motion adds to the gyro bias, 1 sigma"
    )
    gyro_bias: float = parameter(1.5 * DEG, unit="rad/s", low=1e-6, doc="turn-on gyro bias, 1 sigma")
    gyro_bias_walk: float = parameter(2e-4 * DEG, unit="rad/s/sqrt(s)", low=0.0, doc="rate random walk K")
    gyro_scale: float = parameter(0.01, unit="1", low=0.0, doc="scale and alignment errors, 1 sigma")
    delay: float = parameter(0.01, unit="s", low=0.0, doc="delay of attitude against gyro, 1 sigma")
    threshold: float = parameter(5.5, unit="1", low=1.0, doc="standard deviations at which an axis is faulty")
    anchor_age: float = parameter(6.0, unit="s", low=0.1, doc="how old an anchor gets")
    learning: float = parameter(200.0, unit="s", low=1.0, doc="time over which residuals are learned")
    tracking: float = parameter(0.06, unit="s", low=1e-3, doc="averaging time of the estimate of a fault")
    recovery: float = parameter(0.6, unit="s", low=0.0, doc="how long a faulty axis must look healthy")
    patience: float = parameter(120.0, unit="s", low=1.0, doc="after which a fault that stands still ends")

    def init(self, inputs: FaultObserverInputs) -> SupervisedState:
        """Start on the measurement, with the gyro unknown but for its data sheet."""
        imu = inputs.imu
        xp = namespace(imu.body_rate)
        start = initial(imu.q_xyzw, self._start())
        zeros = xp.zeros_like(imu.body_rate)
        batch = zeros.shape[:-1]
        tests = Tests(xp.zeros((*batch, 3, 5)), xp.ones((*batch, 3, 5)), xp.zeros((*batch, 3, 2)), zeros)
        track = Track(zeros, zeros, zeros, zeros, xp.zeros((*batch, 3, 2)), zeros, zeros)
        rest = xp.zeros((*batch, 1))
        anchors = anchored(start.P)
        return SupervisedState(
            start, anchors, imu.body_rate, rest, rest, tests, zeros > 1.0, track, rest + 1.0
        )

    def resumed(self, inputs: FaultObserverInputs, last: LastWords) -> SupervisedState:
        """Go on with the gyro bias as it was, and with faulty axes at what is left without their fault."""
        xp = namespace(inputs.imu.body_rate)
        faulty = xp.asarray(last.faulty)
        fault = last.fault * faulty
        fresh = self.init(without_fault(inputs, fault))
        deviations = xp.zeros((*fault.shape[:-1], 16)) + self._start()
        known = xp.sqrt(xp.maximum(last.std_dev, 0.0) ** 2 + self.attitude_noise**2)
        rotation = xp.where(faulty, known, deviations[..., ROTATION])
        bias = xp.zeros_like(fault) + KEPT
        deviations = xp.concatenate([rotation, bias, deviations[..., 6:]], axis=-1)
        x = xp.concatenate([-last.gyro_correction, fresh.filter.x[..., 3:]], axis=-1)
        P = deviations[..., None] ** 2 * np.eye(16)
        track = fresh.track._replace(
            fault=fault, means=xp.stack([fault, fault], axis=-1), since=last.since * faulty
        )
        return fresh._replace(
            filter=fresh.filter._replace(x=x, P=P),
            anchors=anchored(P),
            faulty=faulty,
            track=track,
            raw=fresh.raw * 0.0,
        )

    def step(
        self, state: SupervisedState, inputs: FaultObserverInputs, dt: float
    ) -> tuple[SupervisedState, FaultEstimate]:
        """Advance by ``dt`` [s] to the sample."""
        imu = inputs.imu
        xp = namespace(imu.body_rate)
        w = weights(dt, self.wander_memory, self.tracking)
        settings = Settings(self.threshold, self.learning, self.recovery, self.patience)
        gyro = xp.where(imu.rate_valid[..., None], imu.body_rate, state.gyro)
        omega = rate(state.filter.x, gyro)
        activity = xp.maximum(norm(omega), state.activity * exp(-dt / MOVED))
        motion = ((activity - RESTING) / (MOVING - RESTING)).clip(0.0, 1.0)
        estimate, anchors = self._propagated(state, gyro, motion, dt)
        sample = self._compared(estimate, anchors, imu.q_xyzw, omega, motion)
        valid = imu.attitude_valid[..., None] & sample.comparable
        tests, found = tested(
            state.tests, sample.residuals, sample.sizes, ~state.faulty & valid, w, dt, settings
        )
        late = found.alarm & ~found.sudden
        estimate, residual, own = returned(
            estimate, anchors, sample.residuals, sample.sizes.own, late, found.slow, STARTED
        )
        faulty = state.faulty | found.alarm
        bias = bias_variance(estimate.P)

        def watched_faults() -> tuple[Track, Array, Array]:
            track = tracked(state.track, residual, sample.sizes, found.alarm, valid, w, dt)
            since = xp.where(found.alarm, tests.suspicion, state.track.since + dt)
            spread = spread_of(sample.sizes, tests.learned, w)
            track, again, given_up = recovered(
                track._replace(since=since), faulty, own, spread, bias, settings, dt
            )
            return track_of(track, faulty & ~again), again, given_up

        track, again, given_up = changed_where(faulty, watched_faults, (state.track, faulty, faulty))
        faulty = faulty & ~again
        estimate = changed_where(given_up, lambda: _doubted(estimate, residual * given_up), estimate)
        anew = any_of(late | given_up)
        variance = sample.sizes.noise + sample.sizes.slow * w.white_equivalent
        used = valid & ~faulty & ~found.suspect
        estimate, dx = updated(estimate, sample.H, residual, variance, used)
        anchors, rolled = renewed(anchors, estimate.P, dx, anew, any_of(found.suspect), dt, self.anchor_age)
        tests = begun_anew(tests, rolled, faulty | again | anew | (dt > GAP))
        starting = bias > STARTED**2
        raw = xp.where(starting, state.raw, state.raw * exp(-dt / FADING))
        new = SupervisedState(estimate, anchors, gyro, activity, motion, tests, faulty, track, raw)
        return new, self._report(new, found.suspect, starting, own, sample.sizes, w, inputs)

    def _propagated(
        self, state: SupervisedState, gyro: Array, motion: Array, dt: float
    ) -> tuple[FilterState, Anchors]:
        """Filter and anchors, turned by the gyro to the sample."""
        walk = (self.gyro_noise**2 + (self.gyro_moving * norm(gyro)) ** 2) * dt

        def guessed() -> Array:  # how far off the rate may be in a gap
            off = 0.5 * norm(gyro - state.gyro) + 0.1 * norm(gyro)
            return walk + (dt > GAP) * (off * dt) ** 2

        walked = changed_where(dt > GAP, guessed, walk)
        shift = self.gyro_bias_walk**2 * dt + self.gyro_shift**2 * abs(motion - state.motion)
        noise = process_noise(walked, shift)
        estimate, F = propagated(state.filter, 0.5 * (gyro + state.gyro), noise, dt)
        return estimate, carried(state.anchors, F, noise)

    def _compared(
        self, estimate: FilterState, anchors: Anchors, q_xyzw: Array, omega: Array, motion: Array
    ) -> _Sample:
        """Residuals of filter and anchors, and how large they may be."""
        angles = euler_from_quaternion(estimate.q_xyzw)
        H = measurement_matrix(angles, omega)
        measured = euler_from_quaternion(q_xyzw)
        residual = wrap(measured - predicted_angles(estimate, angles, H))
        residuals = residual[..., None] + product(H, anchors.ahead, MEASURED)
        slow = self.wander + (self.wander_moving - self.wander) * motion
        noise = self.attitude_noise**2 * (H[..., ROTATION] ** 2).sum(axis=-1)
        sizes = Sizes(noise, slow**2 + 0.0 * noise, own_variances(estimate.P, anchors, H))
        return _Sample(H, residuals, sizes, comparable(angles, measured))

    def _report(
        self,
        state: SupervisedState,
        suspect: Array,
        starting: Array,
        own: Array,
        sizes: Sizes,
        w: Weights,
        inputs: FaultObserverInputs,
    ) -> FaultEstimate:
        imu, faulty, track = inputs.imu, state.faulty, state.track
        xp = namespace(imu.body_rate)
        omega = rate(state.filter.x, state.gyro)
        corrected = imu._replace(
            q_xyzw=state.filter.q_xyzw,
            body_rate=omega + state.raw * (state.gyro - omega),
            attitude_valid=imu.attitude_valid | True,
        )
        trusted = xp.where(starting, STARTING, xp.where(suspect, SUSPECT, HEALTHY)).astype(xp.uint8)
        own = xp.maximum(own, 0.0)

        def of_faults() -> tuple[Array, Array, Array]:
            out = xp.where(track.calm > SHOWN * self.recovery, RECOVERING, FAULTY)
            passed = xp.maximum(w.passed, 1.0 / (track.count + 1.0))
            noise = (sizes.noise + sizes.slow) * passed
            return (
                xp.where(faulty, out, trusted).astype(xp.uint8),
                own + faulty * noise,
                xp.where(faulty, track.since, -1.0),
            )

        states, variance, age = changed_where(faulty, of_faults, (trusted, own, faulty - 1.0))
        return FaultEstimate(track.fault, xp.sqrt(variance), states, age, corrected)

    def _start(self) -> NDArray[np.float64]:
        """Standard deviations of the error state at the start (16,).

        The first step takes the attitude of the start as a measurement, so before it nothing is known of it.
        """
        attitude = UNKNOWN * max(self.attitude_noise, self.wander)
        parts = ([attitude] * 3, [self.gyro_bias] * 3, [self.gyro_scale] * 9, [self.delay])
        return np.concatenate([np.asarray(part) for part in parts])


def _doubted(estimate: FilterState, residual: Array) -> FilterState:
    """The filter with its rotation in doubt by a residual (..., 3) that is to be believed.

    And with it what it knows of the gyro: as long as the rotation was wrong, so were the axes.
    """
    doubt = namespace(residual).sum(residual**2, axis=-1)
    return estimate._replace(P=estimate.P + doubt[..., None, None] * DOUBTED)
