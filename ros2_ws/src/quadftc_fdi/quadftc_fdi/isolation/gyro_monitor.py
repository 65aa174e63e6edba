r"""Is the gyro healthy? Axis by axis: what it reads against the rate of torque model and attitude.

`rate_filter` predicts the rate of a sample. What the gyro reads more, the innovation, is its noise and what
the unknown acceleration does within a sample: little, as 1.5 rad/s² make 0.006 rad/s in 4 ms. `reading_test`
finds jumps, noise, and a gyro that is stuck or absent.

A faulty gyro is left out, and the filter goes on by attitude and torque: a virtual gyro. The gyro is trusted
again once it has agreed with that for some time.

What is too slow for this is left to the test of attitude against gyro. For it the monitor remembers the last
jumps of both: one that is no outlier still tells whose a discrepancy is.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_fdi.isolation import rate_filter, reading_test
from quadftc_fdi.isolation.rate_filter import RateFilter
from quadftc_fdi.isolation.reading_test import OUTLIER, Deviation, Verdict
from quadftc_model.arrays import Mask, Quaternion, Scalar, Vector, changed_where, clip, exp, larger, namespace

BIASED = 0.004  # rad/s; that a healthy gyro and the virtual one may differ by, 1 sigma
SCATTERED, LARGEST = 0.1, 100.0  # s, 1; over which the attitude's scatter is taken, and its bound
QUICK = 0.008  # s; noise of a gyro is quicker than this
AGILE, MOST = 0.1, 7.0  # s, 1; how fast q is learned; log of its largest factor
NEEDED = 0.06  # s; averaging time of the acceleration
LATELY, JUST = 1.0, 0.1  # s; how long a jump of the gyro, of the attitude is remembered


class GyroMonitor(NamedTuple):
    """What is known of gyro and body rate."""

    filter: RateFilter
    faulty: Mask
    bad: Mask  # the last reading was not to be used
    fault: Deviation  # of a faulty gyro [rad/s]
    deviation: Vector  # gyro less estimated rate at the last sample [rad/s]
    jump: Vector  # largest innovation of the gyro of late, in standard deviations, fading
    rotation: Vector  # attitude, measured less predicted, at the last sample [rad]
    bend: Vector  # largest jump of that of late, in standard deviations, fading
    alone: Mask  # the attitude had to do without the gyro, which may be wrong
    scatter: Vector  # squared change of the attitude's innovation, in variances, over `SCATTERED`
    drive: Vector  # acceleration by the torque, behind the rotors' lag [rad/s²]
    innovation: Vector  # of the gyro, the last [rad/s]
    drift: Vector  # its mean over `QUICK` [rad/s]
    agility: Vector  # log of the learned factor of q
    needed: Vector  # unknown acceleration by gyro and torque [rad/s²]


class GyroReading(NamedTuple):
    """A reading of the gyro."""

    rate: Vector  # less its known errors [rad/s]
    noise: Vector  # variance [rad²/s²]
    suspicion: Vector  # how long there have been outliers [s]
    outliers: Mask  # there are some
    there: Mask
    verdict: Verdict
    wanted: Mask  # it may correct the rate


class AttitudeReading(NamedTuple):
    """A measured attitude, and how it may be used."""

    q_xyzw: Quaternion
    sample: Vector  # variance of one, as far as it changes from sample to sample [rad²]
    variance: Vector  # of white noise that is as bad as all its noise [rad²]
    there: Mask
    healthy: Mask  # as far as others know


def start_monitor(q_xyzw: Quaternion, rate: Vector, drive: Vector, variance: Scalar) -> GyroMonitor:
    """Start at an attitude of a variance [rad²], a body rate [rad/s], an acceleration by torque [rad/s²]."""
    zeros = namespace(rate).zeros_like(rate)
    no, started = zeros > 1.0, rate_filter.start_rate_filter(q_xyzw, rate, drive, variance)
    fault = reading_test.no_deviation(rate)
    return GyroMonitor(
        started, no, no, fault, zeros, zeros, zeros, zeros, no, zeros, drive, zeros, zeros, zeros, zeros
    )


def predict_monitor(
    state: GyroMonitor, drive: Vector, gyroscopic: Vector, q: Scalar, lag: Scalar, dt: float
) -> tuple[RateFilter, Vector]:
    """Predict the rate; also return the acceleration by the torque [rad/s²] behind the rotors' lag [s].

    ``drive`` and ``gyroscopic`` [rad/s²] are the accelerations by the torque and by the body's rotation.
    ``q`` [rad²/s⁵] is the least density of the noise that moves the unknown one.
    """
    drive = state.drive + (1.0 - exp(-dt / larger(lag, 1e-9))) * (drive - state.drive)
    return rate_filter.predict(state.filter, drive, gyroscopic, q * exp(state.agility), dt), drive


def step_monitor(
    state: GyroMonitor,
    ahead: RateFilter,
    gyro: GyroReading,
    attitude: AttitudeReading,
    drive: Vector,
    gyroscopic: Vector,
    dt: float,
) -> tuple[GyroMonitor, Vector, Mask]:
    """Advance by ``dt`` [s] to a sample.

    ``ahead`` is the filter's prediction, by the accelerations ``drive`` and ``gyroscopic`` [rad/s²]. Also
    return the square of what is noise in the gyro's innovation [rad²/s²], and where it can be learned: what
    changes quickly is noise, what keeps its sign is unknown acceleration, and raises q.
    """
    xp, verdict = namespace(gyro.rate), gyro.verdict
    innovation = gyro.rate - ahead.rate
    # against a rate that the gyro does not correct, an outlier proves nothing
    strange = verdict.stuck | verdict.odd
    alarm = changed_where(
        strange,
        lambda: ~state.faulty & (verdict.stuck | (verdict.odd & (gyro.wanted | ~gyro.there))),
        strange,
    )
    faulty = state.faulty | alarm
    good = verdict.good & ~faulty
    used = good & gyro.wanted
    variance = ahead.rr + gyro.noise
    jump = innovation / xp.sqrt(variance) * used
    calm, gain = used & ~gyro.outliers, 1.0 - exp(-dt / QUICK)
    change = innovation - state.drift
    drift = state.drift + gain * change

    def keep() -> tuple[Vector, Vector]:
        return xp.where(calm, innovation, state.innovation), xp.where(calm, drift, state.drift)

    white = (1.0 - 0.5 * gain) * change * change
    keeps = clip(innovation * state.innovation / variance, -3.0, 3.0)
    agility = clip(state.agility + (dt / AGILE) * keeps * calm, 0.0, MOST)
    ahead = rate_filter.correct_by_gyro(ahead, innovation, gyro.noise, used)

    alone = attitude.there & ~gyro.wanted
    ahead, rotation, step = _use_attitude(state, ahead, attitude, alone, used)
    square = xp.minimum(step * step, LARGEST)
    scatter = state.scatter + attitude.there * (1.0 - exp(-dt / SCATTERED)) * (square - state.scatter)

    deviation = (gyro.rate - ahead.rate) * gyro.there

    def follow() -> tuple[Mask, Deviation]:
        alive, known = gyro.there & ~verdict.stuck, BIASED**2 + 0.15 * (ahead.rr + gyro.noise)
        # the virtual rate changes with the noise of each attitude, too
        noise = gyro.noise + ahead.ar * ahead.ar / (ahead.aa + attitude.variance)
        return reading_test.follow_deviation(
            state.fault, faulty, alarm, alive, gyro.suspicion, deviation, noise, known, dt
        )

    faulty, fault = changed_where(faulty, follow, (faulty, state.fault))
    after = GyroMonitor(
        ahead,
        faulty,
        ~good,
        fault,
        deviation,
        _recent(state.jump, jump, LATELY, dt),
        rotation,
        _recent(state.bend, step, JUST, dt),
        alone,
        scatter,
        drive,
        *changed_where(~calm, keep, (innovation, drift)),
        agility,
        _needed(state, gyro, drive + gyroscopic, dt),
    )
    return after, white, calm


def _use_attitude(
    state: GyroMonitor, ahead: RateFilter, attitude: AttitudeReading, alone: Mask, gyro_used: Mask
) -> tuple[RateFilter, Vector, Vector]:
    """Correct by the attitude where it is healthy or the gyro is not used; take over its jumps.

    Also return the rotation to it [rad], and by how many standard deviations that has changed.
    """
    xp = namespace(ahead.rate)
    rotation = rate_filter.rotation_to(ahead, attitude.q_xyzw)
    step, noise = (rotation - state.rotation) * attitude.there, 2.0 * attitude.sample
    jumped = step * step > OUTLIER**2 * (noise + ahead.aa)
    begins = alone & ~state.alone  # what the angle was off by must not look like a rate
    like_before = attitude.there & ~jumped

    def take_over() -> tuple[RateFilter, Vector]:
        taken = jumped * step + (begins & ~jumped) * rotation
        return rate_filter.absorb(ahead, taken), xp.where(like_before, rotation, state.rotation) * ~begins

    ahead, rotation = changed_where(begins | ~like_before, take_over, (ahead, rotation))
    used = like_before & (attitude.healthy | ~gyro_used)
    ahead = rate_filter.correct_by_attitude(ahead, rotation, attitude.variance, used)
    return ahead, rotation, step / xp.sqrt(noise)


def _needed(state: GyroMonitor, gyro: GyroReading, known: Vector, dt: float) -> Vector:
    """Acceleration that gyro and torque together ask for: a slow mean of differences [rad/s²]."""
    xp = namespace(known)
    before = state.filter.rate + state.deviation
    change = (gyro.rate - before) / dt - known
    blind = ~gyro.there | (state.deviation == 0.0)
    change = changed_where(blind, lambda: xp.where(blind, state.needed, change), change)
    return state.needed + (1.0 - exp(-dt / NEEDED)) * (change - state.needed)


def _recent(largest: Vector, news: Vector, memory: float, dt: float) -> Vector:
    """Keep the largest number of late, with its sign."""
    xp = namespace(news)
    faded = largest * exp(-dt / memory)
    return xp.where(news * news > faded * faded, news, faded)
