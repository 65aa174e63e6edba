r"""Is a rotor weak, or is it a disturbance? Residual accelerations over four times, rotor by rotor.

With angular acceleration a of the gyro, specific force f along z, thrust w_i of each rotor as it should be,
and the model (columns b_i), the residual

    r = (a, f) - sum_i b_i w_i = - sum_i b_i w_i s_i + d

has four channels. s_i is the share of thrust that rotor i has lost, d what the model does not know: wind, a
wrong centre of mass, and so on. r is averaged over the times `TIMES`. In healthy flight its mean d_0 and its
variance V about d_0 are learned for each. A share `UNSURE` of fast changes of the model counts as unknown.

For each rotor and time, with v = -b_i w_i and D = r - d_0, the generalised likelihood ratio

    l = N² / Q,   N = sum_c v_c D_c / V_c,   Q = sum_c v_c² / V_c,   s = N / Q

is that of a loss of any size s > 0 against no fault (Willsky and Jones 1976). A disturbance explains any D.
So a rotor is named only if D has its direction: what s v leaves of D is chi-squared with three degrees of
freedom. v is known to `BENT` of each channel, and to `LEAK` of its length across the angular ones. Nor is it
named for what a push along z explains: that shows in f alone, as does an accelerometer that is off.

Where the gyro is not believed, a is of another rate, of a variance P: its average over T errs by 2 P / T².
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_fdi.rotor_diagnosis.rotor_model import Effects
from quadftc_model.arrays import (
    Array,
    Flag,
    Scalar,
    any_of,
    branch,
    column,
    exp,
    larger,
    namespace,
    smaller,
    stacked,
    where,
)

TIMES = np.array([0.015, 0.06, 0.25, 1.0])  # s; over which residuals are averaged
EARLY = np.array([0.3, 0.3, 0.6, 2.0])  # s; what the prior of each variance is worth
SOON, LATE = 0.2, 20.0  # s; what the prior of the mean is worth; memory of what is learned
PRIOR, LEAST = 0.05, 0.008  # 1; loss of a rotor that residuals are like, 1 sigma: at first, at least
UNSURE = 0.15  # 1; share of fast changes of the model that may be otherwise
BENT, LEAK = 0.25, 0.05  # 1; error of the direction of a loss: of a channel, across the angular channels
KICK = 0.5  # 1; the same about yaw, by the inertia of a rotor that stops, where its speed is not measured
KNOWN = 0.15  # 1; share of a known loss that may be otherwise, for the other rotors
CLIP = 6.0  # 1; bound of squares that are learned from
FAR = 14.0  # 1; what a rotor may leave of a residual, in variances: chi-squared, three degrees of freedom
SUSPECT, ALARM = 16.0, 36.0  # 1; of l
SHY, SMALLEST, LARGEST = 0.02, 0.05, 1.6  # 1; losses that are suspect, that are named, that cannot be
LEAD = 2.0 * math.log(19.0)  # 1; by which one rotor explains a residual better than another: 95 %
NEVER = 1e9  # a rest, a variance that explains nothing


class Residuals(NamedTuple):
    """Averages over K `TIMES`, and what is learned of them in healthy flight."""

    mean: Array  # of r (4), w (n) and s w (n): (..., K, 4 + 2 n)
    vague: Array  # of the variance of a rate that is not the gyro's (..., K, 3) [rad²/s²]
    usual: Array  # d_0 (..., 4) [rad/s², m/s²]
    variance: Array  # of r about d_0 (..., K, 4)
    learned: Scalar  # for how long [s]


class Evidence(NamedTuple):
    """What the residuals say of each rotor (..., n), known losses taken out."""

    likely: Array  # l, the largest over all times at which the direction fits
    loss: Array  # s by the shortest average
    suspect: Array  # bool: l and direction make it suspect
    alarm: Array  # bool: they say that it is the rotor, or a rival
    alone: Array  # bool: no rival explains it nearly as well


class Judged(NamedTuple):
    """Evidence, and the numbers that it is made of."""

    evidence: Evidence
    deviation: Array  # D (..., K, 4)
    variance: Array  # of D without a fault (..., K, 4)


def start_residuals(effects: Effects, thrusts: Array) -> Residuals:
    """Start at thrusts (..., n)."""
    xp, ones = namespace(thrusts), np.ones((len(TIMES), 1))
    zeros = xp.zeros_like(thrusts)
    still = zeros[..., :1] + xp.zeros_like(effects.size)
    mean = xp.concatenate([still, thrusts, zeros], axis=-1)[..., None, :] * ones
    variance = (still + PRIOR * effects.size)[..., None, :] ** 2 * ones
    return Residuals(mean, 0.0 * variance[..., :3], still, variance, zeros[..., 0])


def average(
    state: Residuals, residual: Array, thrusts: Array, losses: Array, vague: Array, dt: Scalar
) -> Residuals:
    """Average a sample: residual (..., 4), thrusts and losses (..., n), variance of the rate (..., 3)."""
    news = namespace(residual).concatenate([residual, thrusts, thrusts * losses], axis=-1)
    gains = (1.0 - exp(-dt / TIMES))[:, None]
    return state._replace(
        mean=state.mean + gains * (news[..., None, :] - state.mean),
        vague=state.vague + gains * (vague[..., None, :] - state.vague),
    )


def unheard(state: Residuals, vague: Array, deaf: Flag) -> Array:
    """Return the variance of the mean residuals (..., K, 4) by what no gyro and no accelerometer tells.

    An acceleration averaged over T is a rate less its own average, over T. Each has an error of its own.
    """
    turned = (vague[..., None, :] + state.vague) / (TIMES * TIMES)[:, None]
    pushed = where(deaf, NEVER, 0.0)[..., None, None] * np.ones((len(TIMES), 1))
    return namespace(turned).concatenate([turned, pushed], axis=-1)


def judge(
    state: Residuals,
    effects: Effects,
    faulty: Array,
    doubtful: Array,
    std_dev: Array,
    unheard: Array,
    measured: Flag,
) -> Judged:
    """Judge the rotors that are not ``faulty``; ``std_dev`` is that of the losses of those (..., n).

    Losses of ``doubtful`` rotors are not taken out. ``unheard``: see there. ``measured``: thrusts are those
    of measured speeds.
    """
    n, mean = faulty.shape[-1], state.mean
    thrusts, lost = mean[..., 4 : 4 + n], mean[..., 4 + n :] * ~doubtful[..., None, :]  # (..., K, n)
    model = thrusts @ effects.columns
    deviation = mean[..., :4] - state.usual[..., None, :] + lost @ effects.columns
    fast = UNSURE * (model - model[..., -1:, :])
    variance = state.variance + fast * fast + unheard
    # known losses may be otherwise
    unsure = (KNOWN * lost) ** 2 + (thrusts * std_dev[..., None, :]) ** 2
    unsure = where(column(any_of(faulty)), unsure @ (effects.columns * effects.columns), 0.0)
    weight = 1.0 / (variance + unsure)
    n_over = -thrusts * ((deviation * weight) @ effects.rows)
    q_over = thrusts * thrusts * (weight @ effects.square) + 1e-30
    loss = n_over / q_over
    likely = n_over * loss * (n_over > 0.0)
    none, zeros = faulty & ~faulty, namespace(loss).zeros_like(std_dev)
    found = branch(
        (likely > SUSPECT).any(axis=(-2, -1)),
        lambda: _explain(effects, thrusts, deviation, weight, loss, likely, faulty, measured),
        lambda: Evidence(zeros, loss[..., 0, :], none, none, none),
    )
    return Judged(found, deviation, variance)


def change_of(state: Residuals, effects: Effects, judged: Judged) -> Array:
    """Return l of what known losses leave, whatever its sign and direction, by the two shortest averages."""
    weight = 1.0 / judged.variance[..., :2, :]
    n_over = (judged.deviation[..., :2, :] * weight) @ effects.rows
    return (n_over * n_over / (weight @ effects.square)).max(axis=-2)


def _explain(
    effects: Effects,
    thrusts: Array,
    deviation: Array,
    weight: Array,
    loss: Array,
    likely: Array,
    faulty: Array,
    measured: Flag,
) -> Evidence:
    """Judge by direction, too."""
    shape = (loss * thrusts)[..., None] * effects.columns  # (..., K, n, 4)
    square = shape * shape
    turning = square[..., :3].sum(axis=-1, keepdims=True)
    kick = where(measured, LEAK, KICK)
    leak = stacked([LEAK, LEAK, kick, 0.0])[..., None, None, :]
    unknown = BENT**2 * square + leak**2 * turning
    left = deviation[..., None, :] + shape
    rest = (left * left / (1.0 / weight[..., None, :] + unknown)).sum(axis=-1)  # (..., K, n)
    fits = (rest < FAR) & (loss > SHY) & (loss < LARGEST) & (likely > SUSPECT) & ~faulty[..., None, :]
    rest = where(fits, rest, NEVER)
    # smallest and second smallest
    least = rest.min(axis=-1, keepdims=True)
    best = rest == least
    others = where(best, np.inf, rest).min(axis=-1, keepdims=True)
    second = where(best.sum(axis=-1, keepdims=True) > 1, least, others)
    # a push along z, or an accelerometer that is off, shows in the force alone
    turned = (deviation * deviation * weight)[..., :3].sum(axis=-1, keepdims=True)
    loud = best & fits & (likely > ALARM) & (loss > SMALLEST) & (turned > least + LEAD)
    alone = loud & (second > least + LEAD)
    likely = (likely * fits).max(axis=-2)
    return Evidence(likely, loss[..., 0, :], fits.any(axis=-2), loud.any(axis=-2), alone.any(axis=-2))


def learn(state: Residuals, effects: Effects, deviation: Array, calm: Array, dt: Scalar) -> Residuals:
    """Learn d_0 and V where all is ``calm`` (...): 0 to 1."""
    time = calm * dt
    learned = smaller(state.learned + time, LATE)
    usual = state.usual + column(time / (SOON + learned)) * deviation[..., 1, :]
    square = smaller(deviation * deviation, CLIP * state.variance)
    share = time[..., None, None] / (EARLY[:, None] + learned[..., None, None])
    variance = state.variance + share * (square - state.variance)
    return state._replace(
        usual=usual, variance=larger(variance, (LEAST * effects.size) ** 2), learned=learned
    )
