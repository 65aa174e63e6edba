"""Tests of a sensor's readings against predictions, axis by axis; its noise is learned.

outlier     beyond six standard deviations of the innovation: the reading is not to be used
odd         three outliers, or readings that are absent, within few samples: a jump, noise, silence
stuck       a reading that is repeated more often than by chance: than it was, or than its grain lets expect
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model.arrays import (
    AnyArray,
    Bool,
    Float,
    Mask,
    Scalar,
    Vector,
    clip,
    exp,
    larger,
    log,
    namespace,
    smaller,
    sqrt,
    where,
)
from quadftc_model.samples import UNUSABLE

OUTLIER = 6.0  # 1; standard deviations beyond which a reading is an outlier
KEPT, ALARM = 0.8, 2.3  # 1; of the count of outliers from sample to sample; level of a fault: three in a row
SOME = 0.5  # 1; of the count: there are outliers
EARLY, LATE, CLIP = 0.3, 20.0, 9.0  # s, s, 1; what the prior is worth; memory; bound of squares
CHANCE, RARE = 0.01, math.log(1e-7)  # 1; of a repeated reading, at first; log of a chance that is none
SAME, ROUNDINGS = 1e-12, 8.0  # SI, 1; readings that differ by less, or by 8 roundings of 1, are the same
LONG_RUN = 2.0  # 1; repetitions beyond which a run teaches nothing
COARSE, LIKELY = 16.0, 0.7  # 1; chance of a repeated reading by its grain, in standard deviations; at most
PATIENT = 20.0  # s; over which the chance is learned


Channels = Float[AnyArray, "*batch n"]  # of one sensor or several
Flags = Bool[AnyArray, "*batch n"]
Limits = float | NDArray[np.float64]


class ReadingTest(NamedTuple):
    """What is known of the noise of each channel, and remembered of its last readings."""

    variance: Channels  # of a reading, learned
    time: Channels  # of learning [s]
    outliers: Channels  # number of late, fading
    suspicion: Channels  # how long there have been some [s]
    reading: Channels  # the last
    repeats: Channels  # how often it has been repeated
    chance: Channels  # share of repeated readings, learned
    held: Channels  # variance of an innovation before there were outliers
    grain: Channels  # smallest change from reading to reading so far


class Verdict(NamedTuple):
    """What a test says of a reading."""

    good: Flags  # it can be used
    odd: Flags  # three outliers or absent readings
    stuck: Flags
    late: Flags  # there have been outliers of late

    def of(self, which: slice) -> Verdict:
        """Return that of some of the channels."""
        return Verdict(*[part[..., which] for part in self])


def start_test(reading: Channels, prior: Limits) -> ReadingTest:
    """Start with the standard deviations of a noise that is not known."""
    zeros = namespace(reading).zeros_like(reading)
    chance, grain = zeros + CHANCE, zeros + UNUSABLE
    return ReadingTest(zeros + prior**2, zeros, zeros, zeros, reading, zeros, chance, zeros, grain)


def test_reading(
    state: ReadingTest,
    reading: Channels,
    there: Flags,
    square: Channels,
    predicted: Channels,
    noise: Channels,
    noisy: Limits,
    dt: Scalar,
) -> tuple[ReadingTest, Verdict]:
    """Test readings: squared innovations, variances of the predictions and of the noise.

    A sensor whose noise has a variance below ``noisy`` may repeat itself.
    """
    started = state.time > EARLY
    # over readings that are left out the prediction gets worse, which must not hide a step
    held = where(state.outliers > SOME, state.held, predicted + noise)
    missed = ~there | (started & (square > OUTLIER**2 * held))
    outliers = KEPT * state.outliers + missed
    late = outliers > SOME
    suspicion, odd = (state.suspicion + dt) * late, late & started & (outliers > ALARM)
    # readings that are repeated
    change = abs(reading - state.reading)
    same = there & (change < max(SAME, ROUNDINGS * float(np.finfo(reading.dtype).eps)))
    grain = where(there & ~same, smaller(state.grain, change), state.grain)
    chance = state.chance + (state.repeats <= LONG_RUN) * (dt / PATIENT) * (same - state.chance)
    repeats = (state.repeats + 1.0) * same
    likely = larger(chance, smaller(COARSE * grain / sqrt(state.variance), LIKELY))
    run = repeats * log(clip(likely, 1e-4, 0.99)) * (state.variance > noisy)
    good = ~missed & ((run > 0.5 * RARE) | ~started)
    verdict = Verdict(good, odd, started & (run < RARE), late)
    reading = where(there, reading, state.reading)
    parts = outliers, suspicion, reading, repeats, chance, held, grain
    return ReadingTest(state.variance, state.time, *parts), verdict


def learn_noise(
    state: ReadingTest, square: Channels, predicted: Channels, used: Flags, least: Limits, dt: Scalar
) -> ReadingTest:
    """Learn the variance of a reading, ``least`` or more, from squared innovations, where it is used."""
    expected = predicted + state.variance
    learned = dt * used
    time = smaller(state.time + learned, LATE)
    news = smaller(square / expected, CLIP) - 1.0
    change = 2.0 * learned / (EARLY + time) * news * state.variance**2 / expected
    return state._replace(variance=larger(state.variance + change, least), time=time)


SHORT, LONG = 0.06, 0.4  # s; averages of the deviation of a faulty sensor
MOVED = 25.0  # 1; squared difference of the two, in variances of the longer, that starts it again
SCATTER = 3.0  # 1; squared changes, in variances, of a sensor that is healthy again, at most
BACK = 0.5  # 1; share of its peak to which a fault must have come back
QUICK, SOONEST, LATEST = 0.3, 0.3, 0.6  # 1, s, s; share of a fault's age for which it must agree; bounds


class Deviation(NamedTuple):
    """A faulty sensor: what it reads too much, and for how long it has looked healthy."""

    age: Vector  # of the fault [s]
    calm: Vector  # how long it has looked healthy [s]
    mean: Vector  # over a short time
    slow: Vector  # over a long time
    peak: Vector  # largest size of that
    scatter: Vector  # squared change from reading to reading, in variances
    last: Vector  # deviation of the last reading


def no_deviation(like: Vector) -> Deviation:
    """Return that of a healthy sensor."""
    zeros = namespace(like).zeros_like(like)
    return Deviation(*[zeros] * len(Deviation._fields))


def begin_deviation(state: Deviation, size: Vector, begins: Mask) -> Deviation:
    """Begin on some axes with what the sensor is believed to read too much; 0: nothing is known of it."""
    peak = where(begins, where(size == 0.0, UNUSABLE, abs(size)), state.peak)
    mean, slow = where(begins, size, state.mean), where(begins, size, state.slow)
    return state._replace(mean=mean, slow=slow, peak=peak)


def follow_deviation(
    state: Deviation,
    faulty: Mask,
    alarm: Mask,
    alive: Mask,
    age: Vector,
    deviation: Vector,
    noise: Vector,
    known: Vector,
    dt: Scalar,
) -> tuple[Mask, Deviation]:
    """Follow the deviation of the faulty axes; return which are faulty still.

    ``alarm``: since this sample, at an ``age`` [s]; ``alive``: there is a reading, and it changes.
    ``noise`` is the variance of a healthy reading, ``known`` that of the average deviation over `LONG`.
    """
    deviation = where(alive, deviation, 0.0)
    change = deviation - where(alarm, deviation, state.last)
    square = change * change / (2.0 * noise)
    quick, gain = 1.0 - exp(-dt / SHORT), 1.0 - exp(-dt / LONG)
    mean = where(alarm, deviation, state.mean + quick * (deviation - state.mean))
    slow = where(alarm, deviation, state.slow + gain * (deviation - state.slow))
    slow = where((mean - slow) ** 2 > MOVED * known, mean, slow)  # the fault has changed, or has ended
    size = abs(slow)
    peak = where(alarm, where(alive, size, UNUSABLE), larger(size, state.peak))
    scatter = where(alarm, SCATTER, state.scatter + quick * (square - state.scatter))
    age = where(alarm, age, state.age + dt)
    # a small fault must be seen to come back: it agrees with zero as it is
    off = size * size / known
    back = (off < 1.0) | ((off < 9.0) & (size < BACK * peak))
    calm = (state.calm + dt) * (alive & back & (scatter < SCATTER))
    kept = faulty & (calm <= clip(QUICK * age, SOONEST, LATEST))
    parts = age, calm, mean, slow, peak, scatter, deviation
    return kept, Deviation(*(where(kept, part, 0.0) for part in parts))
