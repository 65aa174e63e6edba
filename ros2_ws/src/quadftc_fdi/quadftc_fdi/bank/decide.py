"""From the weights of hypotheses to what is believed and said: probabilities, the mode to name, states."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.bank import modes, noise, readings
from quadftc_fdi.bank.inference import Posterior
from quadftc_fdi.bank.readings import Readings
from quadftc_fdi.bank.trust import Scatter, Trust
from quadftc_model import samples
from quadftc_model.arrays import (
    Array,
    Flag,
    Mask,
    Vector,
    column,
    exp,
    larger,
    namespace,
    smaller,
    sqrt,
    where,
)
from quadftc_model.samples import FAULT_KINDS, SensorEstimate

OFFSET, STUCK, NOISE, ABSENT = (FAULT_KINDS.index(name) for name in ("offset", "stuck", "noise", "absent"))


class Seen(NamedTuple):
    """What a sensor reads by the motion."""

    off: Vector  # reading less motion
    variance: Vector  # of that
    mine: Array  # probability of its modes (..., 3)
    there: Flag  # there is a reading (..., 1)


def probabilities(posterior: Posterior) -> tuple[Array, Array, Array]:
    """Return the probability of hypotheses and modes, and what is left beside each mode (..., modes).

    Vibration has its share of a wild gyro. It is left beside a less likely offset of that gyro, too: else the
    offset would be named for it.
    """
    weight = posterior.log_weight
    highest = larger(weight.max(axis=-2).max(axis=-1), 0.0)
    shares, none = exp(weight - highest[..., None, None]), exp(-highest)
    total = none + shares.sum(axis=-2).sum(axis=-1)
    shares = shares / total[..., None, None]
    p = shares.sum(axis=-1)
    others = p @ (1.0 - modes.SAME)  # a sum, as 1 - p would lose it to rounding
    wild = modes.KIND == modes.WILD
    vibration = posterior.vibration[..., modes.AXIS] * wild
    vibrates, same = p * vibration, modes.SAME - np.eye(modes.MODES)
    left = column(none / total) + others + vibrates + (vibrates @ same) * (p < (p * wild) @ same)
    return shares * (1.0 - vibration)[..., None], p * (1.0 - vibration), left


def named_mode(
    p: Array,
    doubt: Array,
    aged: Array,
    asked: Mask,
    good_gyro: Mask,
    driven: Flag,
    few: float,
    repeats_gyro: bool,
) -> Array:
    """Which mode to believe (..., modes); at most one: the likeliest of a name that is beyond doubt.

    ``aged`` is p times the age of its onset [s]; ``few`` the probability that may be left beside it.

    Twice the certainty is needed without a torque, and of an attitude without a gyro: only one witness is
    left. It is needed of an attitude of which the position is ``asked`` (..., 3), as that speaks late; of
    whatever returns; and of an attitude that jumps, which must have stayed. Thrice is needed of a push, a
    lag, and a younger jump: these hide what began with them. A wild gyro must be so until vibration is heard.
    """
    kind, name = modes.KIND, modes.NAME
    last = ((name == modes.ATTITUDE) & (~good_gyro | asked)[..., modes.AXIS]) | ~driven
    stays = (kind == modes.JUMP) & (aged > readings.BACK * p)
    twice = last | stays | (kind == modes.RETURN) | (kind == modes.GYRO_RETURN) | (kind == modes.WILD)
    least = where(twice, few * few, where(modes.IS_FAULT, few, few**3))
    # a jump of an attitude that repeats the gyro is its estimator's
    takes = ((name != modes.ATTITUDE) & (kind != modes.RETURN)) | (not repeats_gyro)
    sure = doubt < least * takes
    heard = (kind != modes.WILD) | (aged > noise.LONG * p)
    alike = (1.0 * (sure & heard)) @ modes.SAME > 0.0
    return alike & (p == (p * alike).max(axis=-1, keepdims=True))


def said_of(sensor: int, of_modes: Array) -> Vector:
    """Add up what is said of faults of attitude or gyro, by axis."""
    return of_modes[..., sensor == modes.NAME].reshape(*of_modes.shape[:-1], -1, 3).sum(axis=-2)


def judge(
    state: Trust, read: Readings, scatter: Scatter, seen: Seen, unsure: Flag, few: float
) -> SensorEstimate:
    """Say what is believed of a sensor; ``unsure``: one of several has a fault.

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
    return SensorEstimate(
        where(declared, faulty, suspect).astype(xp.uint8),
        where(state.faulty & ~seen.there, state.size, where(declared & ~absent, seen.off, 0.0)),
        smaller(sqrt(seen.variance), samples.MAX_BODY_RATE),
        where(declared, age, -1.0),
        where(certain, 1.0, seen.mine),
        where(declared, kind, 0).astype(xp.uint8),
        ambiguous,
    )
