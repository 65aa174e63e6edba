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

from quadftc_fdi.fault_observer import SHORTEST
from quadftc_fdi.isolation import rate_filter, reading_test
from quadftc_fdi.isolation.rate_filter import RateFilter
from quadftc_fdi.isolation.reading_test import OUTLIER, Deviation
from quadftc_model.arrays import (
    Column,
    Mask,
    Quaternion,
    Scalar,
    Vector,
    any_of,
    clip,
    column,
    exp,
    larger,
    namespace,
    smaller,
    sqrt,
    where,
)
from quadftc_model.rotations import turn

BIASED = 0.004  # rad/s; that a healthy gyro and the virtual one may differ by, 1 sigma
SCATTERED, LARGEST = 0.1, 100.0  # s, 1; over which the attitude's scatter is taken, and its bound
QUICK = 0.008  # s; noise of a gyro is quicker than this
AGILE, MOST = 0.1, 7.0  # s, 1; how fast q is learned; log of its largest factor
NEEDED = 0.06  # s; averaging time of the acceleration
SLIGHT = 0.03  # rad/s; a gyro that is off by less cannot be told from a healthy one again
SOONEST = 0.5  # s; age of a fault, at least, by which its rate is known
LATELY, JUST = 1.0, 0.1  # s; how long a jump of the gyro, of the attitude is remembered


class Trace(NamedTuple):
    """What is remembered of the last samples."""

    deviation: Vector  # gyro less estimated rate at the last sample [rad/s]
    jump: Vector  # largest innovation of the gyro of late, in standard deviations, fading
    innovation: Vector  # of the gyro, the last [rad/s]
    drift: Vector  # its mean over `QUICK` [rad/s]
    agility: Vector  # log of the learned factor of q
    needed: Vector  # unknown acceleration by gyro and torque [rad/s²]
    rotation: Vector  # attitude, measured less predicted, at the last sample [rad]
    bend: Vector  # largest jump of that of late, in standard deviations, fading
    scatter: Vector  # squared change of the attitude's innovation, in variances, over `SCATTERED`


class GyroMonitor(NamedTuple):
    """What is known of gyro and body rate."""

    q_xyzw: Quaternion  # attitude of the filter
    filter: RateFilter
    faulty: Mask
    bad: Mask  # the last reading was not to be used
    fault: Deviation  # of a faulty gyro [rad/s]
    drive: Vector  # acceleration by the torque, behind the rotors' lag [rad/s²]
    alone: Mask  # the attitude had to do without the gyro, which may be wrong
    trace: Trace


class Ahead(NamedTuple):
    """Prediction for a sample."""

    q_xyzw: Quaternion
    filter: RateFilter
    drive: Vector  # acceleration by the torque, behind the rotors' lag [rad/s²]
    known: Vector  # that and the one by the body's rotation [rad/s²]


class GyroReading(NamedTuple):
    """A reading of the gyro."""

    rate: Vector  # less its known errors [rad/s]
    noise: Vector  # variance [rad²/s²]
    suspicion: Vector  # how long there have been outliers [s]
    there: Mask
    wanted: Mask  # it may correct the rate
    good: Mask  # and so on: the verdict on it
    odd: Mask
    stuck: Mask


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
    no, started = zeros > 1.0, rate_filter.start_rate_filter(rate, drive, variance)
    fault, trace = reading_test.no_deviation(rate), Trace(*[zeros] * len(Trace._fields))
    return GyroMonitor(q_xyzw, started, no, no, fault, drive, no, trace)


def predict_monitor(
    state: GyroMonitor, drive: Vector, gyroscopic: Vector, q: Column, lag: Scalar, dt: Scalar
) -> Ahead:
    """Predict the rate.

    ``drive`` and ``gyroscopic`` [rad/s²] are the accelerations by the torque, with rotors of a ``lag`` (...,)
    [s], and by the body's rotation. ``q`` (..., 1) [rad²/s⁵] is the least density of the noise that moves the
    unknown one.
    """
    drive = state.drive + column(1.0 - exp(-dt / larger(lag, SHORTEST))) * (drive - state.drive)
    q = q * exp(state.trace.agility)
    ahead, turned = rate_filter.predict(state.filter, drive, gyroscopic, q, dt)
    return Ahead(turn(state.q_xyzw, turned), ahead, drive, drive + gyroscopic)


def step_monitor(
    state: GyroMonitor, ahead: Ahead, gyro: GyroReading, attitude: AttitudeReading, dt: Scalar
) -> tuple[GyroMonitor, Vector, Mask]:
    """Advance by ``dt`` [s] to a sample.

    Also return the square of what is noise in the gyro's innovation [rad²/s²], and where it can be learned:
    what changes quickly is noise, what keeps its sign is unknown acceleration, and raises q.
    """
    # against a rate that the gyro does not correct, an outlier proves nothing
    alarm = ~state.faulty & (gyro.stuck | (gyro.odd & (gyro.wanted | ~gyro.there)))
    faulty = state.faulty | alarm
    good = gyro.good & ~faulty
    used = good & gyro.wanted
    alone = attitude.there & ~gyro.wanted
    begins = alone & ~state.alone  # what the angle was off by must not look like a rate

    # correct by gyro and attitude
    before = state.filter.rate
    filtered, turned, white, trace = _hear(ahead, state.trace, gyro, used, before, dt)
    q_xyzw = turn(ahead.q_xyzw, turned)
    wanted = attitude.healthy | ~used
    filtered, q_xyzw, trace = _see(filtered, q_xyzw, trace, gyro, attitude, begins, wanted, dt)

    # follow a faulty gyro; the virtual rate changes with the noise of each attitude, too
    alive, known = gyro.there & ~gyro.stuck, BIASED**2 + 0.15 * (filtered.rr + gyro.noise)
    noise = gyro.noise + filtered.ar * filtered.ar / (filtered.aa + attitude.variance)
    still, fault = reading_test.follow_deviation(
        state.fault, faulty, alarm, alive, gyro.suspicion, trace.deviation, noise, known, dt
    )
    return GyroMonitor(q_xyzw, filtered, still, ~good, fault, ahead.drive, alone, trace), white, used


def gyro_error(fault: Vector, age: Vector) -> tuple[Vector, Vector]:
    """What a gyro reads too much by an attitude fault [rad] over its age [s]: as its bias, and as its fault.

    A gyro that is slightly off has another bias. One that is off by more is faulty until it reads right.
    """
    error = -fault / larger(age, SOONEST)
    slight = abs(error) < SLIGHT
    return error * slight, error * ~slight


def _hear(
    ahead: Ahead, trace: Trace, gyro: GyroReading, used: Mask, before: Vector, dt: Scalar
) -> tuple[RateFilter, Vector, Vector, Trace]:
    """Correct by a reading of the gyro, after a rate of ``before`` [rad/s].

    Also return the rotation [rad] and the square of what is noise [rad²/s²].
    """
    quick, average = 1.0 - exp(-dt / QUICK), 1.0 - exp(-dt / NEEDED)
    innovation, variance = gyro.rate - ahead.filter.rate, ahead.filter.rr + gyro.noise
    change = innovation - trace.drift
    white = (1.0 - 0.5 * quick) * change * change
    keeps = clip(innovation * trace.innovation / variance, -3.0, 3.0)
    # gyro and torque together ask for an acceleration
    asked = (gyro.rate - (before + trace.deviation)) / larger(dt, SHORTEST) - ahead.known
    asked = where(gyro.there & (trace.deviation != 0.0), asked, trace.needed)
    corrected, turned = rate_filter.correct_by_gyro(ahead.filter, innovation, gyro.noise, used)
    trace = trace._replace(
        jump=_recent(trace.jump, innovation / sqrt(variance) * used, exp(-dt / LATELY)),
        innovation=where(used, innovation, trace.innovation),
        drift=where(used, trace.drift + quick * change, trace.drift),
        agility=clip(trace.agility + (dt / AGILE) * keeps * used, 0.0, MOST),
        needed=trace.needed + average * (asked - trace.needed),
    )
    return corrected, turned, white, trace


def _see(
    state: RateFilter,
    q_xyzw: Quaternion,
    trace: Trace,
    gyro: GyroReading,
    attitude: AttitudeReading,
    begins: Mask,
    wanted: Mask,
    dt: Scalar,
) -> tuple[RateFilter, Quaternion, Trace]:
    """Correct by a measured attitude where it is ``wanted``; take over its jumps."""
    rotation = rate_filter.rotation_to(q_xyzw, attitude.q_xyzw)
    there, noise = attitude.there, 2.0 * attitude.sample
    step = where(there, rotation - trace.rotation, 0.0)
    small = step * step <= OUTLIER**2 * (noise + state.aa)
    like_before = there & small
    taken = where(small, where(begins, rotation, 0.0), step)
    rotation = where(begins, 0.0, where(like_before, rotation, trace.rotation))
    after, turned = rate_filter.correct_by_attitude(state, rotation, attitude.variance, like_before & wanted)
    jumps = turn(q_xyzw, taken)
    q_xyzw = turn(where(any_of(begins | ~like_before), jumps, q_xyzw), turned)
    jump = step / sqrt(noise)
    square, average = smaller(jump * jump, LARGEST), 1.0 - exp(-dt / SCATTERED)
    trace = trace._replace(
        deviation=where(gyro.there, gyro.rate - after.rate, 0.0),
        rotation=rotation,
        bend=_recent(trace.bend, jump, exp(-dt / JUST)),
        scatter=trace.scatter + there * average * (square - trace.scatter),
    )
    return after, q_xyzw, trace


def _recent(largest: Vector, news: Vector, kept: Scalar) -> Vector:
    """Keep the largest number of late, with its sign."""
    faded = largest * kept
    return where(news * news > faded * faded, news, faded)
