"""Flights with slopes, in the process that is told to."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.flights import flight
from quadftc_campaign.tune.cost import slope_of_term, term
from quadftc_campaign.tune.searched_gains import Gains, directions

TOGETHER = 256  # lanes: flights times gains


class Sensitivity(NamedTuple):
    """Metrics of some flights, and how gains change them."""

    values: NDArray[np.float64]  # (flights, metrics, 3)
    slopes: NDArray[np.float64]  # (flights, gains, metrics, 3), by the logarithm of a gain


def sensitivity(
    campaign: Campaign,
    gains: Gains,
    metrics: Sequence[str],
    numbers: Sequence[int],
    progress: Callable[[int], None] = lambda samples: None,
) -> Sensitivity:
    """Fly some flights of a campaign, each once for each gain.

    Parameters
    ----------
    campaign : Campaign
        With these gains.
    gains : Gains
    metrics : sequence of str
        Of `quadftc_campaign.tune.cost.TERMS`.
    numbers : sequence of int
        Of the flights.
    progress : callable
        Called with the number of samples flown since the last call.
    """
    variant = campaign.variants[0]
    ways = directions(campaign, variant, gains, numbers[0])
    flights = [flight(campaign, number, variant) for number in numbers]
    engine = _engine(campaign.float32, tuple(ways[0]))
    found = engine.slopes(
        [each.parts for each in flights for _ in ways],
        [each.events for each in flights for _ in ways],
        ways * len(flights),
        progress,
    )
    spans = [(each.outcome.rows - 1) * each.outcome.period for each in found]
    values = [
        [term(name, each.outcome.sums, span) for name in metrics]
        for each, span in zip(found[:: len(ways)], spans[:: len(ways)], strict=True)
    ]
    slopes = [
        [slope_of_term(name, each.outcome.sums, each.slope, span) for name in metrics]
        for each, span in zip(found, spans, strict=True)
    ]
    shape = (len(flights), len(ways), len(metrics), 3)
    return Sensitivity(np.array(values), np.array(slopes).reshape(shape))


def flights_together(gains: Gains) -> int:
    """How many flights fill the lanes."""
    return max(TOGETHER // len(gains.logarithms), 1)


@functools.cache
def _engine(float32: bool, free: tuple[str, ...]) -> Any:
    from quadftc_campaign.batch.engine import LANES, Engine
    from quadftc_campaign.batch.session import keep_compiled

    keep_compiled()
    return Engine(float32, LANES, free)
