r"""Noise, learned: what is white, and what lasts, by how readings move apart.

A reading less what the other sensor or the model says moves by y over a lag. White noise of variance R gives
y a variance of 2 R, and a variance of 6 R to its change from sample to sample. Over a longer lag an unknown
acceleration of variance D adds D lag², a wandering error W lag:

    gyro against torque:     var y = 2 R + D lag²
    attitude against gyro:   var y = 2 R / n + W (lag - L/3) + 2 S (2/e - (1 - 1/e)² exp(1 - lag/L))

The second y is between means of n readings over L, `LONGER`: in single ones the noise would hide what
wanders. S is the variance of a sway, an error that correlates over L, so it soon moves no farther. Two lags,
L and `CORRELATED`, tell S from W.

A filter in the gyro smooths its noise. Of noise whose neighbours correlate by rho, changes from sample to
sample have a variance of 6 R (1 - 4/3 rho + rho²/3) only. R is then seen over a short lag, and what it weighs
is that of white noise which averages alike, R (1 + rho) / (1 - rho). Vibration comes at once: by how much
those changes have grown over the longer lag, by that the noise has.

A steady drift is taken off: a trim, a bias. A spike of the gyro is clipped before a lag sums it up: it is no
noise that lasts, and no acceleration. Squares are clipped, so a fault that has not been found yet teaches
little; news count twice, so that what was learned at first is soon outweighed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quadftc_model.arrays import (
    Flag,
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
from quadftc_model.rotations import rotation_between, to_body, to_earth, turn

SMALL = 1e-12  # 1; rounding: rad², rad²/s², or of a determinant over its product
SEVERAL = 3.0  # 1; chosen: readings in a row that are loud, repeated or missing, and no chance
SHORT = 0.01  # s; chosen: short lag of the gyro: beyond its filter
COLOURED = 0.98  # 1; chosen: largest correlation of the noise of two samples
LONG = 0.04  # s; chosen: longer lag of the gyro: some samples, below the motion's period
LONGER = 0.2  # s; chosen: the same of the attitude
CORRELATED = 1.0  # s; chosen: T, as gusts last
MEMORY = 20.0  # s; chosen: of what is learned
PRIOR = 0.25  # s; chosen: what the values at the start are worth
NEWS = 2.0  # 1; chosen: what news count more than in a mean
LOOSE = 100.0  # 1; chosen: largest square over the mean of squares, gyro over the lag
TIGHT = 9.0  # 1; chosen: the same of others: three sigma; so spikes teach little
GYRO = 0.005  # rad/s; chosen: white noise at the start
UNKNOWN = 1.0  # rad/s²; chosen: unknown acceleration at the start
LEAST_UNKNOWN = 0.1  # rad/s²; chosen: unknown acceleration of any vehicle
LEAST_ATTITUDE = math.radians(0.05)  # rad; chosen: white noise of any sensor
ATTITUDE = 2.0 * LEAST_ATTITUDE  # rad; white noise at the start
LEAST_WANDER = math.radians(0.005)  # rad/√s; chosen: of any attitude against any gyro


class Noise(NamedTuple):
    """Variances of noise, axis by axis."""

    gyro: Vector  # white, of a reading [rad²/s²]
    unknown: Vector  # of the unknown acceleration [rad²/s⁴]
    attitude: Vector  # white, of a reading [rad²]
    sway: Vector  # of the attitude, correlated over `LONGER` [rad²]
    wander: Vector  # of attitude against gyro [rad²/s]


class Variogram(NamedTuple):
    """Mean squares of how far readings move apart."""

    near: Vector  # from sample to sample; of the gyro the change of that
    far: Vector  # over the longer lag; of the attitude those of its means
    lag: Vector  # mean of those lags; of the gyro squared [s, s²]
    time: Vector  # of learning [s]
    drift: Vector  # how fast they move apart in the mean [1/s]


class Bend(NamedTuple):
    """How much the gyro's movement over the short lag changes from one lag to the next."""

    square: Vector  # mean of the squares [rad²/s²]
    since: Vector  # movement since the anchor [rad/s]
    until: Vector  # over the lag before that [rad/s]
    age: Scalar  # of the anchor [s]


class Walk(NamedTuple):
    """How far means of the attitude move from the gyro over several lags."""

    square: Vector  # mean of the squares [rad²]
    lag: Vector  # mean of those lags [s]
    moved: Vector  # so far, in earth axes [rad]
    age: Scalar  # of that [s]


class Learning(NamedTuple):
    """Variograms, and where their longer lags begin."""

    gyro: Variogram
    attitude: Variogram
    lately: Vector  # mean square of the gyro from sample to sample, over the longer lag alone [rad²/s²]
    bend: Bend
    moved: Vector  # of the gyro against torque, at the last sample, less spikes [rad/s]
    walked: Vector  # sum of that since the gyro's anchor [rad/s]
    age: Scalar  # of that anchor [s]
    q_xyzw: Quaternion  # attitude at its anchor, turned with the gyro since
    older: Scalar  # age of that anchor [s]
    apart: Vector  # sum of how far readings since are from that [rad]
    number: Scalar  # of those readings
    before: Vector  # from the mean of those over the lag before to that anchor [rad]
    few: Scalar  # 1 over how many those were
    walk: Walk


def start_learning(q_xyzw: Quaternion, gyro: Vector) -> Learning:
    """Start at a sample."""
    zeros = namespace(gyro).zeros_like(gyro)
    white, still, lag = zeros + GYRO**2, zeros + ATTITUDE**2, zeros + LONG**2
    by_torque = Variogram(6.0 * white, 2.0 * white + UNKNOWN**2 * lag, lag, zeros, zeros)
    by_gyro = Variogram(2.0 * still, 2.0 * still, zeros + LONGER, zeros, zeros)
    none, near = zeros[..., 0], by_torque.near
    bend = Bend(near, zeros, zeros, none)
    walk = Walk(2.0 * still, zeros + CORRELATED, zeros, none)
    begun = none, zeros, none, zeros, none + 1.0, walk
    return Learning(by_torque, by_gyro, near, bend, zeros, zeros, none, q_xyzw, *begun)


def learn(
    state: Learning,
    gyro: Vector,
    last_gyro: Vector,
    known: Vector,
    q_xyzw: Quaternion,
    last_q: Quaternion,
    good_gyro: Vector,
    good_attitude: Vector,
    heard: Mask,
    dt: Scalar,
) -> Learning:
    """Learn from a sample: readings, those before, and the known acceleration since [rad/s²].

    How good readings are (..., 3), 0 to 1, is what they count for; ``heard``: the gyro has a reading at all.
    """
    step = column(dt)
    turning = 0.5 * (gyro + last_gyro) * step
    age, older = state.age + dt, state.older + dt
    at_anchor = turn(state.q_xyzw, turning)
    full, fuller = age >= LONG, (older >= LONGER) & any_of(good_attitude > 0.0)[..., 0]
    # gyro against torque: over a sample, spikes clipped, and summed up over the longer lag
    change, bound = gyro - last_gyro - known * step - state.moved, sqrt(TIGHT * state.gyro.near)
    square = smaller(change * change, TIGHT * larger(state.lately, state.gyro.near))
    change = clip(change, -bound, bound) * heard
    moved = state.moved + change
    walked = state.walked + moved * heard
    lately = state.lately + smaller(step / LONG, 1.0) * heard * (square - state.lately)
    # attitude against gyro: over a sample, and of the mean over a lag from the anchor before it
    apart = rotation_between(turn(last_q, turning), q_xyzw) - state.attitude.drift * step
    both = good_gyro * good_attitude
    far = walked - state.gyro.drift * column(age), column(age), full & (age < 2.0 * LONG)
    angle, there = rotation_between(at_anchor, q_xyzw), 1.0 * any_of(good_attitude > 0.0)[..., 0]
    total, count = state.apart + column(there) * angle, state.number + there
    mean = total / column(larger(count, 1.0))
    moved_on = mean + state.before - state.attitude.drift * column(older)
    farther = moved_on, column(older), fuller & (older < 2.0 * LONGER)
    walk = _walked(state.walk, at_anchor, moved_on, older, farther[2], both, state.attitude.time)
    # where a lag is full, its anchor moves here
    return Learning(
        _learned(state.gyro, change, *far, good_gyro, 2, LOOSE, step),
        _learned(state.attitude, apart, *farther, both, 1, TIGHT, step),
        lately,
        _bent(state.bend, moved, good_gyro, state.gyro.time, dt),
        moved,
        where(column(full), 0.0, walked),
        where(full, 0.0, age),
        where(column(fuller), q_xyzw, at_anchor),
        where(fuller, 0.0, older),
        where(column(fuller), 0.0, total),
        where(fuller, 0.0, count),
        where(column(fuller), angle - mean, state.before),
        where(fuller, 1.0 / larger(count, 1.0), state.few),
        walk,
    )


def _walked(
    state: Walk, q_xyzw: Quaternion, moved: Vector, age: Scalar, full: Flag, good: Vector, time: Vector
) -> Walk:
    """Learn from how far means of the attitude have ``moved`` [rad] over a lag that is ``full``.

    The axes turn meanwhile, so none counts more than the least ``good`` (..., 3).
    """
    total, lag = state.moved + to_earth(q_xyzw, moved), state.age + age
    moved, weight = to_body(q_xyzw, total), good.min(axis=-1)
    far = full & (lag >= CORRELATED)
    gain = _gain(column(lag), time) * column(far * weight)
    goes_on = full & (weight > 0.0) & ~far
    return Walk(
        state.square + gain * (smaller(moved * moved, TIGHT * state.square) - state.square),
        state.lag + gain * (column(lag) - state.lag),
        where(column(goes_on), total, where(column(age < LONGER), state.moved, 0.0)),
        where(goes_on, lag, where(age < LONGER, state.age, 0.0)),
    )


def _learned(
    state: Variogram,
    near: Vector,
    far: Vector,
    age: Scalar,
    full: Flag,
    good: Vector,
    power: int,
    clip: float,
    dt: Scalar,
) -> Variogram:
    """Learn from how far readings moved over ``dt`` and ``age`` [s], less their steady drift.

    Variances grow by a power of the lag.
    """
    time = smaller(state.time + dt * good, MEMORY)
    gain, gains = _gain(dt, time) * good, _gain(age, time) * (good * column(full))
    bound = sqrt(clip * state.far)
    moved = smaller(larger(far, -bound), bound)
    return Variogram(
        state.near + gain * (smaller(near * near, TIGHT * state.near) - state.near),
        state.far + gains * (moved * moved - state.far),
        state.lag + gains * (age**power - state.lag),
        time,
        state.drift + gains * moved / larger(age, 1e-9),
    )


def _bent(state: Bend, moved: Vector, good: Vector, time: Vector, dt: Scalar) -> Bend:
    """Learn from how far the gyro moved over ``dt`` [s] against torque [rad/s]."""
    since, age = state.since + moved, state.age + dt
    full = column(age >= SHORT - 1e-6)
    gain = _gain(column(age), time) * good * (full & (column(age) < 2.0 * SHORT))
    news = smaller((since - state.until) ** 2, LOOSE * state.square) - state.square
    return Bend(
        state.square + gain * news,
        where(full, 0.0, since),
        where(full, since, state.until),
        where(age >= SHORT - 1e-6, 0.0, age),
    )


def _gain(lag: Scalar, time: Vector) -> Vector:
    """Return what the news of a ``lag`` are worth in a mean of a ``time`` [s]."""
    return smaller(NEWS * lag / (PRIOR + time), 1.0)


def noise_of(state: Learning, driven: Flag, dt: Scalar) -> Noise:
    """Return the variances that explain both lags.

    Unless the vehicle is ``driven`` by a torque that is known, motion moves the gyro as noise does. But white
    noise makes the angle wander: there is no more of it than the attitude wanders from the gyro.
    """
    gyro, attitude = state.gyro, state.attitude
    total, still = larger(gyro.near, state.bend.square) / 6.0 + SMALL, attitude.near / 2.0
    rho = clip(2.0 - sqrt(1.0 + 0.5 * gyro.near / total), 0.0, COLOURED)
    white, still = louder(state) * total * (1.0 + rho) / (1.0 - rho), larger(still, LEAST_ATTITUDE**2)
    unknown = larger((gyro.far - 2.0 * total) / gyro.lag, LEAST_UNKNOWN**2)
    # two sigma of a mean of squares
    of_mean = 2.0 * still * column(state.few)
    near, far = (
        each - of_mean * (1.0 + 2.0 * sqrt(2.0 * lag / (PRIOR + attitude.time)))
        for each, lag in ((attitude.far, LONGER), (state.walk.square, state.walk.lag))
    )
    of_sway, of_more = _swayed(attitude.lag), _swayed(state.walk.lag)
    walks, walks_more = attitude.lag - LONGER / 3.0, state.walk.lag - LONGER / 3.0
    wander = (far * of_sway - near * of_more) / (walks_more * of_sway - walks * of_more)
    wander = larger(wander, LEAST_WANDER**2)
    sway = larger(near - wander * walks, 0.0) / of_sway
    most = 3.0 / 2.0 * attitude.far / attitude.lag / column(larger(dt, SMALL))
    return Noise(where(column(driven), white, smaller(white, most)), unknown, still, sway, wander)


def _swayed(lag: Vector) -> Vector:
    """Return the variance of how far means over `LONGER` move over a ``lag`` [s], for a sway of 1."""
    return 2.0 * (2.0 / math.e - (1.0 - 1.0 / math.e) ** 2 * exp(1.0 - lag / LONGER))


def louder(state: Learning) -> Vector:
    """Return by how much the variance of the gyro's noise has risen of late."""
    return larger(state.lately / larger(state.gyro.near, SMALL), 1.0)
