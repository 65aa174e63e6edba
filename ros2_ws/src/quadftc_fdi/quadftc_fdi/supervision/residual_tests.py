"""Residual tests of an attitude sensor, axis by axis: three kinds of evidence, and when they declare a fault.

Residuals r are measured minus predicted Euler angles. Healthy ones are the sensor's white noise, a slow
error (attitude filters and markers wander, more so in motion) and the error of the prediction. The model
says how large these are; the tests learn what is larger than the model says. On each axis:

    m <- m + w (r - m),   m² / var(m)        averages over 0.05, 0.15 and 0.5 s: incipient faults
                                             averages over 0.25 s of the residuals of the two anchors
                                             (`anchors`): faults so slow that the filter follows them
    s <- s + min(r / sigma, 8) - 3           cumulative sum (Page 1954), both ways: abrupt faults

When one axis is declared faulty, a lower level is enough on the others. What disturbs one axis often
disturbs them all, and going back to an anchor loses the evidence against them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.supervision.anchors import OLD, PROMOTION, YOUNG, One, Predicted, Residuals
from quadftc_model import arrays
from quadftc_model.arrays import Float, Mask, Vector, any_of, cache_numbers, changed_where, namespace

MEANS = np.array([0.05, 0.15, 0.5, 0.25, 0.25])  # s; averaging times, the last two of the anchors
LEVELS = np.array([1.08, 1.0, 1.0, 0.95, 0.95])  # 1; of the threshold, as short averages have more chances
OF_FILTER, IS_OLD, IS_YOUNG = (np.isin(np.arange(5), each) * 1.0 for each in ((0, 1, 2), OLD, YOUNG))
SHARE = 0.1  # 1; of the filter's own variance in an average, as its residuals are not perfectly white
ALLOWANCE, LIMIT, LARGEST = 3.0, 4.5, 8.0  # 1; of the cumulative sum, and the largest step it takes
SUSPICION = 0.75  # 1; share of the threshold at which an axis is suspect
TOGETHER = 0.6  # 1; share that is enough when another axis is declared faulty
RATIOS = LEVELS**2  # 1; the same of squares
SUDDEN = 0.06  # s; so soon after the first suspicion the filter has learned nothing from the fault
OUTLIER = 4.0  # 1; how far beyond what is known a residual may move what is learned
BOTH_WAYS = np.array([1.0, -1.0])


class ResidualVariances(NamedTuple):
    """Variances of a healthy residual [rad²]."""

    noise: Vector  # white noise of one sample
    slow: Vector  # the slow error
    predicted: Predicted  # angle predicted by filter, old and young anchor


class Evidence(NamedTuple):
    """What the tests remember."""

    means: Residuals  # averages of the residuals [rad]
    learned: Residuals  # squares of the averages over what the model says [1]
    sums: Float[arrays.AnyArray, "*batch 3 2"]  # cumulative sums, upwards and downwards [1]
    suspicion: Vector  # how long an axis has been suspect [s]


class Scores(NamedTuple):
    """How far each axis is from healthy (..., 3)."""

    mean: Vector  # largest squared average, in variances
    sum: Vector  # larger cumulative sum
    suspect: Mask  # the axis may become faulty: its measurement is not used


class Findings(NamedTuple):
    """Faults declared at this sample (..., 3) bool."""

    alarm: Mask  # an axis trusted so far is faulty
    sudden: Mask  # by the cumulative sum alone, and within SUDDEN of the first suspicion
    creeping: Mask  # by an average, so the fault has been there for some time


class AveragingWeights(NamedTuple):
    """Weights of one step."""

    mean: NDArray[np.float64]  # (5,) of a sample in the averages
    variance: NDArray[np.float64]  # (5, 5) of noise, slow error and three predictions in their variances
    white_equivalent: float  # of the slow error, as white noise of a sample


@cache_numbers
def averaging_weights(dt: float, memory: float) -> AveragingWeights:
    """Weights for a step ``dt`` and the correlation time of the slow error [s]."""
    starts = isinstance(dt, float) and dt == 0.0
    white = dt / (2.0 * MEANS + dt)
    rows = [white, memory / (memory + MEANS), (white + SHARE) * OF_FILTER, IS_OLD, IS_YOUNG]
    xp = namespace(white)
    return AveragingWeights(
        mean=dt / (MEANS + dt),
        variance=xp.stack([xp.asarray(row) for row in rows]),
        white_equivalent=0.0 if starts else 2.0 * memory / dt,
    )


def start_evidence(like: Vector) -> Evidence:
    """Return evidence of nothing."""
    xp, shape = namespace(like), like.shape
    return Evidence(xp.zeros((*shape, 5)), xp.ones((*shape, 5)), xp.zeros((*shape, 2)), xp.zeros_like(like))


def collect_evidence(
    evidence: Evidence,
    residuals: Residuals,
    variances: ResidualVariances,
    trusted: Mask,
    weights: AveragingWeights,
    dt: float,
    threshold: float,
    learning: float,
) -> tuple[Evidence, Scores]:
    """Test the residuals [rad] of one sample on the axes trusted so far and measured in it.

    An axis is faulty at ``threshold`` standard deviations; what is healthy is learned over ``learning`` [s].
    """
    xp = namespace(residuals)
    taken = trusted[..., None]
    noise, slow, predicted = variances
    # Averages, against their variances by the model; what is larger is learned, but for outliers.
    parts = xp.concatenate([noise[..., None], slow[..., None], predicted], axis=-1)
    means = evidence.means + taken * weights.mean * (residuals - evidence.means)
    ratio = means**2 / (parts @ weights.variance)
    excess = xp.maximum(evidence.learned, 1.0)
    news = xp.minimum(ratio, OUTLIER * excess) - evidence.learned
    learned = evidence.learned + taken * (dt / learning) * news
    mean_score = (ratio / (excess * RATIOS)).max(axis=-1)
    # Cumulative sums of the residual beyond the allowance, in its standard deviations.
    sigma = xp.sqrt((noise + slow + predicted[..., 0]) * excess[..., 0])
    step = xp.minimum((residuals[..., 0] / sigma)[..., None] * BOTH_WAYS, LARGEST) - ALLOWANCE
    sums = (evidence.sums + taken * step).clip(0.0, 2.0 * LIMIT)
    sum_score = sums.max(axis=-1)
    suspect = trusted & ((sum_score > 0.5 * LIMIT) | (mean_score > (SUSPICION * threshold) ** 2))
    suspicion = (evidence.suspicion + dt) * suspect
    return Evidence(means, learned, sums, suspicion), Scores(mean_score, sum_score, suspect)


def declare_faults(scores: Scores, suspicion: Vector, trusted: Mask, threshold: float) -> Findings:
    """Declare the axes faulty whose score is above the threshold, given how long [s] they were suspect."""

    def declare() -> Findings:
        abrupt = trusted & (scores.sum > LIMIT)
        creeping = trusted & (scores.mean > threshold**2) & ~abrupt
        alarm = abrupt | creeping
        # with one axis found, less is enough on the others
        close = scores.suspect | (trusted & (scores.mean > (TOGETHER * threshold) ** 2))
        alarm = alarm | (any_of(alarm) & close)
        return Findings(alarm, alarm & ~creeping & (suspicion < SUDDEN), creeping)

    none = scores.suspect  # where no axis is suspect, there is no alarm either
    return changed_where(scores.suspect, declare, Findings(none, none, none))


def update_evidence(evidence: Evidence, promoted: One, restart: Mask) -> Evidence:
    """Forget the evidence on axes that restart; follow the anchors where the young one became the old one."""
    xp = namespace(restart)

    def update() -> Evidence:
        means = xp.where(promoted[..., None], evidence.means @ PROMOTION, evidence.means)
        kept = ~restart[..., None]
        return evidence._replace(means=means * kept, sums=evidence.sums * kept)

    return changed_where(restart | promoted, update, evidence)


def healthy_spread(variances: ResidualVariances, learned: Residuals, weights: AveragingWeights) -> Vector:
    """Variance [rad²] of a healthy average over 0.15 s, the error of the prediction left out."""
    xp = namespace(learned)
    noise, slow = weights.variance[0, 1], weights.variance[1, 1]
    return (variances.noise * noise + variances.slow * slow) * xp.maximum(learned[..., 1], 1.0)
