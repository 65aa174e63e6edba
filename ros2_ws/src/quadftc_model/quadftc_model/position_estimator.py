"""Position and velocity from the accelerometer, corrected by a position sensor that is slower and late.

A Kalman filter of p, v and the accelerometer's bias b (body axes). The specific force f and the attitude R of
the corrected IMU drive it:

    p' = v ,  v' = R (f - b) - g e3 + noise ,  b' = noise

What disturbs is taken to be alike in all directions. Then the covariance is a 3 x 3 matrix times the identity
(or R, between b and the others). One small matrix serves for all three axes, whatever the attitude.

A sample is ``delay`` old. It is compared with the prediction for its own time, p - v delay + a delay²/2, and
the gain knows how v and b enter there. The bias walks so fast that a step of the accelerometer, or of
an attitude that tilts gravity, is learnt within about a second.

A sample that is far from where it can be is not used. If none is used for ``patience``, it is the estimate
that is wrong: it begins again at the next one. Without specific force or attitude the acceleration is not
known: the estimate goes on with none, and its uncertainty grows by ``unknown_acceleration``.

A vehicle that spins turns its bias with it, faster than late and rare positions can follow. From `SLOW` to
`FAST` it is learnt less and less, then kept, and `SPIN_NOISE` says how wrong it may be.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from quadftc_model.arrays import (
    Array,
    Flag,
    Scalar,
    Vector,
    branch,
    clip,
    column,
    components,
    largest,
    length,
    stacked,
    where,
)
from quadftc_model.parameters import Checked, parameter
from quadftc_model.rotations import to_body, to_earth
from quadftc_model.samples import STANDARD_GRAVITY, UNUSABLE, ImuSample, PositionEstimate, PositionSample

FIRST_SPEED = 1.0  # m/s; how well the velocity is known at first, without a sensor of it, 1 sigma
FIRST_BIAS = 0.5  # m/s²; the same of the accelerometer's bias
SLOW, FAST = 4.0, 8.0  # rad/s; body rate from which on a bias in body axes is learnt less, and no more
SPIN_NOISE = 1.0  # m/s²/sqrt(Hz); of the acceleration then
_G = STANDARD_GRAVITY

Covariance = Sequence[Array]  # pp, pv, pb, vv, vb, bb of p, v, b, (...) each


class PositionEstimatorInputs(NamedTuple):
    """What the estimator sees."""

    imu: ImuSample  # corrected
    sample: PositionSample


class State(NamedTuple):
    """Estimate at the last sample of the IMU."""

    position: Vector  # [m]
    velocity: Vector  # [m/s]
    acceleration: Vector  # [m/s²]
    bias: Vector  # of the accelerometer, body axes [m/s²]
    covariance: Array  # (..., 6): pp, pv, pb, vv, vb, bb
    started: Flag  # a position has come
    unheard: Scalar  # since the last position that was used [s]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PositionEstimator(Checked):
    """The filter; ``delay``, noise and ``gives_velocity`` are those of the position sensor."""

    delay: float = parameter(0.0, unit="s", low=0.0, high=1.0, doc="age of a position when it comes")
    noise: float = parameter(0.002, unit="m", low=1e-4, high=100.0, doc="of a position, 1 sigma")
    gives_velocity: bool = parameter(False, doc="whether the sensor measures the velocity, too")
    velocity_noise: float = parameter(0.1, unit="m/s", low=1e-3, high=100.0, doc="of a velocity, 1 sigma")
    acceleration_noise: float = parameter(
        0.03,
        unit="m/s^2/sqrt(Hz)",
        low=0.0,
        doc="of the accelerometer, and of an attitude that tilts gravity",
    )
    bias_walk: float = parameter(
        0.5, unit="m/s^2/sqrt(s)", low=0.0, doc="how far the accelerometer's bias walks"
    )
    unknown_acceleration: float = parameter(
        3.0, unit="m/s^2/sqrt(Hz)", low=0.0, doc="noise of the acceleration where it is not measured"
    )
    gate: float = parameter(5.0, low=1.0, doc="further off, in standard deviations, a sample is not used")
    patience: float = parameter(0.5, unit="s", low=0.0, doc="without a used sample, begin again at the next")

    def init(self, inputs: PositionEstimatorInputs) -> State:
        """Wait for a position that is there; until then, at rest at the one of the sample."""
        zeros = 0.0 * inputs.imu.specific_force
        zero = zeros[..., 0]
        begin = self._unsure(zero)
        return State(
            inputs.sample.position, zeros, zeros, zeros, begin, inputs.sample.there & (zero > 0.0), zero
        )

    def step(
        self, state: State, inputs: PositionEstimatorInputs, dt: float
    ) -> tuple[State, PositionEstimate]:
        """Advance by ``dt`` [s] to a sample of the IMU."""
        new = self._predicted(state, inputs.imu, dt)
        there = inputs.sample.there & _is_usable(inputs.sample)
        new = branch(there, lambda: self._corrected(new, inputs), lambda: new)
        return new, PositionEstimate(new.position, new.velocity, new.acceleration)

    def _predicted(self, state: State, imu: ImuSample, dt: float) -> State:
        """State at the time of a sample, without a position of that time."""
        known = imu.attitude_valid & imu.force_valid
        x, y, z = components(to_earth(imu.q_xyzw, imu.specific_force - state.bias))
        acceleration = where(column(known), stacked([x, y, z - _G]), 0.0)
        gained = 0.5 * dt * (state.acceleration + acceleration)
        noise = where(known, self.acceleration_noise**2, self.unknown_acceleration**2)
        spin = _spin(imu)
        still = 1.0 - spin  # what turns with the body says nothing of the bias: it stays as it is
        noise = noise + spin * SPIN_NOISE**2
        pp, pv, pb, vv, vb, bb = _propagated(
            components(state.covariance), noise, still * self.bias_walk**2, dt
        )
        covariance = pp, pv, still * pb, vv, still * vb, bb
        return State(
            state.position + dt * (state.velocity + 0.5 * gained),
            state.velocity + gained,
            acceleration,
            state.bias,
            stacked(covariance),
            state.started,
            state.unheard + dt,
        )

    def _corrected(self, state: State, inputs: PositionEstimatorInputs) -> State:
        """State after a sample that is there."""
        sample, late = inputs.sample, self.delay
        pp, pv, pb, vv, vb, bb = components(state.covariance)
        half = 0.5 * late * late
        # covariances of p, v, b with the position predicted for the time of the sample, and its own
        with_bias = (1.0 - _spin(inputs.imu)) * (pb - late * vb - half * bb)
        cross = (pp - late * pv - half * pb, pv - late * vv - half * vb, with_bias)
        spread = cross[0] - late * cross[1] - half * cross[2] + self.noise**2
        off = sample.position - (state.position - late * state.velocity + half * state.acceleration)
        far, bound = largest(off * off), self.gate**2 * spread
        fresh = state._replace(unheard=0.0 * state.unheard)
        anew = (state.unheard > self.patience) & (far > bound) | ~state.started

        def better() -> State:
            gained = _gained(fresh, inputs.imu, off, cross, spread)
            return self._with_velocity(gained, inputs) if self.gives_velocity else gained

        kept = branch(state.started & (far <= bound), better, lambda: state)
        return branch(anew, lambda: self._anew(fresh, sample), lambda: kept)

    def _with_velocity(self, state: State, inputs: PositionEstimatorInputs) -> State:
        """State after the velocity of a sample."""
        _, pv, pb, vv, vb, bb = components(state.covariance)
        with_bias = (1.0 - _spin(inputs.imu)) * (vb + self.delay * bb)
        cross = (pv + self.delay * pb, vv + self.delay * vb, with_bias)
        spread = cross[1] + self.delay * cross[2] + self.velocity_noise**2
        off = inputs.sample.velocity - (state.velocity - self.delay * state.acceleration)
        return _gained(state, inputs.imu, off, cross, spread)

    def _anew(self, state: State, sample: PositionSample) -> State:
        """State that begins at a sample, with the velocity and the bias as known."""
        velocity = sample.velocity if self.gives_velocity else state.velocity * column(state.started)
        return state._replace(
            position=sample.position + self.delay * velocity,
            velocity=velocity,
            covariance=self._unsure(0.0 * state.unheard),
            started=state.started | True,
        )

    def _unsure(self, zero: Array) -> Array:
        """Covariance (..., 6) of what begins; ``zero`` (...) gives the shape."""
        speed = self.velocity_noise if self.gives_velocity else FIRST_SPEED
        return stacked([zero + x for x in (self.noise**2, 0.0, 0.0, speed**2, 0.0, FIRST_BIAS**2)])


def _spin(imu: ImuSample) -> Array:
    """How much the vehicle spins (...), from 0 at `SLOW` to 1 at `FAST`."""
    return where(imu.rate_valid, clip((length(imu.body_rate) - SLOW) / (FAST - SLOW), 0.0, 1.0), 0.0)


def _propagated(covariance: Covariance, noise: Array, walk: Array, dt: Array) -> list[Array]:
    """F P F' + Q over ``dt`` [s], F = [[1, dt, -dt²/2], [0, 1, -dt], [0, 0, 1]]."""
    pp, pv, pb, vv, vb, bb = covariance
    half = 0.5 * dt * dt
    p_v, p_b = pv + dt * vv - half * vb, pb + dt * vb - half * bb  # of the new p with the old v and b
    v_b = vb - dt * bb
    return [
        pp + dt * pv - half * pb + dt * p_v - half * p_b,
        p_v - dt * p_b,
        p_b,
        vv - dt * vb - dt * v_b + noise * dt,
        v_b,
        bb + walk * dt,
    ]


def _gained(state: State, imu: ImuSample, off: Vector, cross: Sequence[Array], spread: Array) -> State:
    """State after a measurement that is ``off`` (..., 3) by what was predicted.

    ``cross`` are the covariances (...) of p, v and b with what was predicted, ``spread`` is that of ``off``.
    """
    pp, pv, pb, vv, vb, bb = components(state.covariance)
    p, v, b = cross
    gp, gv, gb = p / spread, v / spread, b / spread
    covariance = [pp - gp * p, pv - gp * v, pb - gp * b, vv - gv * v, vb - gv * b, bb - gb * b]
    return state._replace(
        position=state.position + column(gp) * off,
        velocity=state.velocity + column(gv) * off,
        bias=state.bias + column(gb) * to_body(imu.q_xyzw, off),
        covariance=stacked(covariance),
    )


def _is_usable(sample: PositionSample) -> Flag:
    """Whether all numbers of a sample are finite and below `UNUSABLE`."""
    size = sum(abs(x) for part in sample[:2] for x in components(part))
    return size < UNUSABLE  # false for NaN, too
