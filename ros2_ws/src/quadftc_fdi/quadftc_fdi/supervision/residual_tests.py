"""Residual tests of an attitude sensor, axis by axis: three kinds of evidence, and when they declare a fault.

Residuals r are measured minus predicted Euler angles. Healthy ones are the sensor's white noise, a slow
error (attitude filters and markers wander, more so in motion) and the error of the prediction. How large the
first two are is learned (`sensor_noise`); the filter knows the third. On each axis:

    m <- m + w (r - m),   m² / var(m)        averages over 0.05, 0.15 and 0.5 s: incipient faults
                                             averages over 0.25 s of the residuals of the two anchors
                                             (`anchors`): faults so slow that the filter follows them
    s <- s + min(e / sigma, 4.4) - 2.5       cumulative sum (Page 1954), both ways: abrupt faults
    e = r - c m                              m: average over 0.05 s, c: share of slow errors in its variance

So an excursion of a sensor that errs slowly is not taken for a jump.

When one axis is declared faulty, a lower level is enough on the others. What disturbs one axis often
disturbs them all, and going back to an anchor loses the evidence against them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.fault_observer import SHORTEST
from quadftc_fdi.supervision.anchors import PROMOTION, One, Residuals
from quadftc_fdi.supervision.sensor_noise import AVERAGED, LONG, Statistics
from quadftc_model import arrays
from quadftc_model.arrays import (
    Array,
    Float,
    Mask,
    Scalar,
    Vector,
    any_of,
    clip,
    column,
    larger,
    namespace,
    smaller,
    sqrt,
    where,
)

MEANS = AVERAGED[1:]  # s; averaging times, the last two of the anchors
LEVELS = np.array([1.08, 1.0, 1.0, 0.95, 0.95])  # 1; of the threshold, as short averages have more chances
OF_FILTER, IS_OLD, IS_YOUNG = (np.isin(np.arange(6), each) * 1.0 for each in ((0, 1, 2, 3), 4, 5))
SHARE = 0.1  # 1; of the filter's own variance in an average, as its residuals are not perfectly white
ALLOWANCE, LIMIT, LARGEST = 2.5, 4.5, 4.4  # 1; of the cumulative sum, and the largest residual it takes
OUTLIER = 5.0  # 1; standard deviations beyond which a sample is an outlier
SUSPICION = 0.75  # 1; share of the threshold at which an axis is suspect
TOGETHER = 0.6  # 1; share that is enough when another axis is declared faulty
RATIOS = np.array([np.inf, *LEVELS**2])  # 1; of the squares; a sample by itself declares nothing
SUDDEN = 0.06  # s; so soon after the first suspicion the filter has learned nothing from the fault
BOTH_WAYS = np.array([1.0, -1.0])

Sums = Float[arrays.AnyArray, "*batch 3 2"]


class Evidence(NamedTuple):
    """What the tests remember."""

    means: Residuals  # averages of the residuals [rad]
    base: Vector  # average over 0.05 s of the residual, from which slow errors are foretold [rad]
    sums: Sums  # cumulative sums, upwards and downwards [1]
    suspicion: Vector  # how long an axis has been suspect [s]


class Scores(NamedTuple):
    """How far each axis is from healthy (..., 3)."""

    mean: Vector  # largest squared average, in variances
    sum: Vector  # larger cumulative sum
    suspect: Mask  # the axis may become faulty: its measurement is not used
    outlier: Mask  # the sample is an outlier: it is not used


class Findings(NamedTuple):
    """Faults declared at this sample (..., 3) bool."""

    alarm: Mask  # an axis trusted so far is faulty
    abrupt: Mask  # by the cumulative sum
    sudden: Mask  # by the cumulative sum alone, and within SUDDEN of the first suspicion
    creeping: Mask  # by an average, so the fault has been there for some time


class AveragingWeights(NamedTuple):
    """Weights of one step."""

    mean: Array  # (5,) of a sample in the averages
    predicted: Array  # (3, 6) of the variances of three predictions in those of the statistics
    white: Scalar  # variance of white noise in a sample over that in the longest average


def averaging_weights(dt: Scalar) -> AveragingWeights:
    """Weights for a step ``dt`` [s]."""
    white = where(dt > 0.0, dt / larger(2.0 * AVERAGED + dt, SHORTEST), 1.0)
    of_filter = (white + SHARE * (AVERAGED > 0.0)) * OF_FILTER
    predicted = namespace(white).stack([of_filter, IS_OLD, IS_YOUNG])
    return AveragingWeights(dt / (MEANS + dt), predicted, 1.0 / white[LONG])


def start_evidence(like: Vector) -> Evidence:
    """Return evidence of nothing."""
    xp, shape = namespace(like), like.shape
    return Evidence(xp.zeros((*shape, 5)), xp.zeros_like(like), xp.zeros((*shape, 2)), xp.zeros_like(like))


def collect_evidence(
    evidence: Evidence,
    residuals: Residuals,
    variances: Statistics,
    colour: Vector,
    trusted: Mask,
    weights: AveragingWeights,
    dt: Scalar,
    threshold: Scalar,
) -> tuple[Evidence, Scores, Statistics]:
    """Test the residuals [rad] of one sample on the axes trusted so far and measured in it.

    ``variances`` [rad²] are those of healthy statistics. An axis is faulty at ``threshold`` standard
    deviations. Also return the squares of the statistics [rad²].
    """
    xp, residual = namespace(residuals), residuals[..., 0]
    sample = column(residual - colour * evidence.base)
    size = sample / sqrt(variances[..., :1])
    # An outlier is left out of the averages: alone it is no fault, and three are one by their sum.
    outlier = trusted & (abs(size[..., 0]) > OUTLIER)
    counts = trusted & ~outlier
    means = evidence.means + weights.mean * (residuals - evidence.means)
    means = where(column(counts), means, evidence.means)
    base = where(counts, evidence.base + weights.mean[0] * (residual - evidence.base), evidence.base)
    # Cumulative sums of the residual beyond the allowance, in its standard deviations.
    sums = evidence.sums + smaller(size * BOTH_WAYS, LARGEST) - ALLOWANCE
    sums = where(column(trusted), clip(sums, 0.0, 2.0 * LIMIT), evidence.sums)
    squares = xp.concatenate([sample, means], axis=-1) ** 2
    scores = (squares / variances / RATIOS).max(axis=-1), larger(sums[..., 0], sums[..., 1])
    suspect = trusted & ((scores[1] > 0.5 * LIMIT) | (scores[0] > (SUSPICION * threshold) ** 2))
    suspicion = (evidence.suspicion + dt) * suspect
    return Evidence(means, base, sums, suspicion), Scores(*scores, suspect, outlier), squares


def declare_faults(scores: Scores, suspicion: Vector, trusted: Mask, threshold: Scalar) -> Findings:
    """Declare the axes faulty whose score is above the threshold, given how long [s] they were suspect."""
    abrupt = trusted & (scores.sum > LIMIT)
    creeping = trusted & (scores.mean > threshold**2) & ~abrupt
    alarm = abrupt | creeping
    # with one axis found, less is enough on the others
    close = scores.suspect | (trusted & (scores.mean > (TOGETHER * threshold) ** 2))
    alarm = alarm | (any_of(alarm) & close)
    return Findings(alarm, abrupt, alarm & ~creeping & (suspicion < SUDDEN), creeping)


def update_evidence(evidence: Evidence, residual: Vector, promoted: One, outdated: Mask) -> Evidence:
    """Forget outdated evidence; follow the anchors where the young one became the old one."""
    means = where(column(promoted), evidence.means @ PROMOTION, evidence.means)
    return restart(evidence._replace(means=means), residual, outdated)


def restart(evidence: Evidence, residual: Vector, outdated: Mask) -> Evidence:
    """Forget the evidence on some axes, and foretell slow errors from the residual [rad] of now."""
    kept = column(~outdated)
    base = where(outdated, residual, evidence.base)
    return evidence._replace(means=evidence.means * kept, base=base, sums=evidence.sums * kept)
