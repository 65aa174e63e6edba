"""Readings that are absent or repeated: rules, as no model of the motion has a say in that.

A sensor may be slower than the gyro. It is absent when several readings in a row have not come.

Without noise, as in a simulation, readings change less and less when the vehicle comes to rest. That they
repeat says nothing then. Those of a sensor with noise stop at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quadftc_fdi.bank.noise import LONG, MEMORY, NEWS, PRIOR, SEVERAL, SMALL, TIGHT
from quadftc_model.arrays import (
    Flag,
    Mask,
    Scalar,
    Vector,
    clip,
    column,
    larger,
    log,
    namespace,
    smaller,
    sqrt,
    where,
)
from quadftc_model.samples import UNUSABLE

SAME = 1e-3  # 1; chosen: change over the usual change below which a reading is repeated
CHANCE = 0.01  # 1; chosen: of a repeated reading, at first; squared, at least
RARE = math.log(1e-7)  # 1; chosen: log of a chance that is none
COARSE = 10.0  # 1; chosen: chance of a repeated reading over its grain and usual change
LIKELY = 0.7  # 1; chosen: of a repeated reading, at most
BACK = 0.3  # s; chosen: for which a sensor must look healthy to be believed again


class Readings(NamedTuple):
    """What is remembered of the last readings of a sensor with three elements."""

    last: Vector
    repeats: Vector  # how often that was repeated
    chance: Vector  # share of repeated readings, learned
    missed: Vector  # how many have not come since the last
    gap: Vector  # usual time between two [s]
    grain: Vector  # smallest change from reading to reading so far
    lately: Vector  # mean square of the changes of late
    learned: Vector  # for how long there have been some [s]
    absent: Vector  # for how long it counts as absent still [s]
    stuck: Vector  # the same of stuck [s]
    silence: Vector  # for how long there has been no new reading [s]


def start_readings(reading: Vector) -> Readings:
    """Start at a reading."""
    zeros = namespace(reading).zeros_like(reading)
    often, slow, any_change = zeros + CHANCE, zeros + BACK / SEVERAL, zeros + UNUSABLE
    changes = any_change, any_change
    return Readings(reading, zeros, often, zeros, slow, *changes, zeros, zeros, zeros, zeros)


def take_reading(state: Readings, reading: Vector, there: Flag, usual: Vector, dt: Scalar) -> Readings:
    """Take a reading, if one is ``there``; ``usual`` is the mean square of its changes."""
    present = column(there)
    missed = state.missed + smaller(dt / state.gap, 1.0)
    gone = was_there(state) & ~present & (missed > SEVERAL - 0.5)
    took = smaller(missed, SEVERAL) * state.gap
    change = abs(reading - state.last)
    same = present & (change <= SAME * sqrt(smaller(usual, state.lately)))
    quiet = state.lately < SAME**2 * usual
    learns = (took / MEMORY) * (present & (state.repeats < SEVERAL))
    new = present & ~same
    by_grain = smaller(COARSE * state.grain / sqrt(usual + SMALL), LIKELY)
    chance = state.chance + learns * (same - state.chance)
    repeats = where(present, (state.repeats + 1.0) * same, state.repeats)
    square = smaller(change * change, TIGHT * larger(state.lately, usual))
    share = where(state.lately < UNUSABLE, smaller(took / LONG, 1.0), 1.0)
    repeated = ~quiet & (repeats * log(clip(larger(chance, by_grain), CHANCE**2, LIKELY)) < RARE)
    return Readings(
        last=where(new, reading, state.last),
        repeats=repeats,
        chance=chance,
        missed=missed * ~present,
        gap=state.gap + smaller(NEWS * took / (PRIOR + state.learned), 1.0) * (took - state.gap) * present,
        grain=where(new & (usual > 0.0), smaller(state.grain, change), state.grain),
        lately=where(new, state.lately + share * (square - state.lately), state.lately),
        learned=smaller(state.learned + took * present, MEMORY),
        absent=where(gone, BACK, larger(state.absent - dt, 0.0)),
        stuck=where(repeated, BACK, larger(state.stuck - dt, 0.0)),
        silence=(state.silence + dt) * ((state.absent > 0.0) | (state.stuck > 0.0) | ~new),
    )


def was_there(state: Readings) -> Mask:
    """Whether there has been a reading."""
    return state.learned > 0.0


def is_stuck(state: Readings) -> Mask:
    """Whether readings are, or were of late, repeated more often than by chance."""
    return state.stuck > 0.0


def is_absent(state: Readings) -> Mask:
    """Whether there are no readings any more, or were none of late."""
    return state.absent > 0.0


def is_witness(state: Readings) -> Mask:
    """Whether what is read tells of the motion, at this sample or soon again."""
    return was_there(state) & ~is_stuck(state) & ((state.missed <= 0.0) | ~is_absent(state))
