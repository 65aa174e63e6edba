"""What the hypotheses are worth, and by how much each mode is off.

With b ~ N(0, P0) the evidence for a mode, against none, is marginal in size and slope (Gustafsson 1996):

    l = d' (J + 1/P0)^-1 d / 2 - ln det(I + P0 J) / 2

Models are wrong. How much noisier gyro and attitude are to these tests than the filter believes is learned,
by axis and ring, where they are believed: the `temper`. What is added to J and d is divided by the largest of
the rings, as it was at the onset: what a fault has taught since must not excuse it.

A wild gyro scatters, nobody knows by how much. Of its n innovations the likeliest variance is f V, with f V
the mean of (e - S b)², if f > 1. Against none, whose innovations have the variance V, that adds

    sum e²/V (1 - 1/f) / 2 - n ln f / 2

So does vibration, which is no fault: a gyro that scatters, and reads nothing else. It takes its share of what
speaks for a wild gyro.

Where no mode fits, the best proves little against the next. What an axis shows is divided by what its best
hypothesis leaves of the innovations' squares, over what noise would (Birge 1932), if that is more than 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.bank.hypotheses import LOWEST, OF_GYRO, RETURNS, RING, SLOTS, SPACING, TESTS, USUAL, Bank
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
    SCALED,
    SENSOR,
    SLOPES,
    STRETCHED,
    WILD,
)
from quadftc_fdi.bank.motion import CORRELATED, OMEGA, THETA
from quadftc_fdi.bank.noise import MEMORY, SMALL
from quadftc_model.arrays import (
    Array,
    Flag,
    Mask,
    Scalar,
    Vector,
    at_largest,
    clip,
    column,
    exp,
    larger,
    log,
    namespace,
    smaller,
    where,
)

SETTLE = CORRELATED  # s; for how long learned tempers count less than that
CLIP = 3.0  # 1; chosen: most that a sample says, over what was learned
CERTAIN = 50.0  # 1; rounding: log of odds
WILDS = slice(3 * WILD, None)  # modes
OF_GYROS = (NAME == GYRO) | (NAME == GYRO_RETURN)


class Posterior(NamedTuple):
    """What the bank believes of each hypothesis."""

    log_weight: Array  # against none (..., modes, slots)
    b: Array  # size and slope (..., 2, modes, slots)
    covariance: Array  # size by size, size by slope, slope by slope (..., 3, modes, slots)
    vibration: Array  # probability that a gyro which scatters vibrates, on each axis (..., 3)
    misfit: Array  # of the likeliest hypothesis of each axis (..., 3)


def believe(
    state: Bank,
    good_attitude: Mask,
    held: Mask,
    driven: Flag,
    failing: Flag,
    rarer: float,
    gyro_fails: bool = True,
) -> Posterior:
    """Return the posterior of size and slope, and the weight of mode and onset.

    A wild gyro, or a wrong scale, is a hypothesis where the attitude is good (..., 3) and the torque is
    known: either alone does not tell them from motion or from a jump. Without a torque there is no push: any
    acceleration is usual. Where neither a good attitude nor gravity has ``held`` the angle (..., 3), a fault
    of the gyro is ``rarer``, by a log of odds; without a torque nothing tells it. Where a sensor is
    ``failing`` (..., 3), as `modes.SENSOR` counts them, or was a moment ago, its next fault is no rarer than
    what is none. Gyros have no faults unless ``gyro_fails``.
    """
    xp, square, count = namespace(state.age), state.square, state.count  # (..., 2, axes, slots)
    J, d = (_lines(part, EFFECT) for part in (state.J, state.d))
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
    told = (both | ~np.isin(KIND, (WILD, SCALED, STRETCHED))) & (column(driven) | (KIND != PUSH))
    told = told & ((gyro_fails & (held[..., AXIS] | column(driven))) | ~OF_GYROS)
    age = state.age[..., EFFECT, :]
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
    return Posterior(weight, b, covariance, 1.0 / (1.0 + exp(clip(more, -CERTAIN, CERTAIN))), doubt)


def explained_by_axis(state: Bank, posterior: Posterior) -> Array:
    """Return the log-likelihood that the likeliest onset of each mode adds to each axis (..., 3, modes)."""
    xp, best = namespace(state.age), at_largest(posterior.log_weight)
    J, d = (part.sum(axis=-4) for part in (state.J, state.d))  # (..., axes, products or columns, slots)
    by_axis = [
        _explained(_rows(J[..., k, :, :], EFFECT), _rows(d[..., k, :, :], EFFECT), posterior.b)
        for k in range(3)
    ]
    explained = (xp.stack(by_axis, axis=-3) * best[..., None, :, :]).sum(axis=-1)
    return 0.5 * explained / posterior.misfit[..., None, AXIS]


def _lines(part: Array, effects: NDArray[np.intp]) -> Array:
    """Return J or d of some effects, summed over axes: sizes, then slopes (..., 3 or 2, effects, slots)."""
    return _rows(part.sum(axis=-3), effects)


def _rows(part: Array, effects: NDArray[np.intp]) -> Array:
    """Return sizes, then slopes, of some effects; zeros for what has none (..., 3 or 2, effects, slots)."""
    rows = part.shape[-2]
    slopes = [np.where(effects < SLOPES, effects + k, rows) for k in range(EFFECTS, rows, SLOPES)]
    padded = namespace(part).concatenate([part, 0.0 * part[..., :1, :]], axis=-2)
    return padded[..., np.stack([effects, *slopes]), :]


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
    best = worth == worth.max(axis=-3, keepdims=True).max(axis=-1, keepdims=True)
    return larger(where(best, misfit, -LOWEST).min(axis=-3).min(axis=-1), 1.0)


def by_effect(of_modes: Array) -> Array:
    """Add up (..., modes, slots) of modes whose effects are alike: (..., effects, slots)."""
    kinds = [of_modes[..., 3 * kind : 3 * kind + 3, :] for kind in range(len(KINDS))]
    for kind in range(EFFECTS // 3, len(KINDS)):
        effect = KINDS[kind].effect
        kinds[effect] = kinds[effect] + kinds[kind]
    return namespace(of_modes).concatenate(kinds[: EFFECTS // 3], axis=-2)


def expected_change(state: Bank, posterior: Posterior, shares: Array) -> tuple[Vector, Vector]:
    """Return the mean change of angle [rad] and rate [rad/s] over hypotheses of some probabilities."""
    b = by_effect(posterior.b * shares[..., None, :, :])
    b = namespace(b).concatenate([b[..., 0, :, :], b[..., 1, :SLOPES, :]], axis=-2)[..., None, :, :]
    changes = (state.U[..., part, :, :, :] * b for part in (THETA, OMEGA))
    angle, rate = (
        change.sum(axis=-2).sum(axis=-1) for change in changes
    )  # slots last: loops over them are fast
    return angle, rate


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


def learn_temper(state: Bank, believed: Array, dt: Scalar) -> Bank:
    """Learn how noisy the channels are to the tests, as far as these are ``believed`` (..., 2, axes)."""
    xp = namespace(state.age)
    rings = 1.0 * np.equal(RING[:, None], np.arange(len(SLOTS)))  # (slots, rings)
    found: list[Array] = []
    expected: list[Array] = []
    for channel, modes in enumerate(TESTS):
        raw = state.doubt[..., channel, None, :, :]
        J, d = (
            _lines(part[..., channel, :, :, :], np.arange(EFFECTS)[modes]) * raw
            for part in (state.J, state.d)
        )
        _, b, covariance = _solved(J, d, PRIOR[modes])
        began = 1.0 * (state.age[..., modes, :] >= 0.0)
        found.append((began * (d * b).sum(axis=-3)) @ rings)
        usual = (covariance * J * np.array([1.0, 2.0, 1.0])[:, None, None]).sum(axis=-3)
        expected.append((began * usual) @ rings)
    square, usual = xp.stack(found, axis=-3), xp.stack(expected, axis=-3)  # (..., 2, axes, rings)
    step = column(column(column(dt)))
    enough = believed[..., None] * (usual > 0.5)
    time = smaller(state.learned + step * enough, MEMORY)
    ratio = smaller(square / larger(usual, 0.5), CLIP * state.temper)
    news = step * enough / (SETTLE + time) * (ratio - state.temper)
    temper = larger(state.temper + news, 1.0)
    # one that began before much was learned follows what is learned, until the rings are full
    unknown = smaller(2.0 * state.age.max(axis=-2), SPACING[-1] * SLOTS[-1])[..., None, None, :]
    doubt = larger(state.doubt, temper.max(axis=-1)[..., None])
    doubt = where(time.max(axis=-1)[..., None] < unknown, doubt, state.doubt)
    return state._replace(temper=temper, learned=time, doubt=doubt)
