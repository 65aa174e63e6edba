r"""The noise of an attitude sensor, learned on each axis by what its healthy residuals show.

Every statistic of `residual_tests` (a sample, averages over three times, averages of two anchors) has a
variance that the sensor gives it, at some body rates k, besides that of the prediction:

    v = sum_k u_k a_k,   u: weights of the rate,   E[m²] = s v + w' P      s: scale by attitude, P: prediction

Recursive expectation maximisation of such variance components (Dempster, Laird and Rubin 1977; recursive:
Titterington 1984) moves each by its share of what was expected:

    a_k <- a_k + g u_k s a_k / E[m²] (r² / 3 - 1) a_k,   r = min(m² / E[m²], 12)

For Gaussian residuals the mean of r² is 3. The fourth power counts rare large errors more than the square
would; the bound keeps one of them from teaching much. The gain is g = dt C / (C T + t): time t of experience
counts more than the prior, which is worth the time T, and recent time more than time long ago.

The tests use what was `known` when the youngest anchor was set, so that a fault cannot excuse itself: what
the time since has taught is given up where a fault is declared. An alarm that was over at once was false, and
doubles the variances.

White noise is one thing, slow errors are another: a sensor that errs slowly errs at times more than ever
before. So its variances stay at the prior at least. `cautious_variances` tells the two by how much larger
averages over 0.05 and 0.15 s are than those of white noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model import arrays
from quadftc_model.arrays import (
    Column,
    Float,
    Mask,
    Vector,
    cache_numbers,
    changed_where,
    clip,
    column,
    components,
    larger,
    namespace,
    pick,
    stacked,
)

Statistics = Float[arrays.AnyArray, "*batch 3 6"]  # a sample, three averages, old and young anchor
ByMotion = Float[arrays.AnyArray, "*batch 3 6 4"]  # by body rate, at `RATES`
Weights = Float[arrays.AnyArray, "*batch 4"]  # of the present body rate among `RATES`

DEG = np.pi / 180.0
AVERAGED = np.array([0.0, 0.05, 0.15, 0.5, 0.25, 0.25])  # s; averaging times of the statistics
SAMPLE, SHORT, MIDDLE, LONG = range(4)
RATES = np.array([0.25, 0.7, 2.5, 8.0])  # rad/s
# prior: white noise of a sample at 250 Hz, and a slow error over 0.15 s that grows with the body rate
WHITE, SLOW, MEMORY, PERIOD = 0.1 * DEG, np.array([0.1, 0.2, 0.2, 0.3]) * DEG, 0.15, 0.004
# 1; spectral density of slow errors over that of the longest average: what repeats with the attitude lasts
LASTING = np.array([1.0, 2.0, 4.0, 4.0])
# lower end and width, in its logarithm, of each interval between them
INTERVALS = [*zip(RATES[:-1].tolist(), np.log(RATES[1:] / RATES[:-1]).tolist(), strict=True)]
SLOWEST: float = RATES[0].item()
LEAST = (0.001 * DEG) ** 2  # rad²; no attitude sensor is better
EARLY = np.array([0.1, 0.1, 0.2, 0.5, 2.0, 2.0])  # s; what the prior is worth
LATE = 120.0  # s; experience beyond this is forgotten
RECENT = 2.0  # 1; C
WORTH = RECENT * EARLY[:, None]  # s; C T
FASTEST = 0.3  # 1/s; largest gain, so that the time between two anchors cannot do more than renew
COLOUR = (
    0.5,
    10.0,
)  # 1; caution begins at 0.5 / 10 of a sample's variance in slow errors, and is full at 1.5 / 10
# s, 1/s; what is learned is known at once in the first seconds, with a larger gain; no multiple of a sampling
# time, where rounding would decide
START, FRESH = 5.011, 4.0
MOST = 5.0  # 1; by what factor a variance changes between two anchors, at most
PAUSE = 0.019  # s; between two times of learning
CLIP = 12.0  # 1; of r
SURPRISE = 2.0  # 1; factor on the variances after a false alarm


class SensorNoise(NamedTuple):
    """What is learned of the sensor."""

    known: ByMotion  # variances [rad²] that the tests use
    learned: ByMotion  # those of now
    time: Float[arrays.AnyArray, "*batch 3 4"]  # of experience [s]
    exact: Statistics  # what is known, at the present rate [rad²]
    cautious: Statistics  # the same with caution [rad²]
    colour: Vector  # share of slow errors in an average over 0.05 s
    seen: Statistics  # share of the variance of the prediction that each statistic sees
    elapsed: Column  # since something was learned [s]


def prior_variances() -> NDArray[np.float64]:
    """Variances (6, 4) [rad²] before anything is learned."""
    white = WHITE**2 * PERIOD / (2.0 * AVERAGED + PERIOD)
    return white[:, None] + SLOW**2 * (MEMORY / (MEMORY + AVERAGED))[:, None]


PRIOR = prior_variances()


def start_noise(like: Vector) -> SensorNoise:
    """Return the prior."""
    xp = namespace(like)
    start = xp.zeros((*like.shape, 6, len(RATES))) + PRIOR
    rest, time = start[..., 0], xp.zeros((*like.shape, len(RATES)))
    none, ones = xp.zeros_like(like), xp.ones_like(rest)
    return SensorNoise(start, start, time, rest, rest, none, ones, none[..., :1])


def rate_weights(rate: Column) -> Weights:
    """Weights of `RATES` for linear interpolation in the logarithm of a body rate [rad/s]."""
    (rate,) = components(rate)
    log = math.log if isinstance(rate, float) else namespace(rate).log
    rate = larger(rate, SLOWEST)
    a, b, c = [clip(log(rate / low) / step, 0.0, 1.0) for low, step in INTERVALS]
    return stacked([1.0 - a, a - b, b - c, c])


def at_rate(values: ByMotion, weights: Weights) -> Statistics:
    """Values of the statistics at the present body rate."""
    return (values * weights[..., None, None, :]).sum(axis=-1)


def slow_share(learned: Statistics, dt: float) -> Vector:
    """Share of slow errors in the variance of an average over 0.05 s."""
    white = dt / (2.0 * AVERAGED[SHORT] + dt)
    return (1.0 - white * learned[..., SAMPLE] / learned[..., SHORT]).clip(0.0, 1.0)


def lasting(weights: Weights, colour: Vector) -> Vector:
    """Spectral density of the error over that of its longest average; 1 of a sensor without slow errors."""
    return 1.0 + (weights @ (LASTING - 1.0))[..., None] * (4.0 * colour - 1.0).clip(0.0, 1.0)


def cautious_variances(learned: Statistics, weights: Weights, dt: float) -> Statistics:
    """Return variances [rad²] that are no less than the prior, as far as the noise is not white.

    A sensor that errs slowly errs more at times than it did before.
    """
    sample, short, middle = (learned[..., index] for index in (SAMPLE, SHORT, MIDDLE))
    slow = (short + middle) / sample - _share_of_white(dt)
    caution = clip(COLOUR[1] * slow - COLOUR[0], 0.0, 1.0)
    return larger(learned, caution[..., None] * at_rate(PRIOR, weights))


@cache_numbers
def _share_of_white(dt: float) -> float:
    """Sum of the variances of white noise in averages over 0.05 and 0.15 s, over that of a sample."""
    return sum(dt / (2.0 * each + dt) for each in AVERAGED[[SHORT, MIDDLE]].tolist())


def cautious_spread(weights: Weights, gain: Vector) -> Vector:
    """Variance [rad²] of an average over 0.15 s by the prior."""
    return gain * at_rate(PRIOR, weights)[..., MIDDLE]


def learn_noise(
    noise: SensorNoise,
    squares: Statistics,
    gain: Vector,
    predicted: Statistics,
    weights: Weights,
    taken: Mask,
    dt: float,
) -> SensorNoise:
    """Learn from the squares of the statistics [rad²] on the axes that are ``taken``, every `PAUSE`.

    ``gain`` is the variance of each angle for one of 1 rad² about each body axis, ``predicted`` [rad²] what
    the prediction gives to the variances of the statistics.
    """
    (elapsed,) = components(noise.elapsed)
    elapsed = elapsed + dt
    due = elapsed > PAUSE

    def learn() -> SensorNoise:
        xp, now = namespace(squares), column(column(due))
        scale, step = gain[..., None], (column(elapsed * due) * taken)[..., None]  # (..., 3, 1)
        expected = noise.exact * scale + predicted
        surprise = xp.minimum(squares / expected, CLIP)
        news = (surprise * surprise / 3.0 - 1.0) / expected * (scale * step)
        u = weights[..., None, :]  # (..., 1, 4)
        time = xp.minimum(noise.time + step * u, LATE)
        new = noise.time.sum(axis=-1) < START
        fastest = changed_where(new, lambda: xp.where(new, FRESH, FASTEST)[..., None, None], FASTEST)
        rate = xp.minimum(RECENT / (WORTH + time[..., None, :]), fastest)
        change = noise.known * noise.known * rate * (news[..., None] * u[..., None, :])
        learned = (noise.learned + change).clip(noise.known / MOST, noise.known * MOST)
        learned = xp.maximum(learned, LEAST)
        known = changed_where(new, lambda: xp.where(new[..., None, None], learned, noise.known), noise.known)
        exact = at_rate(known, weights)
        cautious = cautious_variances(exact, weights, dt)
        colour = slow_share(exact, dt)
        seen = (1.0 - colour[..., None] * (AVERAGED == 0.0)) ** 2
        return SensorNoise(
            known=pick(column(now), known, noise.known),
            learned=learned,
            time=time,
            exact=pick(now, exact, noise.exact),
            cautious=pick(now, cautious, noise.cautious),
            colour=pick(column(due), colour, noise.colour),
            seen=pick(now, seen, noise.seen),
            elapsed=stacked([pick(due, 0.0, elapsed)]),
        )

    return changed_where(due, learn, SensorNoise(*noise[:-1], stacked([elapsed])))


def settle_noise(
    noise: SensorNoise, promoted: Column, alarm: Column, short: Mask, weights: Weights
) -> SensorNoise:
    """Let what is learned be known where a new anchor is set; give it up where a fault is declared."""
    xp = namespace(noise.known)

    def settle() -> SensorNoise:
        worse = 1.0 + (SURPRISE - 1.0) * short[..., None, None] * weights[..., None, None, :]
        known = xp.where(promoted[..., None, None], noise.learned, noise.known)
        learned = xp.where(alarm[..., None, None], noise.known, noise.learned)
        return noise._replace(known=known * worse, learned=learned * worse)

    return changed_where(promoted | alarm | short, settle, noise)
