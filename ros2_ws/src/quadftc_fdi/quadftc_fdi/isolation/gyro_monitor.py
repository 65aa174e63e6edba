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

from collections.abc import Sequence
from typing import Any, NamedTuple

from quadftc_fdi.isolation import rate_filter, reading_test
from quadftc_fdi.isolation.rate_filter import Parts, RateFilter
from quadftc_fdi.isolation.reading_test import OUTLIER, Deviation
from quadftc_model.arrays import (
    Mask,
    Quaternion,
    Scalar,
    Vector,
    cache_numbers,
    changed_where,
    clip,
    exp,
    join,
    larger,
    namespace,
    pick,
    root,
    smaller,
    split,
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


Numbers = tuple[Any, ...]  # on an axis, or arrays of axes


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
    axes: Sequence[Parts]  # of its filter, as of `split`
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
    late: Mask


class AttitudeReading(NamedTuple):
    """A measured attitude, and how it may be used."""

    q_xyzw: Quaternion
    sample: Vector  # variance of one, as far as it changes from sample to sample [rad²]
    variance: Vector  # of white noise that is as bad as all its noise [rad²]
    there: Mask
    healthy: Mask  # as far as others know


class Gains(NamedTuple):
    """Shares of a sample in averages, and what is left of that which fades."""

    quick: float
    scattered: float
    needed: float
    lately: float
    just: float


@cache_numbers
def _gains(dt: float) -> Gains:
    quick, scattered, needed = [1.0 - exp(-dt / time) for time in (QUICK, SCATTERED, NEEDED)]
    return Gains(quick, scattered, needed, exp(-dt / LATELY), exp(-dt / JUST))


def start_monitor(q_xyzw: Quaternion, rate: Vector, drive: Vector, variance: Scalar) -> GyroMonitor:
    """Start at an attitude of a variance [rad²], a body rate [rad/s], an acceleration by torque [rad/s²]."""
    zeros = namespace(rate).zeros_like(rate)
    no, started = zeros > 1.0, rate_filter.start_rate_filter(rate, drive, variance)
    fault, trace = reading_test.no_deviation(rate), Trace(*[zeros] * len(Trace._fields))
    return GyroMonitor(q_xyzw, started, no, no, fault, drive, no, trace)


def predict_monitor(
    state: GyroMonitor, drive: Vector, gyroscopic: Vector, q: Scalar, lag: Scalar, dt: float
) -> Ahead:
    """Predict the rate.

    ``drive`` and ``gyroscopic`` [rad/s²] are the accelerations by the torque, with rotors of a ``lag`` [s],
    and by the body's rotation. ``q`` [rad²/s⁵] is the least density of the noise that moves the unknown one.
    """
    drive = state.drive + (1.0 - exp(-dt / larger(lag, 1e-9))) * (drive - state.drive)
    inputs = split(drive, gyroscopic, q * exp(state.trace.agility))
    each = zip(split(*state.filter), inputs, strict=True)
    axes = [rate_filter.predict(axis, *given, dt=dt) for axis, given in each]
    (turned,) = join([(rotation,) for _, rotation in axes])
    return Ahead(turn(state.q_xyzw, turned), [axis for axis, _ in axes], drive, drive + gyroscopic)


def adopt_gyro(ahead: Ahead, rate: Vector, variance: Vector, acceleration: Vector, returns: Mask) -> Ahead:
    """Go on at the rate [rad/s] and the unknown acceleration [rad/s²] by a gyro that is believed again.

    What an attitude has made of them meanwhile may be wrong.
    """

    def adopt() -> Ahead:
        each = zip(ahead.axes, split(rate, variance, acceleration, returns), strict=True)
        return ahead._replace(axes=[rate_filter.adopt_gyro(axis, *given) for axis, given in each])

    return changed_where(returns, adopt, ahead)


def step_monitor(
    state: GyroMonitor, ahead: Ahead, gyro: GyroReading, attitude: AttitudeReading, dt: float
) -> tuple[GyroMonitor, Vector, Mask]:
    """Advance by ``dt`` [s] to a sample.

    Also return the square of what is noise in the gyro's innovation [rad²/s²], and where it can be learned:
    what changes quickly is noise, what keeps its sign is unknown acceleration, and raises q.
    """
    # against a rate that the gyro does not correct, an outlier proves nothing
    strange = gyro.stuck | gyro.odd
    alarm = changed_where(
        strange, lambda: ~state.faulty & (gyro.stuck | (gyro.odd & (gyro.wanted | ~gyro.there))), strange
    )
    faulty = state.faulty | alarm
    good = gyro.good & ~faulty
    used = good & gyro.wanted
    calm, alone = used & ~gyro.late, attitude.there & ~gyro.wanted
    begins = alone & ~state.alone  # what the angle was off by must not look like a rate

    # axis by axis; but the rotations of the attitude need all three
    gains, traces = _gains(dt), split(*state.trace)
    inputs = split(gyro.rate, gyro.noise, gyro.there, used, calm, state.filter.rate, ahead.known)
    each = zip(ahead.axes, traces, inputs, strict=True)
    heard = [_hear(*given, gains, dt) for given in each]
    turned, white = join([found for _, found, _ in heard])
    q_xyzw = turn(ahead.q_xyzw, turned)
    rotation = rate_filter.rotation_to(q_xyzw, attitude.q_xyzw)
    inputs = split(
        *(rotation, gyro.rate, gyro.there, begins, attitude.healthy | ~used),
        *(attitude.there, attitude.sample, attitude.variance),
    )
    each = zip(heard, traces, inputs, strict=True)
    seen = [_see(axis, trace, news, given, gains) for (axis, _, news), trace, given in each]
    takes, taken, turned = join([found for _, found, _ in seen])
    q_xyzw = turn(changed_where(takes, lambda: turn(q_xyzw, taken), q_xyzw), turned)
    after, trace = RateFilter(*join([axis for axis, _, _ in seen])), Trace(*join([each[2] for each in seen]))

    def follow() -> tuple[Mask, Deviation]:
        alive, known = gyro.there & ~gyro.stuck, BIASED**2 + 0.15 * (after.rr + gyro.noise)
        # the virtual rate changes with the noise of each attitude, too
        noise = gyro.noise + after.ar * after.ar / (after.aa + attitude.variance)
        return reading_test.follow_deviation(
            state.fault, faulty, alarm, alive, gyro.suspicion, trace.deviation, noise, known, dt
        )

    still, fault = changed_where(faulty, follow, (faulty, state.fault))
    return GyroMonitor(q_xyzw, after, still, ~good, fault, ahead.drive, alone, trace), white, calm


def gyro_error(fault: Vector, age: Vector) -> tuple[Vector, Vector]:
    """What a gyro reads too much by an attitude fault [rad] over its age [s]: as its bias, and as its fault.

    A gyro that is slightly off has another bias. One that is off by more is faulty until it reads right.
    """
    xp = namespace(fault)
    error = -fault / xp.maximum(age, SOONEST)
    slight = xp.abs(error) < SLIGHT
    return error * slight, error * ~slight


def _hear(
    axis: Parts, trace: Numbers, reading: Numbers, gains: Gains, dt: float
) -> tuple[Parts, tuple[Vector, Vector], Numbers]:
    """Correct by a reading of the gyro.

    Also return the rotation [rad] and the square of what is noise [rad²/s²], and what the trace says of the
    gyro, from the jump on.
    """
    rate, noise, there, used, calm, before, known = reading
    deviation, jump, last, drift, agility, needed, *_ = trace
    innovation, variance = rate - axis[0], axis[6] + noise
    change = innovation - drift
    white = (1.0 - 0.5 * gains.quick) * change * change
    keeps = clip(innovation * last / variance, -3.0, 3.0)
    jump = _recent(jump, innovation / root(variance) * used, gains.lately)
    agility = clip(agility + (dt / AGILE) * keeps * calm, 0.0, MOST)
    # gyro and torque together ask for an acceleration
    asked = (rate - (before + deviation)) / dt - known
    asked = pick(there & (deviation != 0.0), asked, needed)
    needed = needed + gains.needed * (asked - needed)
    axis, turned = rate_filter.correct_by_gyro(axis, innovation, noise, used)
    last, drift = pick(calm, innovation, last), pick(calm, drift + gains.quick * change, drift)
    return axis, (turned, white), (jump, last, drift, agility, needed)


def _see(
    axis: Parts, trace: Numbers, of_gyro: Numbers, reading: Numbers, gains: Gains
) -> tuple[Parts, tuple[Mask, Vector, Vector], Numbers]:
    """Correct by a measured attitude, by the rotation to it, where it is wanted; take over its jumps.

    Also return whether a rotation is taken over, that rotation and the one of the correction [rad], and the
    trace.
    """
    rotation, rate, gyro_there, begins, wanted, there, sample, variance = reading
    *_, last, bend, scatter = trace
    step, noise = (rotation - last) * there, 2.0 * sample
    small = step * step <= OUTLIER**2 * (noise + axis[3])
    like_before = there & small
    taken = (small ^ True) * step + (begins & small) * rotation
    rotation = pick(like_before, rotation, last) * (begins ^ True)
    axis, turned = rate_filter.correct_by_attitude(axis, rotation, variance, like_before & wanted)
    jump = step / root(noise)
    square = smaller(jump * jump, LARGEST)
    scatter = scatter + there * gains.scattered * (square - scatter)
    bend = _recent(bend, jump, gains.just)
    trace = ((rate - axis[0]) * gyro_there, *of_gyro, rotation, bend, scatter)
    return axis, (begins | (like_before ^ True), taken, turned), trace


def _recent(largest: Vector, news: Vector, kept: float) -> Vector:
    """Keep the largest number of late, with its sign."""
    faded = largest * kept
    return pick(news * news > faded * faded, news, faded)
