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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model import arrays
from quadftc_model.arrays import (
    Column,
    Float,
    Mask,
    Scalar,
    Vector,
    branch,
    clip,
    column,
    larger,
    log,
    namespace,
    smaller,
    where,
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
LEAST = (0.001 * DEG) ** 2  # rad²; no attitude sensor is better
EARLY = np.array([0.1, 0.1, 0.2, 0.5, 2.0, 2.0])  # s; what the prior is worth
LATE = 120.0  # s; experience beyond this is forgotten
RECENT = 2.0  # 1; C
WORTH = RECENT * EARLY[:, None]  # s; C T
FASTEST = 0.3  # 1/s; largest gain, so that the time between two anchors cannot do more than renew
# 1; caution begins at 0.5 / 10 of a sample's variance in slow errors, and is full at 1.5 / 10
COLOUR = 0.5, 10.0
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
    xp = namespace(rate)
    passed = clip(log(larger(rate, RATES[0]) / RATES[:-1]) / np.log(RATES[1:] / RATES[:-1]), 0.0, 1.0)
    below, above = [xp.ones_like(rate), passed], [passed, xp.zeros_like(rate)]
    return xp.concatenate(below, axis=-1) - xp.concatenate(above, axis=-1)


def at_rate(values: ByMotion, weights: Weights) -> Statistics:
    """Values of the statistics at the present body rate."""
    return (values * weights[..., None, None, :]).sum(axis=-1)


def slow_share(learned: Statistics, dt: Scalar) -> Vector:
    """Share of slow errors in the variance of an average over 0.05 s."""
    white = dt / (2.0 * AVERAGED[SHORT] + dt)
    return clip(1.0 - white * learned[..., SAMPLE] / learned[..., SHORT], 0.0, 1.0)


def lasting(weights: Weights, colour: Vector) -> Vector:
    """Spectral density of the error over that of its longest average; 1 of a sensor without slow errors."""
    return 1.0 + column(weights @ (LASTING - 1.0)) * clip(4.0 * colour - 1.0, 0.0, 1.0)


def cautious_variances(learned: Statistics, weights: Weights, dt: Scalar) -> Statistics:
    """Return variances [rad²] that are no less than the prior, as far as the noise is not white.

    A sensor that errs slowly errs more at times than it did before.
    """
    sample, short, middle = (learned[..., index] for index in (SAMPLE, SHORT, MIDDLE))
    white = sum(dt / (2.0 * AVERAGED[index] + dt) for index in (SHORT, MIDDLE))
    caution = clip(COLOUR[1] * ((short + middle) / sample - white) - COLOUR[0], 0.0, 1.0)
    return larger(learned, column(caution) * at_rate(PRIOR, weights))


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
    dt: Scalar,
) -> SensorNoise:
    """Learn from the squares of the statistics [rad²] on the axes that are ``taken``, every `PAUSE`.

    ``gain`` is the variance of each angle for one of 1 rad² about each body axis, ``predicted`` [rad²] what
    the prediction gives to the variances of the statistics.
    """
    elapsed = noise.elapsed + dt

    def learn() -> SensorNoise:
        scale, step = gain[..., None], (elapsed * taken)[..., None]  # (..., 3, 1)
        expected = noise.exact * scale + predicted
        surprise = smaller(squares / expected, CLIP)
        news = (surprise * surprise / 3.0 - 1.0) / expected * (scale * step)
        u = weights[..., None, :]  # (..., 1, 4)
        time = smaller(noise.time + step * u, LATE)
        new = (noise.time.sum(axis=-1) < START)[..., None, None]
        rate = smaller(RECENT / (WORTH + time[..., None, :]), where(new, FRESH, FASTEST))
        change = noise.known * noise.known * rate * (news[..., None] * u[..., None, :])
        learned = clip(noise.learned + change, noise.known / MOST, noise.known * MOST)
        learned = larger(learned, LEAST)
        known = where(new, learned, noise.known)
        exact = at_rate(known, weights)
        colour = slow_share(exact, dt)
        return SensorNoise(
            known=known,
            learned=learned,
            time=time,
            exact=exact,
            cautious=cautious_variances(exact, weights, dt),
            colour=colour,
            seen=(1.0 - column(colour) * (AVERAGED == 0.0)) ** 2,
            elapsed=namespace(elapsed).zeros_like(elapsed),
        )

    return branch(elapsed[..., 0] > PAUSE, learn, lambda: noise._replace(elapsed=elapsed))


def settle_noise(
    noise: SensorNoise, promoted: Column, alarm: Column, short: Mask, weights: Weights
) -> SensorNoise:
    """Let what is learned be known where a new anchor is set; give it up where a fault is declared."""
    worse = 1.0 + (SURPRISE - 1.0) * short[..., None, None] * weights[..., None, None, :]
    known = where(promoted[..., None, None], noise.learned, noise.known)
    learned = where(alarm[..., None, None], noise.known, noise.learned)
    return noise._replace(known=known * worse, learned=learned * worse)
