# pyright: basic
"""The search: Adam (Kingma and Ba, 2015) on the logarithms of gains, within what the theory allows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.tune.cost import Cost, cost_from
from quadftc_campaign.tune.searched_gains import Gains, with_gains
from quadftc_campaign.tune.slopes_work import Sensitivity
from quadftc_flight.scenario import ScenarioError, build_scenario
from quadftc_theory.checks import check_scenario

Floats = NDArray[np.float64]

HALVINGS = 8  # of a step that leads to where a condition fails
AVERAGED = 3  # one part in so many, the last, of the steps that the gains are the mean of
LARGEST = 0.3  # of a logarithm in one step

# flies flights with slopes: campaign with the gains, gains, numbers of the flights
Fly = Callable[[Campaign, Gains, Sequence[int]], Sensitivity]


class Step(NamedTuple):
    """One step of the search."""

    gains: Gains  # before it
    cost: float
    slope: float  # norm of the gradient


class Search:
    """A search from the gains of a campaign's scheme.

    Parameters
    ----------
    campaign : Campaign
    gains : Gains
        To start from.
    fly : callable
    """

    def __init__(self, campaign: Campaign, gains: Gains, fly: Fly) -> None:
        if campaign.tune is None:
            raise ValueError("the campaign says nothing of tuning")
        self._campaign, self._gains, self._fly = campaign, gains, fly
        self._tune = campaign.tune
        self._scheme = campaign.variants[0].scheme
        self.failing = self._failing(gains)  # conditions of the theory that fail from the start
        self.cost: Cost | None = None  # known after the first step

    def steps(self) -> Iterator[Step]:
        """Search; ``result`` is there afterwards.

        Raises
        ------
        CampaignError
            If flights crash from the start, or wherever a step leads.
        """
        import optax

        optimiser = optax.adam(self._tune.rate)
        at, tried = self._gains.logarithms, 0
        state: Any = optimiser.init(at)
        before, seen = at, []
        while len(seen) < self._tune.steps:
            gains = self._gains.at(at)
            found = self._fly(
                with_gains(self._campaign, self._scheme, gains), gains, self._numbers(len(seen))
            )
            if not np.all(np.isfinite(found.slopes)) or not self._known(found.values):
                tried += 1
                at = 0.5 * (at + before) if tried < HALVINGS else before
                if not seen or tried > HALVINGS:
                    raise CampaignError(
                        f"{self._campaign.document.source}: flights crash with {gains.plain()}"
                    )
                continue
            if self.cost is None:
                self.cost = cost_from(self._tune.cost, found.values)
            gradient = self.cost.gradient(found.slopes)
            yield Step(gains, self.cost.of(found.values), float(np.linalg.norm(gradient)))
            update, state = optimiser.update(gradient, state)
            seen.append(at)
            before, tried = at, 0
            at = self._allowed(at, at + np.clip(np.asarray(update, np.float64), -LARGEST, LARGEST))
        last = seen[-max(len(seen) // AVERAGED, 1) :]
        self.result = self._gains.at(self._allowed(last[-1], np.mean(last, axis=0))).rounded()

    def _numbers(self, step: int) -> list[int]:
        """Flights of a step, in turn."""
        count = min(self._tune.flights, self._campaign.flights)
        return [(step * count + k) % self._campaign.flights for k in range(count)]

    def _known(self, values: Floats) -> bool:
        """Whether every metric that counts is a number: those of a flight that crashed are not."""
        there = np.isfinite(values)
        return bool(np.all(there.all(axis=0) | ~there.any(axis=0))) and bool(there.any())

    def _allowed(self, start: Floats, end: Floats) -> Floats:
        """The end of a step, or where on the way no condition fails that held at first."""
        for _ in range(HALVINGS):
            if self._failing(self._gains.at(end)) <= self.failing:
                return end
            end = 0.5 * (start + end)
        return start

    def _failing(self, gains: Gains) -> frozenset[str]:
        """Names of the conditions that fail (`quadftc check`), a value out of its bounds one of them."""
        # what is given out is rounded: it is that which must be allowed
        tried = with_gains(self._campaign, self._scheme, gains.rounded())
        try:
            scenario = build_scenario(tried.base)
        except ScenarioError as error:
            return frozenset([str(error)])
        report = check_scenario(scenario, scenario.scheme(self._scheme))
        return frozenset(
            item.name for section in report.sections for item in section.conditions if item.failed
        )
