r"""Which mode, since when, by how much: separate-bias filters behind one filter of the motion.

Let the truth differ from what the filter believes by U b, with b = (size, slope) of a mode that began at an
onset. The innovations e, of variance V, then have the mean S b. Friedland (1969), Willsky and Jones (1976):

    U <- F U + G,   S = H U + h,   U <- U - K S,   J += S' S / V,   d += S' e / V

With b ~ N(0, P0) the evidence for the mode, against none, is marginal in size and slope (Gustafsson 1996):

    l = d' (J + 1/P0)^-1 d / 2 - ln det(I + P0 J) / 2

Onsets have slots, in four rings. A ring takes an onset every `SPACING`; of its slots the least likely goes,
and the oldest where nothing is likely. So a hypothesis "since 40 ms" has never used the samples since.

A sensor that drifts may be right again before it is named: it jumps back to where the filter no longer is. A
return is the likeliest fault of attitude or gyro so far, with all that speaks for it. From its onset on that
fault adds nothing, but U moves on.

Models are wrong. How much noisier gyro and attitude are to these tests than the filter believes is learned,
by axis and ring, where they are believed: the `temper`. What is added to J and d is divided by the largest of
the rings, as it was at the onset: what a fault has taught since must not excuse it.

A wild gyro scatters, nobody knows by how much. Of its n innovations the likeliest variance is f V, with f V
the mean of (e - S b)², if f > 1. Against none, whose innovations have the variance V, that adds

    sum e²/V (1 - 1/f) / 2 - n ln f / 2

So does vibration, which is no fault: a gyro that scatters, and reads nothing else. It takes its share of what
speaks for a wild gyro.

What a named fault explains speaks for no other: hypotheses on other axes lose what its axis has shown. So J
and d are kept apart by the axis of the innovation.

Where no mode fits, the best proves little against the next. What an axis shows is divided by what its best
hypothesis leaves of the innovations' squares, over what noise would (Birge 1932), if that is more than 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.bank.modes import (
    AXIS,
    EFFECT,
    EFFECTS,
    GYRO,
    GYRO_RETURN,
    IS_FAULT,
    KIND,
    KINDS,
    LATE,
    MORE,
    NAME,
    PRIOR,
    PUSH,
    RATE,
    RETURN,
    SCALED,
    SENSOR,
    WILD,
    pattern,
)
from quadftc_fdi.bank.motion import BETA, CORRELATED, LAG, LEAN, OMEGA, SCALE, STATES, THETA, D, Gains
from quadftc_fdi.bank.noise import MEMORY, SMALL
from quadftc_fdi.bank.noise import PRIOR as LEARNING
from quadftc_model.arrays import (
    Array,
    Flag,
    Mask,
    Scalar,
    Vector,
    clip,
    column,
    exp,
    larger,
    log,
    namespace,
    smaller,
    where,
)

SPACING = (0.004, 0.04, 0.25, 1.5)  # s; chosen: how often each ring takes an onset
SLOTS = (9, 12, 11, 8)  # 1; chosen: how many onsets each ring has, 40 in all
RING = np.repeat(np.arange(len(SLOTS)), SLOTS)
FIRST = np.cumsum((0, *SLOTS))
OF_GYRO, OF_ATTITUDE = range(2)  # channels
TESTS = (slice(3, 6), slice(0, 3))  # modes that test a channel: of the gyro, of the attitude
DOUBT = 1.5  # 1; chosen: temper at the start
SETTLE = 1.0  # s; chosen: for how long learned tempers count less than that
CLIP = 3.0  # 1; chosen: most that a sample says, over what was learned
NEVER = -1.0  # s; mark: age of a slot without an onset
LOWEST = -1e9  # 1; mark: log weight of such a slot
CERTAIN = 50.0  # 1; rounding: log of odds
WILDS = slice(3 * WILD, None)  # modes
RETURNS = ((RETURN, OF_ATTITUDE), (GYRO_RETURN, OF_GYRO))  # and whose faults they end
# log of the prior: rate times what a slot covers
USUAL = np.log(RATE)[:, None] + np.log(np.array(SPACING))[RING]


class Bank(NamedTuple):
    """Hypotheses (..., modes, slots); U has states, axes and two columns, size and slope, before these."""

    U: Array  # (..., 9, 3, 2, modes, slots)
    J: Array  # size by size, size by slope, slope by slope, by channel and axis (..., 2, 3, 3, modes, slots)
    d: Array  # (..., 2, 2, 3, modes, slots)
    square: Array  # sum of the innovations' squares over their variances (..., 2, axes, slots)
    count: Array  # of these innovations (..., 2, axes, slots)
    age: Array  # of onsets (..., modes, slots) [s]
    started: Array  # log of the prior of the faults that returns end (..., 2, axes, slots)
    since: Array  # since each ring took an onset (..., rings) [s]
    doubt: Array  # largest temper at the onset (..., 2, axes, slots)
    temper: Array  # of both channels (..., 2, axes, rings)
    learned: Array  # how long that was learned (..., 2, axes, rings) [s]


class Posterior(NamedTuple):
    """What the bank believes of each hypothesis."""

    log_weight: Array  # against none (..., modes, slots)
    b: Array  # size and slope (..., 2, modes, slots)
    covariance: Array  # size by size, size by slope, slope by slope (..., 3, modes, slots)
    vibration: Array  # probability that a gyro which scatters vibrates, on each axis (..., 3)


def start_bank(like: Vector) -> Bank:
    """Start without an onset; the first comes when noise has been learned."""
    xp, batch = namespace(like), like.shape[:-1]
    modes = (EFFECTS, len(RING))
    J, temper = xp.zeros((*batch, 2, 3, 3, *modes)), xp.zeros((*batch, 2, 3, len(SLOTS)))
    U, age = xp.zeros((*batch, STATES, 3, 2, *modes)), xp.zeros((*batch, *modes)) + NEVER
    none, since = xp.zeros((*batch, 2, 3, len(RING))), xp.zeros((*batch, len(SLOTS))) - LEARNING
    started = none + LOWEST
    doubt = none + DOUBT, temper + DOUBT
    return Bank(U, J, J[..., :2, :, :, :], none, none, age, started, since, *doubt, temper)


def move(state: Bank, rate: Vector, repeats_gyro: bool, dt: Scalar) -> Bank:
    """Advance U by ``dt`` [s]; a rate [rad/s] turns the body axes in which angles are told."""
    step = column(column(column(column(dt))))
    rows = [state.U[..., k, :, :, :, :] for k in range(STATES)]
    by = -rows[BETA] if repeats_gyro else rows[OMEGA] + 0.5 * step * rows[D]
    rows[THETA] = rows[THETA] + step * (by - _cross(rate, rows[THETA]))
    rows[OMEGA] = rows[OMEGA] + step * rows[D]
    rows[D] = exp(-step / CORRELATED) * rows[D]
    return state._replace(U=namespace(state.U).stack(rows, axis=-5))


def _cross(rate: Vector, theta: Array) -> Array:
    """Cross product of a rate (..., 3) and vectors (..., 3, 2, modes, slots)."""
    p, q, r = (rate[..., k, None, None, None] for k in range(3))
    x, y, z = (theta[..., k, :, :, :] for k in range(3))
    return namespace(theta).stack([q * z - r * y, r * x - p * z, p * y - q * x], axis=-4)


def open_slots(state: Bank, worth: Array, failing: Flag, dt: Scalar) -> Bank:
    """Begin onsets at this sample in rings that are due.

    ``worth`` (..., modes, slots) is the log weight of the hypotheses so far; ``failing`` is as in `believe`.
    """
    xp = namespace(state.age)
    since = state.since + column(dt)
    due = since >= np.array(SPACING) - 1e-6
    age = where(state.age >= 0.0, state.age + column(column(dt)), NEVER)
    oldest = age.max(axis=-2)
    keep = where(oldest >= 0.0, larger(worth.max(axis=-2), 0.0) - 1e-6 * oldest, LOWEST)
    new: list[Array] = []
    for ring in range(len(SLOTS)):
        row = keep[..., FIRST[ring] : FIRST[ring + 1]]
        least = row == row.min(axis=-1, keepdims=True)
        new.append(least & (xp.cumsum(1.0 * least, axis=-1) <= 1.0) & due[..., ring : ring + 1])
    fresh = xp.concatenate(new, axis=-1)[..., None, :]
    jump = np.zeros((STATES, 3, 2, EFFECTS, 1))
    jump[D, :, 0, :, 0] = pattern(PUSH)
    ended = [_likeliest(state, worth, channel, failing) for _, channel in RETURNS]
    best, started = [each for each, _ in ended], xp.stack([prior for _, prior in ended], axis=-3)
    temper = state.temper.max(axis=-1)[..., None]
    return state._replace(
        U=where(fresh[..., None, None, None, :, :], jump + _returning(state.U, best), state.U),
        J=where(fresh[..., None, None, None, :, :], _returning(state.J, best), state.J),
        d=where(fresh[..., None, None, None, :, :], _returning(state.d, best), state.d),
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
    highest = likely.max(axis=-1, keepdims=True)
    best = 1.0 * (likely == highest)
    best = best / best.sum(axis=-1, keepdims=True)
    prior = (USUAL[ended] * best).sum(axis=-1, keepdims=True)
    prior = prior + where(failing[..., channel], MORE, 0.0)[..., None, None]
    return best, where(highest > LOWEST, prior, LOWEST)


def _returning(part: Array, best: list[Array]) -> Array:
    """Return what is known of the ``best`` faults (..., 3, slots), in rows of returns; zeros in others."""
    xp, rows = namespace(part), [namespace(part).zeros_like(part[..., :3, :1])] * (EFFECTS // 3)
    for (kind, channel), chosen in zip(RETURNS, best, strict=True):
        between = (None,) * (part.ndim - chosen.ndim)
        known = part[..., TESTS[channel], :] * chosen[(..., *between, slice(None), slice(None))]
        rows[kind] = known.sum(axis=-1, keepdims=True)
    return xp.concatenate(rows, axis=-2)


def disregard(state: Bank, attitude: Mask, gyro: Mask) -> Bank:
    """Drop faults of sensors whose readings are stuck (..., 3): what such a reading says is no size."""
    none = namespace(gyro).zeros_like(gyro)
    as_kinds = [attitude, gyro, none, none, attitude, none, none, gyro]
    stuck = namespace(gyro).concatenate(as_kinds, axis=-1)
    return state._replace(age=where(stuck[..., None], NEVER, state.age))


def shape_of(state: Bank) -> Array:
    """What a size and a slope of 1 add by now (..., 2, modes, slots)."""
    began = state.age >= 0.0
    return namespace(state.age).stack([where(began, 1.0, 0.0), where(began, state.age, 0.0)], axis=-3)


def of_attitude(state: Bank, rate: Vector, added: Array) -> Array:
    """S of the attitude (..., 3, 2, modes, slots).

    ``added`` (..., 3, modes) is what a fault of 1 rad or 1 s adds to its rotation vector.
    """
    late = rate[..., :, None, None, None] * state.U[..., LAG, :, :, :, :]
    by_fault = added[..., :, None, :, None] * shape_of(state)[..., None, :, :, :]
    return state.U[..., THETA, :, :, :, :] - late + by_fault


def of_tilt(state: Bank, vertical: Vector, added: Array) -> Array:
    """S of the tilt by gravity (..., 3, 2, modes, slots); ``added`` (..., 3, modes) is what 1 rad adds.

    What turns about the ``vertical`` (..., 3), a unit vector in body axes, is no tilt.
    """
    theta = state.U[..., THETA, :, :, :, :]
    v, z = vertical[..., :, None, None, None], vertical[..., 2:, None, None, None]
    by_motion = z * (z * theta - v * theta[..., 2:, :, :, :]) + state.U[..., LEAN, :, :, :, :]
    return by_motion + added[..., :, None, :, None] * shape_of(state)[..., None, :, :, :]


def of_gyro(state: Bank, rate: Vector, due: Vector) -> Array:
    """S of the gyro (..., 3, 2, modes, slots), which should read ``due`` (..., 3) [rad/s]."""
    added = pattern(GYRO) + column(due) * pattern(SCALED)
    by_scale = sum(
        rate[..., k, None, None, None, None] * state.U[..., SCALE.start + k, :, :, :, :] for k in range(3)
    )
    by_motion = state.U[..., OMEGA, :, :, :, :] + state.U[..., BETA, :, :, :, :] + by_scale
    return by_motion + added[..., :, None, :, None] * shape_of(state)[..., None, :, :, :]


def weigh(state: Bank, channel: int, seen: Gains, S: Array, vague: Vector | None = None) -> Bank:
    """Take a measurement of a channel: its innovations, and what the hypotheses expect of them.

    A wrong scale adds what is as vague as the rate: ``vague`` (..., 3) [rad²/s²], by `motion.rate_known`.
    """
    xp = namespace(S)
    weight = column(where(seen.used, 1.0 / seen.variance, 0.0)) / state.doubt[..., channel, :, :]
    e = weight * column(seen.innovation)  # (..., 3, slots)
    square, e, w = e * column(seen.innovation), e[..., None, None, :], weight[..., None, :]
    if vague is not None:
        known = (seen.variance / (seen.variance + vague))[..., None, None]
        known = where((KIND[:EFFECTS] == SCALED)[:, None], known, 1.0)
        w, e = w * known, e * known[..., None, :, :]
    one, two = S[..., 0, :, :], S[..., 1, :, :]  # (..., 3, modes, slots)
    J = xp.stack([w * one * one, w * one * two, w * two * two], axis=-4)
    gain = seen.gain.swapaxes(-1, -2)[..., None, None, None]  # (..., 9, 3, 1, 1, 1)
    own = np.eye(2)[channel][:, None, None, None]
    return state._replace(
        U=state.U - gain * S[..., None, :, :, :, :],
        J=state.J + own[..., None] * J[..., None, :, :, :, :],
        d=state.d + own[..., None] * (e * S).swapaxes(-3, -4)[..., None, :, :, :, :],
        square=state.square + own[..., 0] * square[..., None, :, :],
        count=state.count + own[..., 0] * seen.used[..., None, :, None],
    )


def believe(
    state: Bank, good_attitude: Mask, held: Mask, driven: Flag, failing: Flag, rarer: float
) -> Posterior:
    """Return the posterior of size and slope, and the weight of mode and onset.

    A wild gyro, or one of a wrong scale, is a hypothesis where the attitude is good (..., 3) and the torque
    known: by one of them alone it cannot be told from motion, or from an attitude that jumps. Where neither a
    good attitude nor gravity has ``held`` the angle (..., 3), a fault of the gyro is ``rarer``, by a log of
    odds. Where a sensor is ``failing`` (..., 3), as `modes.SENSOR` counts them, or was a moment ago, its next
    fault is no rarer than what is none.
    """
    xp, square, count = namespace(state.age), state.square, state.count  # (..., 2, axes, slots)
    J, d = (part.sum(axis=-3)[..., EFFECT, :] for part in (state.J, state.d))
    heard, number = square[..., OF_GYRO, :, :], count[..., OF_GYRO, :, :]
    # gyros that scatter: those of vibration, and wild ones less their line
    _, b, _ = _solved(J[..., WILDS, :].sum(axis=-4), d[..., WILDS, :].sum(axis=-4), PRIOR[WILDS])
    left = heard - _explained(J[..., OF_GYRO, :, WILDS, :], d[..., OF_GYRO, :, WILDS, :], b)
    louder, scatter = (larger(part / larger(number, 1.0), 1.0) for part in (heard, left))
    others = xp.zeros_like(J[..., 0, 0, : WILDS.start, :])
    by_scatter = xp.concatenate([others, _scattering(heard, number, scatter)], axis=-2)
    scatter = xp.concatenate([others + 1.0, scatter], axis=-2)
    shares = xp.stack([1.0 / scatter, xp.ones_like(scatter)], axis=-3)  # of gyro and attitude
    square, count = (square[..., AXIS, :] * shares).sum(axis=-3), count.sum(axis=-3)[..., AXIS, :]
    joint_J, joint_d = ((part * shares[..., None, :, :]).sum(axis=-4) for part in (J, d))
    both = (good_attitude & column(driven))[..., AXIS]
    told, age = both | ((KIND != WILD) & (KIND != SCALED)), state.age[..., EFFECT, :]
    began = (age >= 0.0) & told[..., None]
    prior = USUAL + where(failing[..., SENSOR] & IS_FAULT, MORE, 0.0)[..., None]
    prior = prior + where((NAME == GYRO) & ~held[..., AXIS], rarer, 0.0)[..., None]
    for k, (kind, _) in enumerate(RETURNS):
        prior = prior + where(np.equal(KIND, kind)[:, None], state.started[..., k, AXIS, :], 0.0)
    evidence, b, _ = _solved(joint_J, joint_d, PRIOR)
    misfit = (square - (joint_d * b).sum(axis=-3)) / larger(count, 1.0)
    for kind, channel in RETURNS:  # no better than a new fault
        misfit = where(np.equal(KIND, kind)[:, None], misfit[..., TESTS[channel], :][..., AXIS, :], misfit)
    doubt = _of_the_best(misfit, where(began, evidence + by_scatter + prior, LOWEST))  # (..., axes)
    of_modes = doubt[..., None, AXIS, None]
    evidence, b, covariance = _solved(joint_J / of_modes, joint_d / of_modes, PRIOR)
    early = smaller(b[..., 0, :, :], 0.0) * (EFFECT // 3 == LATE)[:, None]  # no attitude leads
    evidence = evidence - 0.5 * early**2 / covariance[..., 0, :, :]
    weight = where(began, evidence + by_scatter / of_modes[..., 0, :, :] + prior, LOWEST)
    innocent = _scattering(heard, number, louder) / doubt[..., None] + USUAL[3 * PUSH : 3 * PUSH + 3]
    more = weight[..., WILDS, :].max(axis=-1) - innocent.max(axis=-1)
    return Posterior(weight, b, covariance, 1.0 / (1.0 + exp(clip(more, -CERTAIN, CERTAIN))))


def _scattering(square: Array, count: Array, scatter: Array) -> Array:
    """Return the log-likelihood that a scatter adds, by the sum of the squares of so many innovations."""
    return 0.5 * (square * (1.0 - 1.0 / scatter) - count * log(scatter))


def _explained(J: Array, d: Array, b: Array) -> Array:
    """Return what size and slope explain of the innovations' squares, in a channel (..., modes, slots)."""
    size, slope = b[..., 0, :, :], b[..., 1, :, :]
    by_line = J[..., 0, :, :] * size**2 + 2.0 * J[..., 1, :, :] * size * slope + J[..., 2, :, :] * slope**2
    return 2.0 * (d * b).sum(axis=-3) - by_line


def _of_the_best(misfit: Array, worth: Array) -> Array:
    """Return the misfit of the likeliest hypothesis of each axis (..., 3), at least 1."""
    rows = (*worth.shape[:-2], len(KINDS), 3, len(RING))
    misfit, worth = misfit.reshape(rows), worth.reshape(rows)
    best = worth == worth.max(axis=(-1, -3), keepdims=True)
    return larger(where(best, misfit, -LOWEST).min(axis=(-1, -3)), 1.0)


def by_effect(of_modes: Array) -> Array:
    """Add up (..., modes, slots) of modes whose effects are alike: (..., effects, slots)."""
    kinds = [of_modes[..., 3 * kind : 3 * kind + 3, :] for kind in range(len(KINDS))]
    for kind in range(EFFECTS // 3, len(KINDS)):
        effect = KINDS[kind].effect
        kinds[effect] = kinds[effect] + kinds[kind]
    return namespace(of_modes).concatenate(kinds[: EFFECTS // 3], axis=-2)


def expected_change(state: Bank, posterior: Posterior, shares: Array) -> Array:
    """Return the mean change of the motion's states (..., 3, 9) over hypotheses of some probabilities."""
    b = by_effect(posterior.b * shares[..., None, :, :])
    return (state.U * b[..., None, None, :, :, :]).sum(axis=(-3, -2)).sum(axis=-1).swapaxes(-1, -2)


def _solved(J: Array, d: Array, prior: Array) -> tuple[Array, Array, Array]:
    """Return l, the mean of b (..., 2, modes, slots) and its covariance (..., 3, modes, slots)."""
    xp = namespace(J)
    size, slope = prior[:, 0, None], prior[:, 1, None]
    A, c, F = J[..., 0, :, :] + 1.0 / size, J[..., 1, :, :], J[..., 2, :, :] + 1.0 / slope
    det = larger(A * F - c * c, SMALL * A * F)
    d0, d1 = d[..., 0, :, :], d[..., 1, :, :]
    b0, b1 = (F * d0 - c * d1) / det, (A * d1 - c * d0) / det
    evidence = 0.5 * (d0 * b0 + d1 * b1) - 0.5 * log(det * size * slope)
    return evidence, xp.stack([b0, b1], axis=-3), xp.stack([F / det, -c / det, A / det], axis=-3)


def learn_temper(state: Bank, believed: Mask, dt: Scalar) -> Bank:
    """Learn how noisy the channels are to the tests, where they are ``believed`` (..., 2, axes)."""
    xp = namespace(state.age)
    rings = 1.0 * np.equal(RING[:, None], np.arange(len(SLOTS)))  # (slots, rings)
    found: list[Array] = []
    expected: list[Array] = []
    for channel, modes in enumerate(TESTS):
        raw = state.doubt[..., channel, None, :, :]
        J, d = (part[..., channel, :, :, modes, :].sum(axis=-3) * raw for part in (state.J, state.d))
        _, b, covariance = _solved(J, d, PRIOR[modes])
        began = 1.0 * (state.age[..., modes, :] >= 0.0)
        found.append((began * (d * b).sum(axis=-3)) @ rings)
        usual = (covariance * J * np.array([1.0, 2.0, 1.0])[:, None, None]).sum(axis=-3)
        expected.append((began * usual) @ rings)
    square, usual = xp.stack(found, axis=-3), xp.stack(expected, axis=-3)  # (..., 2, axes, rings)
    step = column(column(column(dt)))
    enough = believed[..., None] & (usual > 0.5)
    time = smaller(state.learned + step * enough, MEMORY)
    ratio = smaller(square / larger(usual, 0.5), CLIP * state.temper)
    news = step * enough / (SETTLE + time) * (ratio - state.temper)
    return state._replace(temper=larger(state.temper + news, 1.0), learned=time)


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
    lost = shown[..., None, :, None, None] | again[..., None, None, None, :, :]  # with axes, effects, slots
    J, d = (where(lost, 0.0, part) for part in (state.J, state.d))
    heard = (shown | alone[..., None, :])[..., None]
    square, count = (where(heard, 0.0, part) for part in (state.square, state.count))
    return state._replace(age=where(gone, NEVER, state.age), J=J, d=d, square=square, count=count)
