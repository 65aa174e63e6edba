"""From the weights of hypotheses to what is believed and said: probabilities, the mode to name, states."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.bank import inference, modes, noise, readings
from quadftc_fdi.bank.hypotheses import Bank
from quadftc_fdi.bank.inference import Posterior
from quadftc_fdi.bank.readings import Readings
from quadftc_fdi.bank.trust import AGREES, Scatter, Trust
from quadftc_model import samples
from quadftc_model.arrays import (
    Array,
    Flag,
    Mask,
    Vector,
    at_largest,
    branch,
    column,
    exp,
    larger,
    log,
    namespace,
    smaller,
    sqrt,
    where,
)
from quadftc_model.samples import FAULT_KINDS, SensorEstimate

OFFSET, STUCK, NOISE, ABSENT = (FAULT_KINDS.index(name) for name in ("offset", "stuck", "noise", "absent"))

OTHER_NAMES = 1.0 * np.equal(modes.AXIS[:, None], modes.AXIS) - modes.SAME  # of one axis (modes, modes)


class Seen(NamedTuple):
    """What a sensor reads by the motion."""

    off: Vector  # reading less motion
    variance: Vector  # of that
    mine: Array  # probability of its modes (..., 3)
    there: Flag  # there is a reading (..., 1)


class Probabilities(NamedTuple):
    """How likely hypotheses and modes are; of modes (..., modes)."""

    of_onsets: Array  # of each hypothesis (..., modes, slots)
    of_modes: Array
    left: Array  # what may be instead of each mode
    log_weight: Array  # of modes against none, whatever else there is
    alone: Array  # of modes, if no other axis has changed besides


def probabilities(state: Bank, posterior: Posterior) -> Probabilities:
    """Weigh hypotheses against each other.

    Several axes may have changed. So what is likely on another axis is left beside a mode only as far as it
    explains what that mode's axis has shown.

    Vibration has its share of a wild gyro. It is left beside a less likely offset of that gyro, too: else the
    offset would be named for it.
    """
    weight, own = posterior.log_weight, np.arange(3)[:, None] == modes.AXIS
    likeliest = weight.max(axis=-1)
    shares = exp(weight - likeliest[..., None])
    onsets = shares.sum(axis=-1)
    rank = likeliest + log(onsets)
    of_axes = branch(
        rank.max(axis=-1) > 0.0,  # seldom
        lambda: _apart(rank, inference.explained_by_axis(state, posterior), own),
        lambda: 0.0 * own + rank[..., None, :],
    )  # (..., axes, modes)
    highest = larger(of_axes.max(axis=-1), 0.0)
    of_axes, none = exp(of_axes - highest[..., None]), exp(-highest)
    total = none + of_axes.sum(axis=-1)
    of_axes, none = of_axes / total[..., None], none / total
    p = (of_axes * own).sum(axis=-2)
    shares = shares * (p / onsets)[..., None]
    others = (none + (of_axes * ~own).sum(axis=-1))[..., modes.AXIS]
    others = others + p @ OTHER_NAMES  # a sum, as 1 - p would lose it to rounding
    wild = modes.KIND == modes.WILD
    vibration = posterior.vibration[..., modes.AXIS] * wild
    vibrates, same = p * vibration, modes.SAME - np.eye(modes.MODES)
    left = others + vibrates + (vibrates @ same) * (p < (p * wild) @ same)
    top = larger(rank.max(axis=-1, keepdims=True), 0.0)
    alone = exp(rank - top)
    alone = alone / (exp(-top) + alone.sum(axis=-1, keepdims=True))
    still = 1.0 - vibration
    return Probabilities(shares * still[..., None], p * still, left, rank, alone * still)


def _apart(rank: Array, explained: Array, own: NDArray[np.bool_]) -> Array:
    """Return what modes are worth beside those of each axis (..., axes, modes), as logs.

    A mode of another axis is worth no more than what it ``explained`` (..., axes, modes), by axis of the
    innovations, together with the likeliest mode of that axis; ``own`` (axes, modes).
    """
    best = at_largest(where(own, rank[..., None, :], -np.inf))
    of_best = (explained[..., None, :, :] * best[..., None, :]).sum(axis=-1)  # (..., axes, of innovations)
    both = smaller(of_best[..., None], explained[..., None, :, :])
    shared = larger(both, 0.0).sum(axis=-2)
    return where(own, rank[..., None, :], smaller(rank[..., None, :], shared))


def named_mode(
    given: Probabilities,
    aged: Array,
    asked: Mask,
    good_gyro: Mask,
    driven: Flag,
    few: float,
    repeats_gyro: bool,
) -> Array:
    """Which mode to believe (..., modes); at most one: the likeliest of a name that is beyond doubt.

    ``aged`` is the probability times the age of its onset [s]; ``few`` what may be left beside it.

    Twice the certainty is needed without a torque, and of an attitude without a gyro: only one witness is
    left. It is needed of an attitude of which the position is ``asked`` (..., 3), as that speaks late; of
    whatever returns; and of an attitude that jumps, which must have stayed. Thrice is needed of a push, a
    lag, and a younger jump: these hide what began with them. A wild gyro must be so until vibration is heard.
    """
    kind, name, p = modes.KIND, modes.NAME, given.of_modes
    last = ((name == modes.ATTITUDE) & (~good_gyro | asked)[..., modes.AXIS]) | ~driven
    stays = (kind == modes.JUMP) & (aged > readings.BACK * p)
    twice = last | stays | (kind == modes.RETURN) | (kind == modes.GYRO_RETURN) | (kind == modes.WILD)
    least = where(twice, few * few, where(modes.IS_FAULT, few, few**3))
    # a jump of an attitude that repeats the gyro is its estimator's
    takes = ((name != modes.ATTITUDE) & (kind != modes.RETURN)) | (not repeats_gyro)
    sure = given.left < least * takes
    heard = (kind != modes.WILD) | (aged > noise.LONG * p)
    alike = (1.0 * (sure & heard)) @ modes.SAME > 0.0
    weight = where(alike, given.log_weight, -np.inf)
    return alike & (weight == weight.max(axis=-1, keepdims=True))


def said_of(sensor: int, of_modes: Array) -> Vector:
    """Add up what is said of faults of attitude or gyro, by axis."""
    return of_modes[..., sensor == modes.NAME].reshape(*of_modes.shape[:-1], -1, 3).sum(axis=-2)


def how_sound(given: Probabilities, age: Array) -> tuple[Vector, Vector]:
    """Return how likely gyro and attitude (..., 3) have no fault that lasts, by the ``age`` of onsets [s].

    What such a fault shows is no noise, named or not. A younger one may be chance, and teaches little.
    """
    lasting = (given.of_onsets * (age[..., modes.EFFECT, :] > AGREES)).sum(axis=-1)
    return 1.0 - said_of(modes.GYRO, lasting), 1.0 - said_of(modes.ATTITUDE, lasting)


def is_unsure(given: Probabilities, counts: NDArray[np.bool_], level: float) -> Mask:
    """Return the axes (..., 3) of which some sensor is faulty, or that are suspect as it may be any.

    ``counts`` (modes,): the faults in question.
    """
    own, alone = (
        (of_modes * counts).reshape(*of_modes.shape[:-1], -1, 3).sum(axis=-2)
        for of_modes in (given.of_modes, given.alone)
    )
    return (own > level) | (column(alone.sum(axis=-1) > level) & (alone > 1.0 - level))


def judge(
    state: Trust, read: Readings, scatter: Scatter, seen: Seen, unsure: Mask, few: float
) -> SensorEstimate:
    """Say what is believed of a sensor; ``unsure`` (..., 3): one of several has a fault.

    It is ambiguous with a probability above ``few`` for it.
    """
    xp = namespace(seen.off)
    stuck, absent = readings.is_stuck(read), readings.is_absent(read)
    certain: Mask = state.faulty | stuck | absent | scatter.noisy
    ambiguous = unsure & (seen.mine > few) & ~certain
    declared = certain | ambiguous
    suspect = where(seen.mine > 0.5, samples.SUSPECT, samples.HEALTHY)
    suspect = where(readings.was_there(read), suspect, samples.STARTING)
    faulty = where(state.calm > 0.0, samples.RECOVERING, samples.FAULTY)
    kind = where(absent, ABSENT, where(stuck, STUCK, where(scatter.noisy & ~state.faulty, NOISE, OFFSET)))
    age = where(
        state.faulty, state.age, where(stuck | absent, read.silence, where(scatter.noisy, scatter.age, 0.0))
    )
    # a fault that is known has a size while readings are absent, too
    unknown = where(declared & ~absent, seen.off, 0.0)
    size = where(state.faulty, where(seen.there, seen.off, state.size), unknown)
    return SensorEstimate(
        where(declared, faulty, suspect).astype(xp.uint8),
        size,
        smaller(sqrt(seen.variance), samples.MAX_BODY_RATE),
        where(declared, age, -1.0),
        where(certain, 1.0, seen.mine),
        where(declared, kind, 0).astype(xp.uint8),
        ambiguous,
    )
