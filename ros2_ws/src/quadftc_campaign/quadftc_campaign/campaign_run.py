"""A campaign in a directory: chunks to the workers, tables to the disk, results when all are there.

DIR/campaign.json      what is flown; chunks of anything else are never mixed in
DIR/chunks/00000.parquet ...
DIR/flights.parquet    all chunks, when all are there
DIR/summary.json
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NamedTuple, cast

import polars as pl

from quadftc_campaign.batch.parts import Progress
from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.cluster import cluster_client, devices, run_tasks
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.flights import flight_scenario, parts_of
from quadftc_campaign.flying import chunks_of, fly_chunk
from quadftc_campaign.table import ORDER, summary_of, table_of

MANIFEST, CHUNKS, FLIGHTS, SUMMARY = "campaign.json", "chunks", "flights.parquet", "summary.json"
FORMAT = 2


class Extent(NamedTuple):
    """How much there is to fly."""

    chunks: int
    missing: int
    samples: int  # of the chunks that are missing, all variants


class CampaignRun:
    """A campaign in a directory; ``size`` is the number of flights of a chunk, which has one variant."""

    def __init__(self, campaign: Campaign, directory: Path, size: int | None = None) -> None:
        self.campaign, self._directory = campaign, directory
        pieces = chunks_of(campaign, size)
        self._chunks = [(numbers, variant) for variant in campaign.variants for numbers in pieces]
        self._paths = [directory / CHUNKS / f"{place:05d}.parquet" for place in range(len(self._chunks))]

    @property
    def _missing(self) -> list[int]:
        return [place for place, path in enumerate(self._paths) if not path.is_file()]

    def open(self, resume: bool) -> Extent:
        """Make the directory or go on with it; say how much is to be flown.

        Raises
        ------
        CampaignError
            If there is a campaign already and it is not to be resumed, or is another one, or the directory
            cannot be used.
        ScenarioError
            If the first flight of a chunk cannot be built: better now than when hours are over.
        """
        first = [flight_scenario(self.campaign, numbers[0], variant) for numbers, variant in self._chunks]
        directory, path = self._directory, self._directory / MANIFEST
        manifest = _describe(self.campaign, len(self._chunks))
        with _report_refusal(directory):
            if path.exists():
                _compare(path, manifest, resume)
            elif directory.exists() and any(directory.iterdir()):
                raise CampaignError(f"{directory}: is not empty, and holds no campaign; choose another --out")
            (directory / CHUNKS).mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
        missing = self._missing
        samples = sum(len(self._chunks[place][0]) * parts_of(first[place]).loop.count for place in missing)
        return Extent(len(self._chunks), len(missing), samples)

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
            Gets the number of samples flown since its last call.
        told : callable
            Gets what it is computed on, in words.

        Raises
        ------
        CampaignError, ScenarioError, ValueError
            If a chunk cannot be flown or written.
        """
        missing = self._missing
        if not missing:
            return
        chunks = [self._chunks[place] for place in missing]
        tasks = [(self.campaign.model_copy(update={"variants": (one,)}), numbers) for numbers, one in chunks]
        with cluster_client(address, min(workers, len(missing))) as client:
            told(devices(client))
            for index, rows in run_tasks(client, fly_chunk, tasks, progress):
                _write_table(table_of(rows), self._paths[missing[index]])

    def finish(self) -> tuple[pl.DataFrame, dict[str, Any]]:
        """Join the chunks, and summarise; both are written, or it is a `CampaignError`."""
        try:
            frames = list(map(pl.read_parquet, self._paths))
            frame = pl.concat(frames, how="diagonal_relaxed").sort(ORDER, nulls_last=True)
        except Exception as error:
            raise CampaignError(f"{self._directory / CHUNKS}: {error}") from None
        _write_table(frame, self._directory / FLIGHTS)
        summary, path = summary_of(self.campaign, frame), self._directory / SUMMARY
        with _report_refusal(path):
            path.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        return frame, summary


def _describe(campaign: Campaign, chunks: int) -> dict[str, Any]:
    """Describe what a campaign is made of, ready for JSON."""
    base = json.dumps(campaign.base.data, sort_keys=True, default=str)
    source = campaign.source
    manifest: dict[str, Any] = {
        "format": FORMAT,
        "name": campaign.name,
        "flights": campaign.flights,
        "seed": campaign.seed,
        "variants": [variant.name for variant in campaign.variants],
        "vary": {path: repr(each) for path, each in campaign.vary.items()},
        "precision": campaign.precision,
        "scenario": hashlib.sha256(base.encode()).hexdigest(),
        "chunks": chunks,
    }
    if not source.is_loop:
        bags = [bag.name for bag in campaign.recordings]
        parameters = [[list(pair) for pair in variant.parameters] for variant in campaign.variants]
        manifest |= {"source": [source.kind, repr(source.delay), *bags], "parameters": parameters}
    return manifest


def _compare(path: Path, manifest: dict[str, Any], resume: bool) -> None:
    """Refuse a directory with another campaign, or with this one if it is not to be resumed."""
    if not resume:
        raise CampaignError(
            f"{path.parent}: holds a campaign; --resume goes on with it, or choose another --out"
        )
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        raise CampaignError(f"{path}: is no JSON; choose another --out") from None
    if there != manifest:
        found = cast("dict[str, Any]", there if isinstance(there, dict) else {})
        keys = [key for key, value in manifest.items() if found.get(key) != value]
        raise CampaignError(
            f"{path}: another campaign ({', '.join(keys) or 'other keys'} differ); choose another --out"
        )


def _write_table(frame: pl.DataFrame, path: Path) -> None:
    """Write a table as Parquet, all of it or nothing."""
    part = path.with_name(f".{path.name}.part")
    with _report_refusal(path, "; when it can be written, --resume goes on"):
        try:
            with part.open("wb") as file:
                frame.write_parquet(file, compression="zstd", statistics=True)
                file.flush()
                os.fsync(file.fileno())
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


@contextlib.contextmanager
def _report_refusal(path: Path, advice: str = "") -> Generator[None, None, None]:
    """Turn what the system refuses into a `CampaignError`."""
    try:
        yield
    except OSError as error:
        raise CampaignError(f"{path}: {error.strerror or error}{advice}") from None
