"""Supervision of an attitude sensor, axis by axis: residual tests, tracked fault, when to trust again.

Residuals are measured minus predicted Euler angles. Healthy, they are the sensor's white noise plus a slow
error (the attitude filter or the markers of a real sensor wander, more so when moving); the model says how
large, and what is larger than the model says is learned.

Tests, on each axis:

* averages over 0.05, 0.15 and 0.5 s of the filter's residual, for incipient faults;
* averages over 0.25 s of the residuals of two anchors, states of the filter some seconds old that have seen
  no measurement since, for faults so slow that the filter follows them;
* a cumulative sum (Page, 1954) of the residual beyond three standard deviations, for abrupt ones.

When one axis is found, the others are held to a lower level, as what disturbs one often disturbs them all,
and the evidence against them is lost when the filter goes back to an anchor.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.anchors import OLD, ROLLED, YOUNG
from quadftc_model.arrays import Array, any_of, changed_where, namespace

MEANS = np.array([0.05, 0.15, 0.5, 0.25, 0.25])  # s; averaging times, the last two of the anchors
LEVELS = np.array([1.08, 1.0, 1.0, 0.95, 0.95])  # 1; of the threshold, as short averages have more chances
OF_FILTER, IS_OLD, IS_YOUNG = (np.isin(np.arange(5), each) * 1.0 for each in ((0, 1, 2), OLD, YOUNG))
SHARE = 0.1  # 1; of the filter's own variance in an average, as its residuals are not perfectly white
ALLOWANCE, LIMIT, LARGEST = 3.0, 4.5, 8.0  # 1; of the cumulative sum, and the largest step it takes
SUSPICION = 0.75  # 1; share of the threshold at which an axis is suspect
TOGETHER = 0.6  # 1; share at which it is taken for faulty when another is found: faults come together
RATIOS = LEVELS**2  # 1; the same of squares
SUDDEN = 0.06  # s; so soon after the first suspicion the filter has taken nothing from the fault
OUTLIER = 4.0  # 1; how far beyond what is known a residual may move what is learned
STILL = np.array([0.15, 0.6])  # s; two averages of a fault, whose difference shows that it moves
AGREES, STANDS, JUMPS = 16.0, 9.0, 25.0  # 1; squared standard deviations
GRADUAL = 6.0  # 1; how many times as long a fault that never visibly moved must look healthy
ALMOST_STILL = 0.0087  # rad, 0.5 deg; an error of ours moves a little, as the vehicle does
BOTH_WAYS = np.array([1.0, -1.0])


class Sizes(NamedTuple):
    """Variances of a healthy residual [rad²]."""

    noise: Array  # (..., 3) white noise of one sample
    slow: Array  # (..., 3) the slow error
    own: Array  # (..., 3, 3) what filter, old and young anchor say of their predictions


class Tests(NamedTuple):
    """What the tests remember."""

    means: Array  # (..., 3, 5) averages of the residuals [rad]
    learned: Array  # (..., 3, 5) squares of the averages over what the model says [1]
    sums: Array  # (..., 3, 2) cumulative sums, upwards and downwards [1]
    suspicion: Array  # (..., 3) how long an axis has been suspect [s]


class Track(NamedTuple):
    """The fault of each axis while it is faulty, all zero otherwise."""

    fault: Array  # (..., 3) [rad]
    slope: Array  # (..., 3) [rad/s]
    count: Array  # (..., 3) samples since the last jump
    jumped: Array  # (..., 3) 1: it has jumped, or visibly moved, since it was found
    means: Array  # (..., 3, 2) two averages of it [rad]
    since: Array  # (..., 3) time since the onset [s]
    calm: Array  # (..., 3) how long the axis has looked healthy again [s]


class Weights(NamedTuple):
    """Weights of one step."""

    mean: NDArray[np.float64]  # (5,) of a sample in the averages
    variance: NDArray[np.float64]  # (5, 5) of noise, slow error and own three in their variances
    still: NDArray[np.float64]  # (2,)
    alpha: float  # of a sample in the tracked fault
    beta: float  # [1/s] in its slope
    passed: float  # of white noise in the variance of the tracked fault (Blair, 1993)
    settled: float  # samples after a jump before the slope moves
    white_equivalent: float  # of the slow error, as white noise of a sample


def weights(dt: float, memory: float, tracking: float) -> Weights:
    """Weights for a step ``dt``, the slow error's correlation time and the averaging of faults, all [s]."""
    numbers = all(isinstance(each, float) for each in (dt, memory, tracking))
    return _known_weights(dt, memory, tracking) if numbers else _weights(dt, memory, tracking)


def _weights(dt: Array, memory: Array, tracking: Array) -> Weights:
    starts = isinstance(dt, float) and dt == 0.0
    alpha = 1.4 * dt / (tracking + dt)
    curve = alpha**2 / (2.0 - alpha)
    passed = (2.0 * alpha**2 + 2.0 * curve - 3.0 * alpha * curve) / (4.0 - 2.0 * alpha - curve)
    white = dt / (2.0 * MEANS + dt)
    rows = [white, memory / (memory + MEANS), (white + SHARE) * OF_FILTER, IS_OLD, IS_YOUNG]
    xp = namespace(white)
    return Weights(
        mean=dt / (MEANS + dt),
        variance=xp.stack([xp.asarray(row) for row in rows]),
        still=dt / (STILL + dt),
        alpha=alpha,
        beta=0.0 if starts else curve / dt,
        passed=1.0 if starts else passed / alpha,
        settled=math.inf if starts else 1.4 / alpha,
        white_equivalent=0.0 if starts else 2.0 * memory / dt,
    )


_known_weights = functools.lru_cache(maxsize=64)(_weights)  # a flight has few different steps


class Settings(NamedTuple):
    """Parameters of the supervision, as of the observer."""

    threshold: float
    learning: float
    recovery: float
    patience: float


class Findings(NamedTuple):
    """What the tests say of each axis (..., 3)."""

    alarm: Array  # bool: an axis trusted so far is faulty
    sudden: Array  # bool: not by an average, and within SUDDEN of the first suspicion
    slow: Array  # bool: by an average, so for some time already
    suspect: Array  # bool: it may become so; its measurement is not used


def tested(
    tests: Tests, residuals: Array, sizes: Sizes, trusted: Array, w: Weights, dt: float, settings: Settings
) -> tuple[Tests, Findings]:
    """Take one sample of residuals.

    Parameters
    ----------
    tests : Tests
    residuals : array (..., 3, 5)
        Of the filter three times, then of the old and the young anchor [rad].
    sizes : Sizes
    trusted : array (..., 3) bool
        Trusted so far, and measured in this sample.
    w : Weights
    dt : float
        [s]
    settings : Settings
    """
    xp = namespace(residuals)
    taken = trusted[..., None]
    noise, slow = sizes.noise, sizes.slow
    parts = xp.concatenate([noise[..., None], slow[..., None], sizes.own], axis=-1)
    means = tests.means + taken * w.mean * (residuals - tests.means)
    ratio = means**2 / (parts @ w.variance)
    excess = xp.maximum(tests.learned, 1.0)
    news = xp.minimum(ratio, OUTLIER * excess) - tests.learned
    learned = tests.learned + taken * (dt / settings.learning) * news
    level = (ratio / (excess * RATIOS)).max(axis=-1)
    single = xp.sqrt((noise + slow + sizes.own[..., 0]) * excess[..., 0])
    step = xp.minimum((residuals[..., 0] / single)[..., None] * BOTH_WAYS, LARGEST) - ALLOWANCE
    sums = (tests.sums + taken * step).clip(0.0, 2.0 * LIMIT)
    top = sums.max(axis=-1)
    suspect = trusted & ((top > 0.5 * LIMIT) | (level > (SUSPICION * settings.threshold) ** 2))
    suspicion = (tests.suspicion + dt) * suspect

    def findings() -> Findings:
        abrupt = trusted & (top > LIMIT)
        creeping = trusted & (level > settings.threshold**2) & ~abrupt
        close = suspect | (trusted & (level > (TOGETHER * settings.threshold) ** 2))
        alarm = abrupt | creeping
        alarm = alarm | (any_of(alarm) & close)
        return Findings(alarm, alarm & ~creeping & (suspicion < SUDDEN), creeping, suspect)

    found = changed_where(suspect, findings, Findings(suspect, suspect, suspect, suspect))
    return Tests(means, learned, sums, suspicion), found


def begun_anew(tests: Tests, rolled: Array, anew: Array) -> Tests:
    """Tests that begin anew for axes (..., 3), and roll on with the anchors (..., 1)."""
    xp = namespace(anew)

    def changed() -> Tests:
        means = xp.where(rolled[..., None], tests.means @ ROLLED, tests.means)
        kept = ~anew[..., None]
        return tests._replace(means=means * kept, sums=tests.sums * kept)

    return changed_where(anew | rolled, changed, tests)


def spread_of(sizes: Sizes, learned: Array, w: Weights) -> Array:
    """Variance (..., 3) of a healthy average over 0.15 s, the filter's own error left out [rad²]."""
    xp = namespace(learned)
    noise, slow = w.variance[0, 1], w.variance[1, 1]
    return (sizes.noise * noise + sizes.slow * slow) * xp.maximum(learned[..., 1], 1.0)


def tracked(
    track: Track, residual: Array, sizes: Sizes, alarm: Array, valid: Array, w: Weights, dt: float
) -> Track:
    """Follow the residual of the faulty axes by an alpha-beta filter that begins anew at every jump."""
    xp = namespace(residual)
    expected = track.fault + track.slope * dt
    error = residual - expected
    jump = alarm | (error**2 > JUMPS * (sizes.noise + sizes.slow))
    count = (track.count + 1.0) * ~jump
    alpha = xp.maximum(w.alpha, 1.0 / (count + 1.0)) * valid
    means = track.means + valid[..., None] * w.still * (residual[..., None] - track.means)
    return track._replace(
        fault=expected + alpha * error,
        slope=(track.slope + w.beta * valid * error) * (count > w.settled),
        count=count,
        jumped=xp.maximum(track.jumped, 1.0 * jump) * ~alarm,
        means=xp.where(jump[..., None], residual[..., None], means),
    )


def recovered(
    track: Track, faulty: Array, own: Array, spread: Array, turning: Array, settings: Settings, dt: float
) -> tuple[Track, Array, Array]:
    """Say which faulty axes can be trusted again (..., 3), and which although they disagree with us.

    An axis looks healthy when its fault is within what dead reckoning knows, and stands still, the longer if
    it never visibly moved, as a slow fault that was found early looks the same for a while; after
    ``patience`` a fault that stands still is taken for an error of ours, as without it a wrong start or a
    false alarm would never end.

    Parameters
    ----------
    own : array (..., 3)
        Variance of the dead-reckoned angle [rad²].
    spread : array (..., 3)
        Of `spread_of` [rad²].
    turning : array (..., 1)
        Variance of the gyro bias [rad²/s²].
    """
    xp = namespace(own)
    moved = track.means[..., 0] - track.means[..., 1]
    unmoved = spread + turning * (STILL[1] - STILL[0]) ** 2
    still = moved**2 < STANDS * unmoved
    jumped = xp.maximum(track.jumped, 1.0 * (moved**2 > JUMPS * unmoved))
    agrees = track.means[..., 0] ** 2 < AGREES * (own + spread)
    known = (track.since > STILL[1]) & (track.count * dt > STILL[1])  # before, both are near the first value
    outlasted = (track.since > settings.patience) & (xp.abs(moved) < ALMOST_STILL)
    calm = (track.calm + dt) * (faulty & known & ((still & agrees) | outlasted))
    trusted = calm > settings.recovery * xp.where(outlasted | (jumped > 0.0), 1.0, GRADUAL)
    return track._replace(calm=calm, jumped=jumped), trusted, trusted & ~agrees


def track_of(track: Track, faulty: Array) -> Track:
    """The track of faulty axes (..., 3); all zero for the others."""
    return Track(
        fault=track.fault * faulty,
        slope=track.slope * faulty,
        count=track.count * faulty,
        jumped=track.jumped * faulty,
        means=track.means * faulty[..., None],
        since=track.since * faulty,
        calm=track.calm * faulty,
    )
