"""One chunk of a campaign: flights built, flown and judged, in the process that is told to."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

from quadftc_campaign.batch.parts import structure_of
from quadftc_campaign.campaign_file import Campaign, Variant
from quadftc_campaign.distributions import plain
from quadftc_campaign.flights import Flight, drawn, flight
from quadftc_campaign.table import Row, Rows

FLIGHTS_A_CHUNK = 256  # what a kill loses at most, of each worker; as many as are flown together

Progress = Callable[[int], None]


def chunks_of(campaign: Campaign, size: int = FLIGHTS_A_CHUNK) -> list[list[int]]:
    """Divide the flights into chunks of about equal size, each with flights of one structure.

    What changes the structure (`quadftc_campaign.batch.parts`) from one combination of the grids to another,
    such as the rate, keeps them apart. Others, such as inertias, are mixed: nothing is compiled for each.
    Structures take turns, so that workers compile one each and not the same one at the same time.

    Raises
    ------
    ScenarioError
        If the values of a combination make no scenario.
    """
    cells = campaign.cells
    groups: dict[Any, list[int]] = {}
    for cell in range(min(cells, campaign.flights)):
        groups.setdefault(_structure(campaign, cell), []).extend(range(cell, campaign.flights, cells))
    turns = itertools.zip_longest(*(_pieces(sorted(numbers), size) for numbers in groups.values()))
    return [chunk for turn in turns for chunk in turn if chunk is not None]


def _pieces(numbers: list[int], size: int) -> list[list[int]]:
    count = -(-len(numbers) // size)
    edges = [len(numbers) * place // count for place in range(count + 1)]
    return [numbers[low:high] for low, high in itertools.pairwise(edges)]


def _structure(campaign: Campaign, number: int) -> Any:
    """Structure of a flight; None where all have the same."""
    if campaign.cells == 1:
        return None
    return structure_of(flight(campaign, number, campaign.variants[0]).parts.loop)


def fly_chunk(campaign: Campaign, numbers: Sequence[int], progress: Progress = lambda samples: None) -> Rows:
    """Fly some flights of a campaign with all its variants.

    Parameters
    ----------
    campaign : Campaign
    numbers : sequence of int
        Of the flights.
    progress : callable
        Called with the number of samples flown since the last call.

    Returns
    -------
    list of dict
        One row for each flight, variant and fault; see `quadftc_campaign.table`.

    Raises
    ------
    ScenarioError
        If the values drawn make no scenario.
    ValueError
        If a part cannot be flown in a batch.
    """
    from quadftc_campaign.batch.engine import lanes_for

    rows: Rows = []
    engine = _engine(campaign.float32, lanes_for(len(numbers)))
    for variant in campaign.variants:
        flights = [flight(campaign, number, variant) for number in numbers]
        outcomes = engine.fly([each.parts for each in flights], [each.events for each in flights], progress)
        for number, one, outcome in zip(numbers, flights, outcomes, strict=True):
            rows += _rows(campaign, number, variant, one, outcome)
    return rows


def _rows(campaign: Campaign, number: int, variant: Variant, one: Flight, outcome: Any) -> Rows:
    from quadftc_campaign.batch.tally import fault_records, flight_record

    scheme = one.scenario.scheme(variant.scheme)
    values = {path: plain(value) for path, value in drawn(campaign, number).items()}
    common: Row = {
        "flight": number,
        "variant": variant.name,
        "observer": scheme.observer.kind,
        "disturbance_observer": scheme.disturbance_observer.kind,
        "controller": scheme.controller.kind,
        **values,
        **flight_record(outcome),
    }
    records = fault_records(outcome, one.events)
    if not records:
        return [{**common, "fault": None}]
    return [
        {**common, "fault": index, **{f"fault.{name}": value for name, value in record.items()}}
        for index, record in enumerate(records)
    ]


@functools.cache
def _engine(float32: bool, lanes: int) -> Any:
    """The engine of this process; it keeps what it has compiled."""
    from quadftc_campaign.batch.engine import Engine
    from quadftc_campaign.batch.jax_settings import keep_compiled

    keep_compiled()
    return Engine(float32, lanes)
