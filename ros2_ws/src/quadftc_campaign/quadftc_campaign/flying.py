"""The chunks of a campaign, and how a worker flies one."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from quadftc_campaign.batch.parts import Progress, structure_of
from quadftc_campaign.campaign_file import Campaign, Variant
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.flights import first_columns, flight_scenario, parts_of
from quadftc_campaign.table import Rows, fault_rows

FLIGHTS_A_CHUNK = 256  # what a kill loses at most, of each worker; as many as are flown together
OPEN_FLIGHTS_A_CHUNK = 4  # without the batch engine a flight takes seconds


def variant_of(campaign: Campaign, name: str | None) -> Variant:
    """Return a variant by name (the first by default); a `CampaignError` if there is none of that name."""
    for variant in campaign.variants:
        if name in (None, variant.name):
            return variant
    there = ", ".join(variant.name for variant in campaign.variants)
    raise CampaignError(f"{campaign.document.source}: no variant '{name}'; there are: {there}")


def chunks_of(campaign: Campaign, size: int | None = None) -> list[list[int]]:
    """Divide the flights into chunks of about equal size, each with flights of one structure.

    What changes the structure (`quadftc_campaign.batch.parts`) from one combination of the grids to another,
    such as the rate, keeps them apart. Others, such as inertias, are mixed: nothing is compiled for each.
    Structures take turns, so that workers compile one each and not the same one at the same time.
    """
    cells, is_loop = campaign.cells, campaign.source.is_loop
    size = size or (FLIGHTS_A_CHUNK if is_loop else OPEN_FLIGHTS_A_CHUNK)
    groups: dict[Any, list[int]] = {}
    for cell in range(min(cells, campaign.flights)):
        structure = None
        if is_loop and cells > 1:
            structure = structure_of(parts_of(flight_scenario(campaign, cell, campaign.variants[0])).loop)
        groups.setdefault(structure, []).extend(range(cell, campaign.flights, cells))
    turns = itertools.zip_longest(*(pieces_of(sorted(numbers), size) for numbers in groups.values()))
    return [chunk for turn in turns for chunk in turn if chunk is not None]


def pieces_of(numbers: list[int], size: int) -> list[list[int]]:
    """Divide a list into the fewest pieces of at most ``size``, all about equal."""
    count = -(-len(numbers) // size)
    edges = [len(numbers) * place // count for place in range(count + 1)]
    return [numbers[low:high] for low, high in itertools.pairwise(edges)]


def fly_chunk(campaign: Campaign, numbers: Sequence[int], progress: Progress = lambda samples: None) -> Rows:
    """Fly some flights of a campaign with all its variants, in this process.

    Returns
    -------
    list of dict
        One row for each flight, variant and fault; see `quadftc_campaign.table`.

    Raises
    ------
    ScenarioError
        If the drawn values make no scenario.
    ValueError
        If a part cannot be flown in a batch.
    """
    fly = _fly_loop if campaign.source.is_loop else _fly_open
    return [row for variant in campaign.variants for row in fly(campaign, numbers, variant, progress)]


def _fly_open(campaign: Campaign, numbers: Sequence[int], variant: Variant, progress: Progress) -> Rows:
    from quadftc_campaign.open_loop import fly_open

    return fly_open(campaign, numbers, variant, progress)


def _fly_loop(campaign: Campaign, numbers: Sequence[int], variant: Variant, progress: Progress) -> Rows:
    from quadftc_campaign.batch.engine import engine_of_process, lanes_for
    from quadftc_campaign.batch.tally import fault_records, flight_record

    engine = engine_of_process(campaign.precision == "float32", lanes_for(len(numbers)))
    scenarios = [flight_scenario(campaign, number, variant) for number in numbers]
    outcomes = engine.fly(list(map(parts_of, scenarios)), [one.fault_events for one in scenarios], progress)
    rows: Rows = []
    for number, scenario, outcome in zip(numbers, scenarios, outcomes, strict=True):
        whole = first_columns(campaign, number, variant, scenario) | flight_record(outcome)
        rows += fault_rows(whole, fault_records(outcome, scenario.fault_events))
    return rows
