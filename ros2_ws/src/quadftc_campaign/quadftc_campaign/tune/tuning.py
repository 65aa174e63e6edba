"""Tuning a campaign's scheme: search on its flights, judge on others."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.cluster import cluster_client, run_tasks
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.flying import FLIGHTS_A_CHUNK, fly_chunk
from quadftc_campaign.table import Rows, table_of
from quadftc_campaign.tune.cost import Cost
from quadftc_campaign.tune.result import Judged, gains_document, judged, write_gains
from quadftc_campaign.tune.search import Search, Step
from quadftc_campaign.tune.searched_gains import Gains, gains_of, with_gains
from quadftc_campaign.tune.slopes_work import Sensitivity, flights_together, sensitivity
from quadftc_flight.scenario import build_scenario


class Tuned(NamedTuple):
    """What was found."""

    start: Gains
    gains: Gains
    failing: frozenset[str]  # conditions of the theory that failed before, and may fail still
    before: Judged
    after: Judged


def checked(campaign: Campaign) -> Gains:
    """Return the gains that a campaign says to tune, as they are.

    Raises
    ------
    CampaignError, ScenarioError
        If it says nothing of tuning, or nothing that can be done.
    """
    source = campaign.document.source
    if campaign.tune is None:
        raise CampaignError(f"{source}: no key 'tune': expected gains, cost and steps")
    first, *others = campaign.variants
    if others or first.observer or first.controller:
        raise CampaignError(f"{source}: tune: one scheme is tuned, without observers or controllers to cross")
    scenario = build_scenario(campaign.base)
    return gains_of(campaign, scenario.scheme(first.scheme), campaign.tune.gains)


def tune(
    campaign: Campaign,
    address: str | None,
    workers: int,
    told: Callable[[Step], None],
    progress: Callable[[int], None] = lambda samples: None,
) -> Tuned:
    """Tune; nothing is written.

    Parameters
    ----------
    campaign : Campaign
    address : str, optional
        Of a Dask scheduler; None: start workers here.
    workers : int
        How many to start here.
    told : callable
        Called with each step of the search.
    progress : callable
        Called with the number of samples flown since the last call.

    Raises
    ------
    CampaignError, ClusterError, ScenarioError, ValueError
        If it cannot be done.
    """
    start = checked(campaign)
    with cluster_client(address, workers) as client:

        def fly(with_them: Campaign, gains: Gains, numbers: Sequence[int]) -> Sensitivity:
            size = min(flights_together(gains), -(-len(numbers) // workers))
            pieces = [list(numbers[at : at + size]) for at in range(0, len(numbers), size)]
            metrics = tuple(with_them.tune.cost) if with_them.tune else ()
            arguments = [(with_them, gains, metrics, piece) for piece in pieces]
            found = dict(run_tasks(client, sensitivity, arguments, progress))
            parts: list[Sensitivity] = [found[place] for place in range(len(pieces))]
            return Sensitivity(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

        search = Search(campaign, start, fly)
        for step in search.steps():
            told(step)
        if search.cost is None:
            raise ValueError("no step was made")
        before, after = _judged(client, campaign, (start, search.result), search.cost, progress)
    return Tuned(start, search.result, search.failing, before, after)


def write(tuned: Tuned, campaign: Campaign, path: Path) -> None:
    """Write the file of the gains.

    Raises
    ------
    CampaignError
        If it cannot be written.
    """
    scheme = campaign.variants[0].scheme
    document = gains_document(build_scenario(campaign.base), scheme, tuned.gains)
    flights = campaign.tune.held_out if campaign.tune else 0
    write_gains(path, campaign, document, tuned.before, tuned.after, flights)


def _judged(
    client: Any, campaign: Campaign, each: Sequence[Gains], cost: Cost, progress: Callable[[int], None]
) -> list[Judged]:
    """Fly the flights after those of the campaign, with each of some gains."""
    count = campaign.tune.held_out if campaign.tune else 0
    numbers = list(range(campaign.flights, campaign.flights + count))
    pieces = [numbers[at : at + FLIGHTS_A_CHUNK] for at in range(0, count, FLIGHTS_A_CHUNK)]
    longer = dataclasses.replace(campaign, flights=campaign.flights + count)
    tried = [with_gains(longer, campaign.variants[0].scheme, gains) for gains in each]
    tasks = [(one, piece) for one in tried for piece in pieces]
    rows: list[Rows] = [[] for _ in each]
    for place, found in run_tasks(client, fly_chunk, tasks, progress):
        rows[place // len(pieces)] += found
    return [judged(table_of(some), cost) for some in rows]
