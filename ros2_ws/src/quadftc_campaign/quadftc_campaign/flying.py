"""Flying a campaign: chunks to the workers, tables to the disk, results when all are there."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from quadftc_campaign.campaign_file import Campaign, Variant
from quadftc_campaign.cluster import cluster_client, devices, run_tasks
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.flights import flight, flight_document
from quadftc_campaign.quantiles import summary_of
from quadftc_campaign.store import Store
from quadftc_campaign.table import table_of
from quadftc_campaign.work import FLIGHTS_A_CHUNK, chunks_of, fly_chunk
from quadftc_flight.scenario import Scenario
from quadftc_flight.scenario.build import build_scenario


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
    """A campaign in a directory.

    Parameters
    ----------
    campaign : Campaign
    directory : Path
    size : int
        Flights of a chunk, which has one variant.
    """

    def __init__(self, campaign: Campaign, directory: Path, size: int = FLIGHTS_A_CHUNK) -> None:
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
        samples = sum(self._samples(place) for place in missing)
        return Extent(len(self._chunks), len(missing), samples)

    def fly(
        self,
        address: str | None,
        workers: int,
        progress: Callable[[int], None],
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
            Called with the number of samples flown since the last call.
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
        each = {
            variant: dataclasses.replace(self.campaign, variants=(variant,))
            for variant in self.campaign.variants
        }
        chunks = [self._chunks[place] for place in missing]
        tasks = [(each[chunk.variant], chunk.numbers) for chunk in chunks]
        with cluster_client(address, min(workers, len(missing))) as client:
            told(devices(client))
            for index, rows in run_tasks(client, fly_chunk, tasks, progress):
                self._store.add(missing[index], table_of(rows))

    def finish(self) -> tuple[pl.DataFrame, dict[str, Any]]:
        """Join the chunks, and summarise; both are written.

        Raises
        ------
        CampaignError
            If something cannot be read or written.
        """
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


def flight_scenario(campaign: Campaign, number: int, variant: Variant) -> Scenario:
    """The scenario of one flight, as any other.

    Raises
    ------
    CampaignError
        If the campaign has no such flight.
    ScenarioError
        If the values drawn make no scenario.
    """
    if not 0 <= number < campaign.flights:
        raise CampaignError(
            f"{campaign.document.source}: no flight {number}; there are 0 to {campaign.flights - 1}"
        )
    return build_scenario(flight_document(campaign, number, variant))
