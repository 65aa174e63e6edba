"""Axes of a sensor that are not believed: what they read too much, and when they are right again.

An attitude that is not believed is left out, and the gyro takes its place. A gyro that is not believed is a
gyro whose bias walks quickly: it still says how the rate changes from sample to sample.

A gyro that scatters is weighed by that, and still believed. That one axis alone gets noisier, for long, is no
vibration: on healthy recordings the axes share it.

A sensor that reads right is believed again, but a wrong scale or a delay shows in motion alone. So its errors
are fitted, by least squares, by the motion: an attitude's by angle and rate, a gyro's by rate and angular
acceleration. Where that explains most of them, and more than an offset, time counts while they would show.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_fdi.bank import hypotheses, inference, modes
from quadftc_fdi.bank.hypotheses import Bank
from quadftc_fdi.bank.inference import Posterior
from quadftc_fdi.bank.motion import (
    BETA,
    CORRELATED,
    LAG,
    OMEGA,
    STATES,
    THETA,
    WALK,
    D,
    Motion,
    moved_by,
    unsettled,
)
from quadftc_fdi.bank.noise import SMALL, TIGHT
from quadftc_fdi.bank.readings import BACK
from quadftc_model.arrays import (
    Array,
    Flag,
    Mask,
    Scalar,
    Vector,
    any_of,
    column,
    exp,
    larger,
    log,
    namespace,
    stacked,
    where,
)
from quadftc_model.rotations import euler_from_quaternion, wrap
from quadftc_model.samples import ImuSample

FAULTY_WALK = 3.0  # rad/s/√s; chosen: walk of the bias of a gyro that is not believed
AGREES = CORRELATED  # s; longer than a gust lasts: for which what seems right must agree with the motion
SOON = 0.05  # s; chosen: for which an attitude must agree after a jump back
SEEN = 12.0  # 1; derived: log-likelihood of a jump back, by 99 % and a prior of 1e-3 a sample
AVERAGE = 0.02  # s; chosen: over which sizes of attitude faults are averaged
NEAR = 4.0  # 1; chosen: square of a gyro's bias over its variance that is as before: two sigma
ALONE = 0.4  # 1; measured: rms of `Scatter.alone` in the least even of 24 healthy real recordings
SPREAD = 1.2  # 1; chosen: variance of a faulty attitude about its size, over its noise


class Trust(NamedTuple):
    """What is known of a sensor's axes."""

    faulty: Mask
    age: Vector  # of the fault [s]
    size: Vector  # reading less motion
    other: Vector  # of the attitude the largest size; of the gyro its bias before the fault
    evidence: Vector  # of the attitude log-likelihood ratio that it is over
    calm: Vector  # for how long it has looked healthy [s]
    sums: Array  # of products of 1, error and motion over the variance of the error (..., 3, 8)


class Scatter(NamedTuple):
    """Noise of the gyro's axes, one beside the others."""

    alone: Vector  # log of by how much its variance has risen over that of the others, mean over `CORRELATED`
    age: Vector  # for how long that has been more than usual [s]
    noisy: Mask  # by a fault
    quiet: Vector  # for how long it has been no noisier than the others [s]


def full_trust(like: Vector) -> Trust:
    """Start with all axes believed."""
    xp = namespace(like)
    zeros = xp.zeros_like(like)
    return Trust(zeros > 0.0, zeros, zeros, zeros, zeros, zeros, xp.zeros((*like.shape, 8)))


def acquitted(state: Trust, axes: Mask) -> Trust:
    """Believe axes again."""
    return _kept(state.faulty & ~axes, state.sums, *state[1:-1])


def take_over(
    motion: Motion,
    bank: Bank,
    posterior: Posterior,
    mode: Array,
    added: Array,
    alone: Mask,
    driven: Flag,
) -> tuple[Motion, Bank, Scalar]:
    """Believe the likeliest onset of a mode (..., modes): return motion, bank and age of that onset [s].

    ``added`` (..., 3, effects) is what a faulty attitude adds to its rotation vector. Gyros are ``alone``
    where there is no attitude; ``driven``: the torque is known.
    """
    xp = namespace(posterior.log_weight)
    own = where(mode[..., None], posterior.log_weight, 2.0 * hypotheses.LOWEST)
    pick = 1.0 * (mode[..., None] & (own == own.max(axis=(-1, -2), keepdims=True)))
    pick = pick / larger(pick.sum(axis=(-1, -2), keepdims=True), 1.0)  # onsets may be alike

    def of(part: Array) -> Array:
        return (pick * part).sum(axis=(-1, -2))

    # what a faulty gyro reads too much is its bias from now on; an attitude that jumped, or lags, is usual
    effect = inference.by_effect(pick)
    usual = 1.0 * (mode & ~modes.IS_FAULT).any(axis=-1)
    states = np.arange(STATES)[:, None, None]
    gyro = modes.pattern(modes.GYRO) + column(motion.rate + motion.bias) * modes.pattern(modes.SCALED)
    of_gyro = np.equal(states, BETA) * gyro[..., None, :, :]
    jumps = (
        np.equal(states, THETA) * (added * (modes.KIND[: modes.EFFECTS] == modes.ATTITUDE))[..., None, :, :]
    )
    lags = np.equal(states, LAG) * modes.pattern(modes.LATE)
    moves = of_gyro + column(column(column(usual))) * (jumps + lags)
    changed = bank.U + moves[..., modes.COLUMN, None] * hypotheses.shape_of(bank)[..., None, None, :, :]
    picked = (changed * effect[..., None, None, modes.COLUMN, :]).sum(axis=-1)
    by_size, by_slope = (
        picked[..., part].sum(axis=-1).swapaxes(-1, -2)
        for part in (slice(modes.EFFECTS), slice(modes.EFFECTS, None))
    )
    U = xp.stack([by_size, by_slope], axis=-2)  # (..., 3, 2, 10)
    b = xp.stack([of(posterior.b[..., k, :, :]) for k in range(2)], axis=-1)
    first, mixed, last = (of(posterior.covariance[..., k, :, :]) for k in range(3))
    spread = xp.stack([xp.stack([first, mixed], axis=-1), xp.stack([mixed, last], axis=-1)], axis=-2)
    change = (U * b[..., None, :, None]).sum(axis=-2)
    P = motion.covariance + U.swapaxes(-1, -2) @ spread[..., None, :, :] @ U
    axes = (mode[..., None] & (modes.AXIS[:, None] == np.arange(3))).any(axis=-2)
    age = of(bank.age[..., modes.EFFECT, :])
    # a jump or lag of the attitude says nothing of a gyro that the torque may yet find
    slight = ((modes.KIND == modes.JUMP) | (modes.KIND == modes.LAG)) & column(driven)
    settled = axes & ~column((mode & slight).any(axis=-1))
    bank = hypotheses.forget(bank, axes, settled, alone)
    return moved_by(motion, change)._replace(covariance=P), bank, age


def watch_gyro(
    state: Trust,
    named: Mask,
    age: Scalar,
    motion: Motion,
    known: Vector,
    before: Vector,
    louder: Vector,
    dt: Scalar,
) -> Trust:
    """Watch a gyro until its bias [rad/s] is what it was ``before``; ``known`` is the acceleration [rad/s²].

    It must be hardly ``louder`` than usual, too: by that factor the variance of its noise has risen.
    """
    begins = named & ~state.faulty
    usual = where(begins, before, state.other)
    size = motion.bias - usual
    variance = motion.covariance[..., BETA, BETA]
    agrees = (size * size < NEAR * variance) & (louder < TIGHT)
    sums, shows = _fitted(state.sums, begins, size, variance, motion.rate, known + motion.unknown)
    calm = where(named, 0.0, (state.calm + dt * shows) * agrees)
    faulty = (state.faulty | named) & (calm < BACK)
    return _kept(faulty, sums, where(begins, column(age), state.age + dt), size, usual, 0.0 * usual, calm)


def watch_attitude(
    state: Trust,
    named: Mask,
    age: Scalar,
    off: Vector,
    variance: Vector,
    noise: Vector,
    there: Flag,
    motion: Motion,
    dt: Scalar,
) -> Trust:
    """Watch an attitude that reads ``off`` [rad] by the motion, with a variance, of which noise is a part.

    Its fault is over when it was seen to jump back, or when it has agreed for long.
    """
    begins, present = named & ~state.faulty, column(there)
    news, spread = off - state.size, SPREAD * noise
    fits, goes_on = off * off / variance, news * news / spread
    ratio = 0.5 * (goes_on - fits - log(variance / spread))
    size = where(begins, off, state.size + (1.0 - exp(-dt / AVERAGE)) * news * present)
    peak = where(begins, abs(off), larger(state.other, abs(size)))
    agrees = present & ~begins & (fits < TIGHT) & ((abs(size) < 0.5 * peak) | (size * size < variance))
    # a reading that agrees for other reasons tells nothing new with each sample: jumps alone count
    evidence = where(fits < TIGHT, state.evidence + ratio * (present & (goes_on > TIGHT)), 0.0)
    heard, angles = where(present, variance, math.inf), euler_from_quaternion(motion.q_xyzw)
    sums, shows = _fitted(state.sums, begins, off, heard, angles, motion.rate)
    calm = (state.calm + dt * shows) * agrees
    over = (calm > AGREES) | ((calm > SOON) & (evidence > SEEN))
    faulty = (state.faulty | named) & ~over
    evidence = where(begins, 0.0, larger(evidence, 0.0))
    return _kept(faulty, sums, where(begins, column(age), state.age + dt), size, peak, evidence, calm)


def no_scatter(like: Vector) -> Scatter:
    """Start with axes that are alike."""
    zeros = namespace(like).zeros_like(like)
    return Scatter(zeros, zeros, zeros > 0.0, zeros)


def watch_scatter(state: Scatter, louder: Vector, driven: Flag, few: float, dt: Scalar) -> Scatter:
    """Watch by how much the variance of the gyro's noise has risen on one axis alone.

    That is a fault if it is chance with a probability of at most ``few``; hands that move a vehicle which is
    not ``driven`` do so, too.
    """
    rise = log(louder)
    more = rise - where(np.eye(3) > 0.0, 0.0, rise[..., None, :]).max(axis=-1)
    alone = state.alone + (1.0 - exp(-dt / CORRELATED)) * (more - state.alone)
    least = -log(few * modes.RATE[3 * modes.GYRO] * CORRELATED)
    begins = (alone > 0.0) & (0.5 * (alone / ALONE) ** 2 > least) & column(driven)
    quiet = where(more > ALONE, 0.0, state.quiet + dt)
    noisy = (state.noisy | begins) & (quiet < BACK)
    alone = where(state.noisy & ~noisy, 0.0, alone)
    return Scatter(alone, where(noisy | (alone > ALONE), state.age + dt, 0.0), noisy, quiet)


def _fitted(
    sums: Array, begins: Mask, error: Vector, variance: Vector, first: Vector, second: Vector
) -> tuple[Array, Mask]:
    """Add an error to the sums; also return whether such a fault would show now.

    The error is fitted by two parts of the motion.
    """
    one, variance = namespace(error).ones_like(error), larger(variance, SMALL)
    pairs = (one, one), (one, error), (error, error), (first, error), (second, error)
    products = stacked([a * b for a, b in (*pairs, (first, first), (first, second), (second, second))])
    sums = where(column(begins), 0.0, sums) + products / column(variance)
    n, e, ee, xe, ye, xx, xy, yy = (sums[..., k] for k in range(8))
    det = larger(xx * yy - xy * xy, larger(SMALL * xx * yy, SMALL**2))
    by_first, by_second = (yy * xe - xy * ye) / det, (xx * ye - xy * xe) / det
    due = by_first * first + by_second * second
    moves = by_first * xe + by_second * ye > larger(0.5 * ee, e * e / larger(n, SMALL))
    return sums, (due * due > NEAR * variance) | ~moves


def _kept(faulty: Mask, sums: Array, *parts: Vector) -> Trust:
    age, size, other, evidence, calm = (where(faulty, part, 0.0) for part in parts)
    return Trust(faulty, age, size, other, evidence, calm, where(column(faulty), sums, 0.0))


def as_before(motion: Motion, gyro: Trust, axes: Mask) -> Motion:
    """Return a motion with the bias that gyros (..., 3) had before a fault that was none."""
    own = np.arange(STATES) == BETA
    walked = (WALK**2 * gyro.age)[..., None, None] * np.diag(1.0 * own)
    P = where(column(column(axes)) & (own | own[:, None]), walked, motion.covariance)
    return motion._replace(bias=where(axes, gyro.other, motion.bias), covariance=P)


def any_faulty(*sensors: Trust) -> Mask:
    """Return of which sensors any axis is faulty (..., sensors)."""
    return stacked([any_of(each.faulty)[..., 0] for each in sensors])


def off_square(before: Vector, imu: ImuSample, believed: Motion, good: Mask) -> Vector:
    """Return the square of how far an attitude is off [rad²]: before a fault is believed, or after, if more.

    After counts where the attitude is ``good`` (..., 3).
    """
    after = wrap(euler_from_quaternion(imu.q_xyzw) - euler_from_quaternion(believed.q_xyzw))
    return larger(before * before, where(good, after * after, 0.0))


def doubted(believed: Motion, angle: Vector, gyro: Mask, named: Mask) -> Motion:
    """Doubt what a gyro that is named now has taught; ``angle`` is the least variance of the angles [rad²].

    A step or drift has told what the rate is; one that oscillates or lags has not.
    """
    believed = unsettled(believed, THETA, angle)
    wild = named[..., inference.WILDS] * modes.GYRO_SIZE**2
    believed = unsettled(believed, OMEGA, wild)
    return unsettled(believed, D, where(gyro, believed.unknown**2, 0.0))
