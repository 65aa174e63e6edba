r"""The noise of an attitude sensor, learned on each axis by what its healthy residuals show.

Every statistic of `residual_tests` (a sample, averages over three times, averages of two anchors) has a
variance that the sensor gives it, at rest (a) and in motion (b), besides that of the prediction:

    v = (1 - u) a + u b,   0 <= u <= 1: motion,   E[m²] = s v + w' P      s: scale by attitude, P: prediction

Recursive expectation maximisation of such variance components (Dempster, Laird and Rubin 1977; recursive:
Titterington 1984) moves each by its share of what was expected:

    a <- a + g (1 - u) s a / E[m²] (r² / 3 - 1) a,   r = min(m² / E[m²], 12),   and b alike

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
ByMotion = Float[arrays.AnyArray, "*batch 3 6 2"]  # at rest, moving

DEG = np.pi / 180.0
AVERAGED = np.array([0.0, 0.05, 0.15, 0.5, 0.25, 0.25])  # s; averaging times of the statistics
SAMPLE, SHORT, MIDDLE, LONG = range(4)
# prior: white noise of a sample at 250 Hz, and a slow error of 0.1 deg at rest, 0.2 deg moving, over 0.15 s
WHITE, SLOW, MEMORY, PERIOD = 0.1 * DEG, np.array([0.1, 0.2]) * DEG, 0.15, 0.004
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
START, FRESH = 5.0, 4.0  # s, 1/s; what is learned is known at once in the first seconds, with a larger gain
PAUSE = 0.019  # s; between two times of learning
CLIP = 12.0  # 1; of r
SURPRISE = 2.0  # 1; factor on the variances after a false alarm


class SensorNoise(NamedTuple):
    """What is learned of the sensor."""

    known: ByMotion  # variances [rad²] that the tests use
    learned: ByMotion  # those of now
    time: Float[arrays.AnyArray, "*batch 3 2"]  # of experience [s]
    exact: Statistics  # what is known, in the present motion [rad²]
    cautious: Statistics  # the same with caution [rad²]
    elapsed: Column  # since something was learned [s]


def prior_variances() -> NDArray[np.float64]:
    """Variances (6, 2) [rad²] before anything is learned."""
    white = WHITE**2 * PERIOD / (2.0 * AVERAGED + PERIOD)
    return white[:, None] + SLOW**2 * (MEMORY / (MEMORY + AVERAGED))[:, None]


PRIOR = prior_variances()


def start_noise(like: Vector) -> SensorNoise:
    """Return the prior."""
    xp = namespace(like)
    start = xp.zeros((*like.shape, 6, 2)) + PRIOR
    rest, time = start[..., 0], xp.zeros((*like.shape, 2))
    return SensorNoise(start, start, time, rest, rest, xp.zeros_like(like[..., :1]))


def learned_variances(known: ByMotion, motion: Column) -> Statistics:
    """Variances [rad²] of the statistics by what is known of the noise, in a motion between 0 and 1."""
    return known[..., 0] + motion[..., None] * (known[..., 1] - known[..., 0])


def cautious_variances(learned: Statistics, motion: Column, dt: float) -> Statistics:
    """Return variances [rad²] that are no less than the prior, as far as the noise is not white.

    A sensor that errs slowly errs more at times than it did before.
    """
    sample, short, middle = (learned[..., index] for index in (SAMPLE, SHORT, MIDDLE))
    slow = (short + middle) / sample - _share_of_white(dt)
    caution = clip(COLOUR[1] * slow - COLOUR[0], 0.0, 1.0)
    prior = PRIOR[:, 0] + motion * (PRIOR[:, 1] - PRIOR[:, 0])
    return larger(learned, caution[..., None] * prior[..., None, :])


@cache_numbers
def _share_of_white(dt: float) -> float:
    """Sum of the variances of white noise in averages over 0.05 and 0.15 s, over that of a sample."""
    return sum(dt / (2.0 * each + dt) for each in AVERAGED[[SHORT, MIDDLE]].tolist())


def cautious_spread(motion: Column, gain: Vector) -> Vector:
    """Variance [rad²] of an average over 0.15 s by the prior."""
    rest, moving = PRIOR[MIDDLE].tolist()
    return gain * (rest + motion * (moving - rest))


def learn_noise(
    noise: SensorNoise,
    squares: Statistics,
    gain: Vector,
    predicted: Statistics,
    motion: Column,
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
        u = _shares(motion)  # (..., 1, 2)
        time = xp.minimum(noise.time + step * u, LATE)
        new = noise.time.sum(axis=-1) < START
        fastest = changed_where(new, lambda: xp.where(new, FRESH, FASTEST)[..., None, None], FASTEST)
        rate = xp.minimum(RECENT / (WORTH + time[..., None, :]), fastest)
        change = noise.known * noise.known * rate * (news[..., None] * u[..., None, :])
        learned = xp.maximum(noise.learned + change, LEAST)
        known = changed_where(new, lambda: xp.where(new[..., None, None], learned, noise.known), noise.known)
        exact = learned_variances(known, motion)
        cautious = cautious_variances(exact, motion, dt)
        return SensorNoise(
            known=pick(column(now), known, noise.known),
            learned=learned,
            time=time,
            exact=pick(now, exact, noise.exact),
            cautious=pick(now, cautious, noise.cautious),
            elapsed=stacked([pick(due, 0.0, elapsed)]),
        )

    return changed_where(due, learn, SensorNoise(*noise[:5], stacked([elapsed])))


def _shares(motion: Column) -> Float[arrays.AnyArray, "*batch 1 2"]:
    """Shares of rest and motion."""
    (moving,) = components(motion)
    return stacked([1.0 - moving, moving])[..., None, :]


def settle_noise(
    noise: SensorNoise, promoted: Column, alarm: Column, short: Mask, motion: Column
) -> SensorNoise:
    """Let what is learned be known where a new anchor is set; give it up where a fault is declared."""
    xp = namespace(noise.known)

    def settle() -> SensorNoise:
        u = _shares(motion)[..., None, :]
        worse = 1.0 + (SURPRISE - 1.0) * short[..., None, None] * u
        known = xp.where(promoted[..., None, None], noise.learned, noise.known)
        learned = xp.where(alarm[..., None, None], noise.known, noise.learned)
        return noise._replace(known=known * worse, learned=learned * worse)

    return changed_where(promoted | alarm | short, settle, noise)
