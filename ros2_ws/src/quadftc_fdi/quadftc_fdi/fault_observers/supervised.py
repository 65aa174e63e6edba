r"""Supervised diagnosis: learn the gyro while the attitude is healthy, fly on the gyro while it is not.

What the paper's observer lacks on a real gyro (docs/theory.md, sections 4 and 8) is a knowledge of the gyro's
bias. Here a Kalman filter (`quadftc_fdi.inertial_filter`) estimates bias, scale, alignment and delay of the
gyro against the attitude of the healthy axes. Tests (`quadftc_fdi.supervision`) watch its residuals:

    STARTING -> HEALTHY <-> SUSPECT -> FAULTY <-> RECOVERING -> HEALTHY

* SUSPECT: a test is above its level of suspicion. The axis is not used to correct the filter.
* FAULTY: a test is above its threshold. What the filter has taken from the fault so far is undone: it goes
  back to an anchor, a state of some seconds ago, at most ``anchor_age``, that has run on the gyro since. From
  then on the axis is dead-reckoned; measured minus dead-reckoned angle is the fault, the filter's covariance
  its uncertainty.
* RECOVERING: the fault is within what dead reckoning knows, and stands still; after ``recovery`` seconds the
  axis is trusted again. A fault that stands still for ``patience`` seconds is taken for an error of ours.

The anchors are two, of which the younger becomes the older every half ``anchor_age``, so memory and work of
a step are constant. They are kept as the correction (..., 16) that the filter has received since: it follows
the transition of the error state, so the anchor's residual is that of the filter plus H times it.

The defaults are for a MEMS IMU on a vehicle that moves, with an attitude that wanders (optical markers, a
filter). A simulated sensor without such errors is described by ``wander = wander_moving = gyro_moving = 0``.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.dead_reckoning import comparable
from quadftc_fdi.fault_observer import FaultObserver, register
from quadftc_fdi.inertial_filter import (
    BIAS,
    IDENTITY,
    ROTATION,
    SIZE,
    FilterState,
    initial,
    measurement_matrix,
    predicted_angles,
    propagated,
    rate,
    shifted,
    updated,
)
from quadftc_fdi.supervision import (
    OLD,
    ROLLED,
    YOUNG,
    Findings,
    Settings,
    Sizes,
    Tests,
    Track,
    Weights,
    recovered,
    spread_of,
    tested,
    tracked,
    weights,
)
from quadftc_model.arrays import Array, namespace, norm
from quadftc_model.conditions import Circumstances, Condition, Verdict
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
STARTED = 0.1 * DEG  # rad/s; the gyro bias is known to this when the observer has started
MOVING = 0.35  # rad/s; from here on a vehicle moves, as far as the sensor's slow error goes
MOVED = 1.0  # s; how long it counts as moving afterwards (time constant)
SHOWN = 0.3  # 1; share of the recovery time from which an axis is shown as recovering
TURNING = np.array([1.0] * 3 + [0.0] * (SIZE - 3))
ANCHORS = np.array([0.0, 0.0, 0.0, 1.0, 1.0])


class Anchors(NamedTuple):
    """Two earlier states of the filter, relative to it; columns as of the tests' averages."""

    ahead: Array  # (..., 16, 5) corrections since; the first three columns are zero
    P: Array  # (..., 2, 16, 16) covariance now, the older first
    age: Array  # (..., 1) of the younger [s]


class SupervisedState(NamedTuple):
    """Observer state at the last sample."""

    filter: FilterState
    anchors: Anchors
    gyro: Array  # (..., 3) [rad/s]
    activity: Array  # (..., 1) decaying maximum of the body rate [rad/s]
    tests: Tests
    faulty: Array  # (..., 3) bool
    track: Track


class _Sample(NamedTuple):
    """A sample against the filter, propagated to it."""

    H: Array  # (..., 3, 16)
    residuals: Array  # (..., 3, 5) [rad]
    sizes: Sizes
    activity: Array  # (..., 1)
    comparable: Array  # (..., 1) bool: away from 90 deg of pitch


@register("supervised")
@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Supervised(FaultObserver):
    """Estimates the gyro's errors while an axis is healthy, and dead-reckons it while it is not."""

    attitude_noise: float = parameter(
        0.1 * DEG, unit="rad", low=1e-6, doc="white noise of the attitude, 1 sigma of a sample"
    )
    wander: float = parameter(0.06 * DEG, unit="rad", low=0.0, doc="slow error of the attitude, 1 sigma")
    wander_moving: float = parameter(0.25 * DEG, unit="rad", low=0.0, doc="the same while moving")
    wander_memory: float = parameter(0.15, unit="s", low=1e-3, doc="correlation time of the slow error")
    gyro_noise: float = parameter(0.007 * DEG, unit="rad/sqrt(s)", low=1e-8, doc="angle random walk N")
    gyro_moving: float = parameter(0.004, unit="sqrt(s)", low=0.0, doc="what N grows by per body rate")
    gyro_bias: float = parameter(1.5 * DEG, unit="rad/s", low=1e-6, doc="turn-on gyro bias, 1 sigma")
    gyro_bias_walk: float = parameter(2e-4 * DEG, unit="rad/s/sqrt(s)", low=0.0, doc="rate random walk K")
    gyro_scale: float = parameter(0.01, unit="1", low=0.0, doc="scale and alignment errors, 1 sigma")
    delay: float = parameter(0.01, unit="s", low=0.0, doc="delay of attitude against gyro, 1 sigma")
    threshold: float = parameter(5.3, unit="1", low=1.0, doc="standard deviations at which an axis is faulty")
    anchor_age: float = parameter(6.0, unit="s", low=0.1, doc="how old an anchor gets")
    learning: float = parameter(200.0, unit="s", low=1.0, doc="time over which residuals are learned")
    tracking: float = parameter(0.06, unit="s", low=1e-3, doc="averaging time of the estimate of a fault")
    recovery: float = parameter(0.6, unit="s", low=0.0, doc="how long a faulty axis must look healthy")
    patience: float = parameter(120.0, unit="s", low=1.0, doc="after which a fault that stands still ends")

    def conditions(self, given: Circumstances) -> list[Condition]:
        """Judge what it asks for: a gyro without faults, and attitudes away from 90 deg of pitch."""
        gyro = "gyro" in given.faulty_channels
        return [
            Condition(
                "gyro without fault",
                Verdict.FAIL if gyro else Verdict.PASS,
                "the scenario puts a fault on it" if gyro else "its bias, scale and delay are estimated",
            ),
            Condition(
                "healthy start",
                Verdict.DEPENDS,
                "a fault that is there at the first sample is taken for the attitude",
                needed=False,
            ),
        ]

    def init(self, inputs: FaultObserverInputs) -> SupervisedState:
        """Start on the measurement, with the gyro unknown but for its data sheet."""
        imu = inputs.imu
        xp = namespace(imu.body_rate)
        start = initial(imu.q_xyzw, self._start())
        zeros = xp.zeros_like(imu.body_rate)
        batch = zeros.shape[:-1]
        anchors = Anchors(
            xp.zeros((*batch, SIZE, 5)), xp.stack([start.P, start.P], axis=-3), xp.zeros((*batch, 1))
        )
        tests = Tests(xp.zeros((*batch, 3, 5)), xp.ones((*batch, 3, 5)), xp.zeros((*batch, 3, 2)), zeros)
        track = Track(zeros, zeros, zeros, xp.zeros((*batch, 3, 2)), zeros, zeros)
        moving = norm(imu.body_rate)
        return SupervisedState(start, anchors, imu.body_rate, moving, tests, zeros > 1.0, track)

    def step(
        self, state: SupervisedState, inputs: FaultObserverInputs, dt: float
    ) -> tuple[SupervisedState, FaultEstimate]:
        """Advance by ``dt`` [s] to the sample."""
        imu = inputs.imu
        xp = namespace(imu.body_rate)
        w = weights(dt, self.wander_memory, self.tracking)
        settings = Settings(self.threshold, self.learning, self.recovery, self.patience)
        gyro = xp.where(imu.rate_valid[..., None], imu.body_rate, state.gyro)
        estimate, anchors = self._propagated(state, gyro, dt)
        sample = self._compared(estimate, anchors, imu.q_xyzw, gyro, state.activity, dt)
        valid = imu.attitude_valid[..., None] & sample.comparable
        tests, found = tested(
            state.tests, sample.residuals, sample.sizes, ~state.faulty & valid, w, dt, settings
        )
        back = xp.any(found.alarm, axis=-1)[..., None]
        estimate, residual, own = _gone_back(estimate, anchors, sample, found)
        faulty = state.faulty | found.alarm
        track = tracked(state.track, residual, sample.sizes, found.alarm, valid, w, dt)
        since = xp.where(found.alarm, tests.suspicion, state.track.since + dt)
        spread = spread_of(sample.sizes, tests.learned, w)
        bias = xp.max(xp.diagonal(estimate.P, axis1=-2, axis2=-1)[..., BIAS], axis=-1)[..., None]
        track, trusted_again, given_up = recovered(
            track._replace(since=since), faulty, own, spread, bias, settings, dt
        )
        faulty = faulty & ~trusted_again
        estimate = _doubted(estimate, residual * given_up)
        anew = back | xp.any(given_up, axis=-1)[..., None]
        variance = sample.sizes.white + sample.sizes.slow * w.white_equivalent
        used = valid & ~faulty & ~found.suspect
        estimate, dx = updated(estimate, sample.H, residual, variance, used)
        anchors, rolled = self._kept(anchors, estimate, dx, anew, found, dt)
        means = xp.where(rolled[..., None], tests.means @ ROLLED, tests.means)
        watched = ~(faulty | trusted_again | anew)[..., None]
        tests = tests._replace(means=means * watched, sums=tests.sums * watched)
        new = SupervisedState(estimate, anchors, gyro, sample.activity, tests, faulty, _only(track, faulty))
        starting = bias > STARTED**2
        return new, self._report(new, found.suspect, starting, own, sample.sizes, w, inputs)

    def _propagated(self, state: SupervisedState, gyro: Array, dt: float) -> tuple[FilterState, Anchors]:
        """Filter and anchors, turned by the gyro to the sample."""
        xp = namespace(gyro)
        moving = (self.gyro_moving * norm(gyro)) ** 2 * dt
        noise = _noise(self.gyro_noise, self.gyro_bias_walk, dt) + moving * TURNING
        estimate, F = propagated(state.filter, 0.5 * (gyro + state.gyro), noise, dt)
        both = F[..., None, :, :]
        P = both @ state.anchors.P @ xp.swapaxes(both, -1, -2) + noise[..., None, :, None] * IDENTITY
        return estimate, state.anchors._replace(ahead=F @ state.anchors.ahead, P=P)

    def _compared(
        self,
        estimate: FilterState,
        anchors: Anchors,
        q_xyzw: Array,
        gyro: Array,
        activity: Array,
        dt: float,
    ) -> _Sample:
        """Residuals of filter and anchors, and how large they may be."""
        xp = namespace(gyro)
        omega = rate(estimate.x, gyro)
        angles = euler_from_quaternion(estimate.q_xyzw)
        H = measurement_matrix(angles, omega)
        measured = euler_from_quaternion(q_xyzw)
        residual = wrap(measured - predicted_angles(estimate, angles, H))
        residuals = residual[..., None] + H @ anchors.ahead
        activity = xp.maximum(norm(omega), activity * math.exp(-dt / MOVED))
        slow = self.wander + (self.wander_moving - self.wander) * xp.minimum(activity / MOVING, 1.0)
        white = self.attitude_noise**2 * xp.sum(H[..., ROTATION] ** 2, axis=-1)
        own = _variance(H, estimate.P)
        of_anchors = xp.swapaxes(_variance(H[..., None, :, :], anchors.P), -1, -2)
        sizes = Sizes(white, slow**2 + 0.0 * white, own, of_anchors)
        return _Sample(H, residuals, sizes, activity, comparable(angles, measured))

    def _kept(
        self,
        anchors: Anchors,
        estimate: FilterState,
        dx: Array,
        anew: Array,
        found: Findings,
        dt: float,
    ) -> tuple[Anchors, Array]:
        """Anchors after a correction; they begin anew where told to, and roll on when of age."""
        xp = namespace(dx)
        now = estimate.P[..., None, :, :]
        ahead = (anchors.ahead + dx[..., None] * ANCHORS) * ~anew[..., None]
        covariance = xp.where(anew[..., None, None], now, anchors.P)
        age = (anchors.age + dt) * ~anew
        rolled = (age > 0.5 * self.anchor_age) & ~xp.any(found.suspect, axis=-1)[..., None]
        ahead = xp.where(rolled[..., None], ahead @ ROLLED, ahead)
        renewed = xp.concatenate([covariance[..., 1:, :, :], now], axis=-3)
        covariance = xp.where(rolled[..., None, None], renewed, covariance)
        return Anchors(ahead, covariance, age * ~rolled), rolled

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
        trusted = xp.where(starting, STARTING, xp.where(suspect, SUSPECT, HEALTHY))
        out = xp.where(track.calm > SHOWN * self.recovery, RECOVERING, FAULTY)
        noise = (sizes.white + sizes.slow) * xp.maximum(w.alpha, 1.0 / (track.count + 1.0))
        corrected = imu._replace(
            q_xyzw=state.filter.q_xyzw,
            body_rate=rate(state.filter.x, state.gyro),
            attitude_valid=xp.ones_like(imu.attitude_valid),
        )
        return FaultEstimate(
            fault=track.fault,
            std_dev=xp.sqrt(xp.maximum(own, 0.0) + faulty * noise),
            state=xp.where(faulty, out, trusted).astype(xp.uint8),
            onset_age=xp.where(faulty, track.since, -1.0),
            corrected=corrected,
        )

    def _start(self) -> NDArray[np.float64]:
        """Standard deviations of the error state at the start (16,)."""
        attitude = max(self.attitude_noise, self.wander)
        parts = ([attitude] * 3, [self.gyro_bias] * 3, [self.gyro_scale] * 9, [self.delay])
        return np.concatenate([np.asarray(part) for part in parts])


def _gone_back(
    estimate: FilterState, anchors: Anchors, sample: _Sample, found: Findings
) -> tuple[FilterState, Array, Array]:
    """The filter, its residual and the variance of its angles, back at an anchor where an axis turned faulty.

    At the younger one if all faults are abrupt: less is lost.
    """
    xp = namespace(found.alarm)
    back = xp.any(found.alarm, axis=-1)[..., None]
    far = xp.any(found.slow, axis=-1)[..., None]

    def chosen(now: Array, young: Array, old: Array) -> Array:
        extra = (None,) * (now.ndim - back.ndim)
        return xp.where(back[(..., *extra)], xp.where(far[(..., *extra)], old, young), now)

    ahead, residuals, of_anchors = anchors.ahead, sample.residuals, sample.sizes.anchors
    dx = chosen(xp.zeros_like(ahead[..., 0]), ahead[..., YOUNG], ahead[..., OLD])
    P = chosen(estimate.P, anchors.P[..., 1, :, :], anchors.P[..., 0, :, :])
    residual = chosen(residuals[..., 0], residuals[..., YOUNG], residuals[..., OLD])
    own = chosen(sample.sizes.own, of_anchors[..., 1], of_anchors[..., 0])
    return shifted(estimate._replace(P=P), -dx), residual, own


def _doubted(estimate: FilterState, residual: Array) -> FilterState:
    """The filter with its rotation in doubt by a residual (..., 3) that is to be believed."""
    doubt = namespace(residual).sum(residual**2, axis=-1)
    return estimate._replace(P=estimate.P + doubt[..., None, None] * (TURNING * IDENTITY))


def _variance(H: Array, P: Array) -> Array:
    """Diagonal of H P H'."""
    xp = namespace(H)
    return xp.sum((H @ P) * H, axis=-1)


def _only(track: Track, faulty: Array) -> Track:
    """Forget the fault of axes that have none."""
    return Track(
        fault=track.fault * faulty,
        slope=track.slope * faulty,
        count=track.count,
        means=track.means * faulty[..., None],
        since=track.since * faulty,
        calm=track.calm * faulty,
    )


@functools.lru_cache(maxsize=64)
def _noise(walk: float, bias_walk: float, dt: float) -> NDArray[np.float64]:
    """Variance that a step adds to the error state (16,)."""
    found = np.zeros(SIZE)
    found[ROTATION], found[BIAS] = walk**2 * dt, bias_walk**2 * dt
    found.setflags(write=False)
    return found
