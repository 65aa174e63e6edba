"""Flying a campaign: chunks to the workers, tables to the disk, results when all are there."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from quadftc_campaign.batch.parts import structure_of
from quadftc_campaign.campaign_file import Campaign, Variant
from quadftc_campaign.cluster import cluster_client, devices, run_tasks
from quadftc_campaign.distributions import plain
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.flights import Flight, drawn, flight
from quadftc_campaign.store import Store
from quadftc_campaign.table import Row, Rows, summary_of, table_of

FLIGHTS_A_CHUNK = 256  # what a kill loses at most, of each worker; as many as are flown together
OPEN_FLIGHTS_A_CHUNK = 4  # without the batch engine a flight takes seconds

Progress = Callable[[int], None]  # called with the number of samples flown since the last call


class Extent(NamedTuple):
    """How much there is to fly."""

    chunks: int
    missing: int
    samples: int  # of the chunks that are missing, all variants


class Chunk(NamedTuple):
    """What a worker flies at a time."""

    numbers: list[int]  # of flights
    variant: Variant


class CampaignRun:
    """A campaign in a directory; ``size`` is the number of flights of a chunk, which has one variant."""

    def __init__(self, campaign: Campaign, directory: Path, size: int | None = None) -> None:
        self.campaign = campaign
        pieces = chunks_of(campaign, size)
        self._chunks = [Chunk(numbers, variant) for variant in campaign.variants for numbers in pieces]
        self._store = Store(directory, campaign, len(self._chunks))

    def open(self, resume: bool) -> Extent:
        """Make the directory or go on with it; say how much is to be flown.

        Raises
        ------
        CampaignError
            If the directory cannot be used.
        ScenarioError
            If the first flight of a chunk cannot be built: better now than when hours are over.
        """
        for chunk in self._chunks:
            flight(self.campaign, chunk.numbers[0], chunk.variant)
        self._store.open(resume)
        missing = self._store.missing
        return Extent(len(self._chunks), len(missing), sum(self._samples(place) for place in missing))

    def fly(
        self,
        address: str | None,
        workers: int,
        progress: Progress,
        told: Callable[[str], None] = lambda devices: None,
    ) -> None:
        """Fly the chunks that are missing.

        Parameters
        ----------
        address : str, optional
            Of a Dask scheduler; None: start workers here.
        workers : int
            How many to start here.
        progress : callable
        told : callable
            Called with what it is computed on, in words.

        Raises
        ------
        CampaignError, ClusterError, ScenarioError, ValueError
            If a chunk cannot be flown or written.
        """
        missing = self._store.missing
        if not missing:
            return
        chunks = [self._chunks[place] for place in missing]
        tasks = [(_with_variant(self.campaign, chunk.variant), chunk.numbers) for chunk in chunks]
        with cluster_client(address, min(workers, len(missing))) as client:
            told(devices(client))
            for index, rows in run_tasks(client, fly_chunk, tasks, progress):
                self._store.add(missing[index], table_of(rows))

    def finish(self) -> tuple[pl.DataFrame, dict[str, Any]]:
        """Join the chunks, and summarise; both are written, or it is a `CampaignError`."""
        frame = self._store.finish()
        summary = summary_of(self.campaign, frame)
        self._store.summarise(summary)
        return frame, summary

    def _samples(self, place: int) -> int:
        numbers, variant = self._chunks[place]
        return len(numbers) * flight(self.campaign, numbers[0], variant).parts.loop.count


def variant_of(campaign: Campaign, name: str | None) -> Variant:
    """Return a variant by name; the first by default.

    Raises
    ------
    CampaignError
        If there is none of that name.
    """
    if name is None:
        return campaign.variants[0]
    for variant in campaign.variants:
        if variant.name == name:
            return variant
    there = ", ".join(variant.name for variant in campaign.variants)
    raise CampaignError(f"{campaign.document.source}: no variant '{name}'; there are: {there}")


def chunks_of(campaign: Campaign, size: int | None = None) -> list[list[int]]:
    """Divide the flights into chunks of about equal size, each with flights of one structure.

    What changes the structure (`quadftc_campaign.batch.parts`) from one combination of the grids to another,
    such as the rate, keeps them apart. Others, such as inertias, are mixed: nothing is compiled for each.
    Structures take turns, so that workers compile one each and not the same one at the same time.

    Raises
    ------
    ScenarioError
        If the values of a combination make no scenario.
    """
    cells, is_loop = campaign.cells, campaign.source.is_loop
    size = size or (FLIGHTS_A_CHUNK if is_loop else OPEN_FLIGHTS_A_CHUNK)
    groups: dict[Any, list[int]] = {}
    for cell in range(min(cells, campaign.flights)):
        structure = None
        if is_loop and cells > 1:
            structure = structure_of(flight(campaign, cell, campaign.variants[0]).parts.loop)
        groups.setdefault(structure, []).extend(range(cell, campaign.flights, cells))
    turns = itertools.zip_longest(*(_pieces(sorted(numbers), size) for numbers in groups.values()))
    return [chunk for turn in turns for chunk in turn if chunk is not None]


def fly_chunk(campaign: Campaign, numbers: Sequence[int], progress: Progress = lambda samples: None) -> Rows:
    """Fly some flights of a campaign with all its variants, in the process that is told to.

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
    from quadftc_campaign.batch.engine import lanes_for

    engine = _engine(campaign.float32, lanes_for(len(numbers)))
    flights = [flight(campaign, number, variant) for number in numbers]
    outcomes = engine.fly([each.parts for each in flights], [each.events for each in flights], progress)
    flown = zip(numbers, flights, outcomes, strict=True)
    return [row for one in flown for row in _rows(campaign, variant, *one)]


def _rows(campaign: Campaign, variant: Variant, number: int, one: Flight, outcome: Any) -> Rows:
    from quadftc_campaign.batch.tally import fault_records, flight_record

    scheme = one.scenario.scheme(variant.scheme)
    common: Row = {
        "flight": number,
        "variant": variant.name,
        "observer": scheme.observer.kind,
        "disturbance_observer": scheme.disturbance_observer.kind,
        "controller": scheme.controller.kind,
        **{path: plain(value) for path, value in drawn(campaign, number).items()},
        **flight_record(outcome),
    }
    records = fault_records(outcome, one.events)
    if not records:
        return [{**common, "fault": None}]
    return [
        {**common, "fault": index, **{f"fault.{name}": value for name, value in record.items()}}
        for index, record in enumerate(records)
    ]


def _pieces(numbers: list[int], size: int) -> list[list[int]]:
    count = -(-len(numbers) // size)
    edges = [len(numbers) * place // count for place in range(count + 1)]
    return [numbers[low:high] for low, high in itertools.pairwise(edges)]


def _with_variant(campaign: Campaign, variant: Variant) -> Campaign:
    return dataclasses.replace(campaign, variants=(variant,))


@functools.cache
def _engine(float32: bool, lanes: int) -> Any:
    """The engine of this process; it keeps what it has compiled."""
    from quadftc_campaign.batch.engine import Engine
    from quadftc_campaign.batch.jax_settings import keep_compiled

    keep_compiled()
    return Engine(float32, lanes)
