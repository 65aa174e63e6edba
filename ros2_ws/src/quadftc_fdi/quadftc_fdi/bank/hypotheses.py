"""Hypotheses: which mode, since when; separate-bias filters behind one filter of the motion.

Let the truth differ from what the filter believes by U b, with b = (size, slope) of a mode that began at an
onset. The innovations e, of variance V, then have the mean S b. Friedland (1969), Willsky and Jones (1976):

    U <- F U + G,   S = H U + h,   U <- U - K S,   J += S' S / V,   d += S' e / V

Onsets have slots, in four rings. So a hypothesis "since 40 ms" has never used the samples since. A ring takes
an onset every `SPACING`; of its slots the least likely goes, and the oldest where nothing is likely.

A small step of the gyro shows little at first, and any other onset refutes it where the torque is known. An
onset stays there, too, while a fault has shown more than ln n, whatever it is worth beforehand: chance shows
that at the luckiest of the n onsets which its ring has taken since.

A sensor that drifts may be right again before it is named: it jumps back to where the filter no longer is. A
return is the likeliest fault of attitude or gyro so far, with all that speaks for it. From its onset on that
fault adds nothing, but U moves on.

What a named fault explains speaks for no other: hypotheses on other axes lose what its axis has shown. So J
and d are kept apart by the axis of the innovation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.bank.modes import (
    AXIS,
    COLUMN,
    EFFECTS,
    GYRO,
    GYRO_RETURN,
    IS_FAULT,
    KIND,
    MORE,
    NAME,
    PRODUCT,
    PUSH,
    RATE,
    RETURN,
    SCALED,
    SLOPES,
    pattern,
)
from quadftc_fdi.bank.motion import BETA, CORRELATED, LAG, LEAN, OMEGA, SCALE, STATES, SWAY, THETA, D, Gains
from quadftc_fdi.bank.noise import LONGER
from quadftc_fdi.bank.noise import PRIOR as LEARNING
from quadftc_model.arrays import (
    Array,
    Flag,
    Mask,
    Scalar,
    Vector,
    at_largest,
    column,
    exp,
    larger,
    log,
    namespace,
    where,
)

SPACING = (0.004, 0.04, 0.25, 1.5)  # s; chosen: how often each ring takes an onset
SLOTS = (9, 12, 11, 8)  # 1; chosen: how many onsets each ring has, 40 in all
RING = np.repeat(np.arange(len(SLOTS)), SLOTS)
FIRST = np.cumsum((0, *SLOTS))
OF_GYRO, OF_ATTITUDE = range(2)  # channels
TESTS = (slice(3, 6), slice(0, 3))  # modes that test a channel: of the gyro, of the attitude
DOUBT = 1.5  # 1; chosen: temper at the start
NEVER = -1.0  # s; mark: age of a slot without an onset
LOWEST = -1e9  # 1; mark: log weight of such a slot
RETURNS = ((RETURN, OF_ATTITUDE), (GYRO_RETURN, OF_GYRO))  # and whose faults they end
# log of the prior: rate times what a slot covers
USUAL = np.log(RATE)[:, None] + np.log(np.array(SPACING))[RING]


class Bank(NamedTuple):
    """Hypotheses (..., effects, slots), by columns or products of `modes` where they have size and slope."""

    U: Array  # by states and axes (..., 10, 3, columns, slots)
    J: Array  # by channel and axis (..., 2, 3, products, slots)
    d: Array  # (..., 2, 3, columns, slots)
    square: Array  # sum of the innovations' squares over their variances (..., 2, axes, slots)
    count: Array  # of these innovations (..., 2, axes, slots)
    age: Array  # of onsets (..., effects, slots) [s]
    started: Array  # log of the prior of the faults that returns end (..., 2, axes, slots)
    since: Array  # since each ring took an onset (..., rings) [s]
    doubt: Array  # largest temper at the onset (..., 2, axes, slots)
    temper: Array  # of both channels (..., 2, axes, rings)
    learned: Array  # how long that was learned (..., 2, axes, rings) [s]


def start_bank(like: Vector) -> Bank:
    """Start without an onset; the first comes when noise has been learned."""
    xp, batch = namespace(like), like.shape[:-1]
    slots, temper = len(RING), xp.zeros((*batch, 2, 3, len(SLOTS)))
    U, age = xp.zeros((*batch, STATES, 3, len(COLUMN), slots)), xp.zeros((*batch, EFFECTS, slots)) + NEVER
    J, d = (xp.zeros((*batch, 2, 3, len(rows), slots)) for rows in (PRODUCT, COLUMN))
    none, since = xp.zeros((*batch, 2, 3, slots)), xp.zeros((*batch, len(SLOTS))) - LEARNING
    started = none + LOWEST
    doubt = none + DOUBT, temper + DOUBT
    return Bank(U, J, d, none, none, age, started, since, *doubt, temper)


def move(state: Bank, rate: Vector, repeats_gyro: bool, dt: Scalar) -> Bank:
    """Advance U by ``dt`` [s]; a rate [rad/s] turns the body axes in which angles are told."""
    step = column(column(column(dt)))
    rows = [state.U[..., k, :, :, :] for k in range(STATES)]
    by = -rows[BETA] if repeats_gyro else rows[OMEGA] + 0.5 * step * rows[D]
    rows[THETA] = rows[THETA] + step * (by - _cross(rate, rows[THETA]))
    rows[OMEGA] = rows[OMEGA] + step * rows[D]
    rows[D] = exp(-step / CORRELATED) * rows[D]
    rows[SWAY] = exp(-step / LONGER) * rows[SWAY]
    return state._replace(U=namespace(state.U).stack(rows, axis=-4))


def _cross(rate: Vector, theta: Array) -> Array:
    """Cross product of a rate (..., 3) and vectors (..., 3, columns, slots)."""
    p, q, r = (rate[..., k, None, None] for k in range(3))
    x, y, z = (theta[..., k, :, :] for k in range(3))
    return namespace(theta).stack([q * z - r * y, r * x - p * z, p * y - q * x], axis=-3)


def open_slots(state: Bank, worth: Array, failing: Flag, driven: Flag, dt: Scalar) -> Bank:
    """Begin onsets at this sample in rings that are due.

    ``worth`` (..., modes, slots) is the log weight of the hypotheses so far. ``failing`` and ``driven`` are
    those of `inference.believe`.
    """
    xp = namespace(state.age)
    since = state.since + column(dt)
    due = since >= np.array(SPACING) - 1e-6
    age = where(state.age >= 0.0, state.age + column(column(dt)), NEVER)
    oldest = age.max(axis=-2)
    by_chance = log(larger(oldest / np.array(SPACING)[RING], 1.0))
    shown = where(IS_FAULT[:, None], worth - USUAL, LOWEST).max(axis=-2) - by_chance
    likely = larger(worth.max(axis=-2), where(column(driven), shown, LOWEST))
    keep = where(oldest >= 0.0, larger(likely, 0.0) - 1e-6 * oldest, LOWEST)
    new: list[Array] = []
    for ring in range(len(SLOTS)):
        row = keep[..., FIRST[ring] : FIRST[ring + 1]]
        least = row == row.min(axis=-1, keepdims=True)
        new.append(least & (xp.cumsum(1.0 * least, axis=-1) <= 1.0) & due[..., ring : ring + 1])
    fresh = xp.concatenate(new, axis=-1)[..., None, :]
    jump = np.zeros((STATES, 3, len(COLUMN), 1))
    jump[D, :, :EFFECTS, 0] = pattern(PUSH)
    ended = [_likeliest(state, worth, channel, failing) for _, channel in RETURNS]
    best, started = [each for each, _ in ended], xp.stack([prior for _, prior in ended], axis=-3)
    temper = state.temper.max(axis=-1)[..., None]
    return state._replace(
        U=where(fresh[..., None, None, :, :], jump + _returning(state.U, best), state.U),
        J=where(fresh[..., None, None, :, :], _returning(state.J, best), state.J),
        d=where(fresh[..., None, None, :, :], _returning(state.d, best), state.d),
        started=where(fresh[..., None, :, :], started, state.started),
        doubt=where(fresh[..., None, :, :], temper, state.doubt),
        square=where(fresh[..., None, :, :], 0.0, state.square),
        count=where(fresh[..., None, :, :], 0.0, state.count),
        age=where(fresh, 0.0, age),
        since=where(due, 0.0, since),
    )


def _likeliest(state: Bank, worth: Array, channel: int, failing: Flag) -> tuple[Array, Array]:
    """Return the likeliest fault of a sensor on each axis, 1 in its slot, and the log of its prior."""
    ended = TESTS[channel]
    began = state.age[..., ended, :] >= 0.0
    likely = where(began, worth[..., ended, :], LOWEST)
    best, highest = at_largest(likely), likely.max(axis=-1, keepdims=True)
    prior = (USUAL[ended] * best).sum(axis=-1, keepdims=True)
    prior = prior + where(failing[..., channel], MORE, 0.0)[..., None, None]
    return best, where(highest > LOWEST, prior, LOWEST)


def _returning(part: Array, best: list[Array]) -> Array:
    """Return what is known of the ``best`` faults (..., 3, slots), in rows of returns; zeros in others."""
    xp, rows = namespace(part), list[Array]()
    ended = {kind: (TESTS[channel].start, best[k]) for k, (kind, channel) in enumerate(RETURNS)}
    for row in range(0, part.shape[-2], 3):
        kind = PRODUCT[row] // 3
        known = xp.zeros_like(part[..., :3, :1])
        if kind in ended:
            fault, likely = ended[kind]
            first = row - 3 * kind + fault
            chosen = part[..., first : first + 3, :] * likely[..., None, None, :, :]
            known = chosen.sum(axis=-1, keepdims=True)
        rows.append(known)
    return xp.concatenate(rows, axis=-2)


def disregard(state: Bank, attitude: Mask, gyro: Mask, untold: Mask, alone: Mask) -> Bank:
    """Drop faults of sensors that are stuck, or not believed (..., 3): what such a one reads says no size.

    Nor is there a scale of an attitude that is ``untold`` (..., 3): the gyro that tells what it should read
    is faulty, or was a second ago. An attitude that is ``alone`` (..., 3), as neither gyro nor torque tells
    the motion, has no fault at all: by coupling it would be blamed for what another axis shows.
    """
    none = namespace(gyro).zeros_like(gyro)
    attitude = attitude | alone
    as_kinds = [attitude, gyro, alone, none, none, none, attitude, gyro, attitude | untold]
    stuck = namespace(gyro).concatenate(as_kinds, axis=-1)
    return state._replace(age=where(stuck[..., None], NEVER, state.age))


def shape_of(state: Bank) -> Array:
    """What a size and a slope of 1 add by now (..., columns, slots)."""
    sizes, slopes = where(state.age >= 0.0, 1.0, 0.0), larger(state.age[..., :SLOPES, :], 0.0)
    return namespace(state.age).concatenate([sizes, slopes], axis=-2)


def of_attitude(state: Bank, rate: Vector, added: Array) -> Array:
    """S of the attitude (..., 3, columns, slots).

    ``added`` (..., 3, effects) is what a fault of 1 rad or 1 s adds to its rotation vector.
    """
    late = rate[..., None, None] * state.U[..., LAG, :, :, :]
    moved = state.U[..., THETA, :, :, :] + state.U[..., SWAY, :, :, :] - late
    return moved + added[..., COLUMN, None] * shape_of(state)[..., None, :, :]


def of_tilt(state: Bank, vertical: Vector, added: Array) -> Array:
    """S of the tilt by gravity (..., 3, columns, slots); ``added`` (..., 3, effects) is what 1 rad adds.

    What turns about the ``vertical`` (..., 3), a unit vector in body axes, is no tilt.
    """
    theta, v, z = state.U[..., THETA, :, :, :], vertical[..., None, None], vertical[..., 2:, None, None]
    by_motion = z * (z * theta - v * theta[..., 2:, :, :]) + state.U[..., LEAN, :, :, :]
    return by_motion + added[..., COLUMN, None] * shape_of(state)[..., None, :, :]


def of_gyro(state: Bank, rate: Vector, due: Vector) -> Array:
    """S of the gyro (..., 3, columns, slots), which should read ``due`` (..., 3) [rad/s]."""
    added = pattern(GYRO) + column(due) * pattern(SCALED)
    by_scale = sum(rate[..., k, None, None, None] * state.U[..., SCALE.start + k, :, :, :] for k in range(3))
    by_motion = state.U[..., OMEGA, :, :, :] + state.U[..., BETA, :, :, :] + by_scale
    return by_motion + added[..., COLUMN, None] * shape_of(state)[..., None, :, :]


def weigh(state: Bank, channel: int, seen: Gains, S: Array, vague: Vector | None = None) -> Bank:
    """Take a measurement of a channel: its innovations, and what the hypotheses expect of them.

    A wrong scale adds what is as vague as the rate: ``vague`` (..., 3) [rad²/s²], by `motion.rate_vagueness`.
    """
    xp = namespace(S)
    weight = column(where(seen.used, 1.0 / seen.variance, 0.0)) / state.doubt[..., channel, :, :]
    e = weight * column(seen.innovation)  # (..., 3, slots)
    square, e, w = e * column(seen.innovation), e[..., None, :], weight[..., None, :]
    if vague is not None:
        known = (seen.variance / (seen.variance + vague))[..., None, None]
        known = where((KIND[:EFFECTS] == SCALED)[:, None], known, 1.0)
        w, e = w * known, e * known
    sizes, slopes, sloped = S[..., :EFFECTS, :], S[..., EFFECTS:, :], w[..., :SLOPES, :]
    mixed = sloped * sizes[..., :SLOPES, :] * slopes
    J = xp.concatenate([w * sizes * sizes, mixed, sloped * slopes * slopes], axis=-2)
    d = xp.concatenate([e * sizes, e[..., :SLOPES, :] * slopes], axis=-2)
    gain = seen.gain.swapaxes(-1, -2)[..., None, None]  # (..., 10, 3, 1, 1)
    own = np.eye(2)[channel][:, None, None]
    return state._replace(
        U=state.U - gain * S[..., None, :, :, :],
        J=state.J + own[..., None] * J[..., None, :, :, :],
        d=state.d + own[..., None] * d[..., None, :, :, :],
        square=state.square + own * square[..., None, :, :],
        count=state.count + own * seen.used[..., None, :, None],
    )


def forget(state: Bank, axes: Mask, settled: Mask, alone: Mask) -> Bank:
    """Drop all hypotheses of some axes (..., 3): from now on the filter believes otherwise.

    Where it is not ``settled`` (..., 3) whether the gyro is faulty, its faults stay, and what it has shown.
    Hypotheses of other axes lose what these axes have shown: it was of the fault that is believed. A gyro
    that is ``alone``, as its attitude is not there, needs new evidence: by torque alone all axes look alike.
    """
    own = AXIS[:EFFECTS]
    xp, of_gyro = namespace(state.age), NAME[:EFFECTS] == GYRO
    gone = (axes[..., own] & (settled[..., own] | ~of_gyro))[..., None]
    again = (alone[..., own] & of_gyro)[..., None]
    shown = xp.stack([axes & settled, axes], axis=-2)  # by gyro and attitude (..., 2, axes)
    lost = shown[..., None, None] | again[..., None, None, :, :]  # by channel and axis, effects, slots
    J, d = where(lost[..., PRODUCT, :], 0.0, state.J), where(lost[..., COLUMN, :], 0.0, state.d)
    heard = (shown | alone[..., None, :])[..., None]
    square, count = (where(heard, 0.0, part) for part in (state.square, state.count))
    return state._replace(age=where(gone, NEVER, state.age), J=J, d=d, square=square, count=count)
