r"""Is the gyro healthy? Axis by axis: what it reads against the rate of torque model and attitude.

`rate_filter` predicts the rate of a sample. What the gyro reads more, the innovation, is its noise (learned
here), and what the unknown acceleration does within a sample: little, as 1.5 rad/s² make 0.006 rad/s in 4 ms.

    outlier     beyond five standard deviations: the sample is not used
    fault       three outliers within few samples: a jump, noise, a gyro that no longer follows
    stuck       a reading that is repeated, more often than it ever was by chance
    absent      three samples without a reading

A faulty gyro is left out, and the filter goes on by attitude and torque: a virtual gyro. The gyro is trusted
again once it has agreed with that for some time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quadftc_fdi.isolation import rate_filter
from quadftc_fdi.isolation.rate_filter import RateFilter
from quadftc_model.arrays import Mask, Quaternion, Scalar, Vector, changed_where, clip, exp, namespace

OUTLIER = 6.0  # 1; standard deviations beyond which a sample is an outlier
FLOOR = 0.005  # rad/s; noise of a gyro in flight, at least: vibration comes and goes
NOISY = 1e-4  # rad/s; a gyro with less noise may repeat itself
KEPT, ALARM = 0.8, 2.3  # 1; of the count of outliers from sample to sample; level of a fault: three in a row
PRIOR = 0.02  # rad/s; noise of a gyro before anything is learned
LEAST = 1e-5  # rad/s; no gyro is better
EARLY, LATE, CLIP = 0.3, 20.0, 9.0  # s, s, 1; what the prior is worth; memory; bound of squares
CHANCE, RARE = 0.01, math.log(1e-7)  # 1; of a repeated reading, at first; log of a chance that is none
SHORT, LONG = 0.06, 0.4  # s; averages of the deviation of a faulty gyro
AGREES = 3.0  # 1; standard deviations
BIASED = 0.004  # rad/s; that a healthy gyro and the virtual one may differ by, 1 sigma
SCATTER = 3.0  # 1; squared deviations, in variances, of a gyro that is healthy again, at most
LATELY, JUST = 1.0, 0.1  # s; how long a jump of the gyro, of the attitude is remembered
QUICK, SOONEST, LATEST = 0.3, 0.3, 1.0  # 1, s, s; share of a fault's age for which it must agree; bounds


class GyroMonitor(NamedTuple):
    """What is known of gyro and body rate."""

    filter: RateFilter
    variance: Vector  # of a reading [rad²/s²], learned
    time: Vector  # of learning [s]
    outliers: Vector  # of outliers, fading
    reading: Vector  # the last [rad/s]
    repeats: Vector  # how often it has been repeated
    chance: Vector  # share of repeated readings, learned
    faulty: Mask
    suspicion: Vector  # how long outliers have been there [s]
    age: Vector  # of the fault [s]
    calm: Vector  # how long a faulty gyro has agreed [s]
    mean: Vector  # its deviation, over a short time [rad/s]
    long: Vector  # the same, over a long time [rad/s]
    scatter: Vector  # squared deviation, in variances
    jumps: Vector  # count of outliers of the attitude, fading
    rotation: Vector  # attitude, measured less predicted, at the last sample [rad]
    bend: Vector  # largest jump of that lately, in standard deviations, fading
    jump: Vector  # largest innovation of the gyro lately, in standard deviations, fading
    deviation: Vector  # gyro less estimated rate [rad/s]
    bad: Mask  # the last sample was not to be used


def start_monitor(q_xyzw: Quaternion, gyro: Vector, drive: Vector, variance: Scalar) -> GyroMonitor:
    """Start at an attitude [variance rad²] and a reading [rad/s]."""
    zeros = namespace(gyro).zeros_like(gyro)
    started = rate_filter.start_rate_filter(q_xyzw, gyro, drive, variance)
    empty = GyroMonitor(started, *[zeros] * (len(GyroMonitor._fields) - 1))  # pyright: ignore
    return empty._replace(
        variance=zeros + PRIOR**2, reading=gyro, chance=zeros + CHANCE, faulty=zeros > 1.0, bad=zeros > 1.0
    )


class AttitudeUse(NamedTuple):
    """How the attitude of a sample may be used."""

    q_xyzw: Quaternion
    variance: Vector  # [rad²]
    there: Mask
    healthy: Mask  # as far as others know


def step_monitor(
    state: GyroMonitor,
    gyro: Vector,
    reading: Vector,
    there: Mask,
    wanted: Mask,
    attitude: AttitudeUse,
    drive: Vector,
    gyroscopic: Vector,
    q: Scalar,
    dt: float,
) -> GyroMonitor:
    """Advance by ``dt`` [s] to a sample.

    ``gyro`` [rad/s] is the reading less its known errors, ``reading`` the raw one, ``there`` whether there
    is one, ``wanted`` whether it may correct the rate. ``drive`` and ``gyroscopic`` [rad/s²] are the
    accelerations by the torque and by the body's rotation. ``q`` [rad²/s⁵] is the density of the noise that
    moves the unknown one.
    """
    xp = namespace(gyro)
    ahead = rate_filter.predict(state.filter, drive, gyroscopic, q, dt)
    innovation = gyro - ahead.rate
    noise = xp.maximum(state.variance, FLOOR**2)
    expected = ahead.rr + noise
    square = innovation * innovation
    started = state.time > EARLY
    outlier = there & started & (square > OUTLIER**2 * expected)
    state = _count(state, outlier, reading, there, dt)
    repeated = xp.where(state.variance > NOISY**2, state.repeats * xp.log(state.chance), 0.0)
    stuck = repeated < RARE
    alarm = ~state.faulty & (((state.outliers > ALARM) & (wanted | ~there)) | stuck) & started
    faulty = state.faulty | alarm
    good = there & ~outlier & ~faulty & (repeated > 0.5 * RARE)
    used = good & wanted
    state, ahead_rr = _learn(state, square, ahead.rr, used, dt), ahead.rr
    ahead = rate_filter.correct_by_gyro(ahead, innovation, noise, used)
    ahead, jumps, rotation = _use_attitude(ahead, state.jumps, attitude, used)
    bend = (rotation - state.rotation) / xp.sqrt(2.0 * attitude.variance) * attitude.there
    judged = state._replace(
        filter=ahead,
        faulty=faulty,
        age=xp.where(alarm, state.suspicion, (state.age + dt) * faulty),
        jumps=jumps,
        bad=~good,
        rotation=xp.where(attitude.there, rotation, state.rotation),
        bend=_recent(state.bend, bend, JUST, dt),
        jump=_recent(state.jump, innovation / xp.sqrt(ahead_rr + state.variance) * used, LATELY, dt),
        deviation=xp.where(there, gyro - ahead.rate, 0.0),
    )
    return changed_where(faulty, lambda: _follow(judged, gyro, alarm, there & ~stuck, dt), judged)


def _count(state: GyroMonitor, outlier: Mask, reading: Vector, there: Mask, dt: float) -> GyroMonitor:
    """Count outliers and repeated readings."""
    xp = namespace(reading)
    count = KEPT * state.outliers + (outlier | ~there)
    same = (reading == state.reading) & there
    rate = dt / 20.0
    chance = xp.where(
        state.faulty | (state.repeats > 2.0), state.chance, state.chance + rate * (same - state.chance)
    )
    return state._replace(
        outliers=count,
        reading=xp.where(there, reading, state.reading),
        repeats=(state.repeats + same) * same,
        chance=clip(chance, 1e-4, 0.99),
        suspicion=(state.suspicion + dt) * (count > 0.5),
    )


def _recent(largest: Vector, news: Vector, memory: float, dt: float) -> Vector:
    """Keep the largest number of late, with its sign."""
    xp = namespace(news)
    faded = largest * exp(-dt / memory)
    return xp.where(xp.abs(news) > xp.abs(faded), news, faded)


def _use_attitude(
    ahead: RateFilter, jumps: Vector, attitude: AttitudeUse, gyro_used: Mask
) -> tuple[RateFilter, Vector, Vector]:
    """Correct by the attitude where it is healthy or the gyro is not; absorb its jumps."""
    rotation = rate_filter.rotation_to(ahead, attitude.q_xyzw)
    outlier = rotation * rotation > OUTLIER**2 * (ahead.aa + attitude.variance)
    jumps = KEPT * jumps + (outlier & attitude.there)
    used = attitude.there & ~outlier & (attitude.healthy | ~gyro_used)
    ahead = rate_filter.correct_by_attitude(ahead, rotation, attitude.variance, used)
    jumped = attitude.there & outlier & (jumps > ALARM)
    ahead = changed_where(jumped, lambda: rate_filter.absorb(ahead, rotation, jumped), ahead)
    return ahead, jumps * ~jumped, rotation


def _learn(state: GyroMonitor, square: Vector, predicted: Vector, used: Mask, dt: float) -> GyroMonitor:
    """Learn the variance of a reading from its squared innovations [rad²/s²]."""
    xp = namespace(square)
    expected = predicted + state.variance
    time = xp.minimum(state.time + dt * used, LATE)
    gain = used * dt / (EARLY + time)
    news = xp.minimum(square / expected, CLIP) - 1.0
    change = gain * 2.0 * news * state.variance**2 / expected
    return state._replace(variance=xp.maximum(state.variance + change, LEAST**2), time=time)


def _follow(state: GyroMonitor, gyro: Vector, alarm: Mask, alive: Mask, dt: float) -> GyroMonitor:
    """Follow the deviation of a faulty gyro, and judge whether it is healthy again."""
    xp = namespace(gyro)
    faulty, deviation = state.faulty, (gyro - state.filter.rate) * alive
    expected = state.filter.rr + xp.maximum(state.variance, FLOOR**2)
    square = deviation * deviation / expected
    mean = xp.where(alarm, deviation, state.mean + (1.0 - exp(-dt / SHORT)) * (deviation - state.mean))
    long = xp.where(alarm, deviation, state.long + (1.0 - exp(-dt / LONG)) * (deviation - state.long))
    gain = 1.0 - exp(-dt / SHORT)
    scatter = xp.where(alarm, square, state.scatter + gain * (square - state.scatter))
    agrees = (long * long < AGREES**2 * (BIASED**2 + 0.05 * expected)) & (scatter < SCATTER) & alive
    calm = (state.calm + dt) * (agrees & faulty)
    enough = calm > clip(QUICK * state.age, SOONEST, LATEST)
    kept = faulty & ~enough
    return state._replace(
        faulty=kept,
        mean=mean * kept,
        long=long * kept,
        scatter=scatter * kept,
        calm=calm * kept,
        age=state.age * kept,
    )
