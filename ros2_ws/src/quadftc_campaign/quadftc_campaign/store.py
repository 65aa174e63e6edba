"""The directory of a campaign: what it is, its chunks as they are done, and its results.

DIR/campaign.json      what is flown; chunks of anything else are never mixed in
DIR/chunks/00000.parquet ...
DIR/flights.parquet    all chunks, when all are there
DIR/summary.json
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any, cast

import polars as pl

from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.table import ORDER

MANIFEST, CHUNKS, FLIGHTS, SUMMARY = "campaign.json", "chunks", "flights.parquet", "summary.json"
FORMAT = 2


class Store:
    """The directory of a campaign that is divided into some number of chunks."""

    def __init__(self, directory: Path, campaign: Campaign, chunks: int) -> None:
        self.directory = directory
        self._chunks = chunks
        self._manifest = manifest(campaign, chunks)

    def open(self, resume: bool) -> None:
        """Make the directory, or go on with the one that is there.

        Raises
        ------
        CampaignError
            If there is a campaign already and it is not to be resumed, or is another one, or the directory
            cannot be written.
        """
        path = self.directory / MANIFEST
        try:
            if path.exists():
                self._go_on(path, resume)
            elif self.directory.exists() and any(self.directory.iterdir()):
                raise CampaignError(
                    f"{self.directory}: is not empty, and holds no campaign; choose another --out"
                )
            (self.directory / CHUNKS).mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(self._manifest, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise CampaignError(f"{self.directory}: {error.strerror}") from None

    def _go_on(self, path: Path, resume: bool) -> None:
        if not resume:
            raise CampaignError(
                f"{self.directory}: holds a campaign; --resume goes on with it, or choose another --out"
            )
        try:
            there = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            raise CampaignError(f"{path}: is no JSON; choose another --out") from None
        if there != self._manifest:
            found = cast("dict[str, Any]", there if isinstance(there, dict) else {})
            keys = [key for key, value in self._manifest.items() if found.get(key) != value]
            raise CampaignError(
                f"{path}: another campaign ({', '.join(keys) or 'other keys'} differ); choose another --out"
            )

    @property
    def missing(self) -> list[int]:
        """Chunks that are not there yet."""
        return [place for place in range(self._chunks) if not self._path(place).is_file()]

    def add(self, place: int, frame: pl.DataFrame) -> None:
        """Write a chunk; a `CampaignError` if it cannot be written, as when the disk is full."""
        self._write(frame, self._path(place))

    def finish(self) -> pl.DataFrame:
        """Join all chunks in the order of the flights; return the table that is written.

        Raises
        ------
        CampaignError
            If it cannot be written, or a chunk cannot be read.
        """
        try:
            frames = [pl.read_parquet(self._path(place)) for place in range(self._chunks)]
            frame = pl.concat(frames, how="diagonal_relaxed").sort(ORDER, nulls_last=True)
        except Exception as error:
            raise CampaignError(f"{self.directory / CHUNKS}: {error}") from None
        self._write(frame, self.directory / FLIGHTS)
        return frame

    def summarise(self, summary: dict[str, Any]) -> None:
        """Write ``summary.json``."""
        path = self.directory / SUMMARY
        try:
            path.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise CampaignError(f"{path}: {error.strerror}") from None

    def _write(self, frame: pl.DataFrame, path: Path) -> None:
        """Write a table as Parquet, all of it or nothing."""
        part = path.with_name(f".{path.name}.part")
        try:
            with part.open("wb") as file:
                frame.write_parquet(file, compression="zstd", statistics=True)
                file.flush()
                os.fsync(file.fileno())
            part.replace(path)
        except OSError as error:
            raise CampaignError(
                f"{path}: {error.strerror or error}; when it can be written, --resume goes on"
            ) from None
        finally:
            part.unlink(missing_ok=True)

    def _path(self, place: int) -> Path:
        return self.directory / CHUNKS / f"{place:05d}.parquet"


def manifest(campaign: Campaign, chunks: int) -> dict[str, Any]:
    """What a campaign is made of, ready for JSON."""
    base = json.dumps(campaign.base.data, sort_keys=True, default=str)
    source = campaign.source
    return {
        "format": FORMAT,
        "name": campaign.name,
        "flights": campaign.flights,
        "seed": campaign.seed,
        "variants": [variant.name for variant in campaign.variants],
        "vary": {path: repr(each) for path, each in campaign.vary.items()},
        "precision": "float32" if campaign.float32 else "float64",
        "scenario": hashlib.sha256(base.encode()).hexdigest(),
        "chunks": chunks,
    } | (
        {}
        if source.is_loop
        else {
            "source": [source.kind, repr(source.delay), *(bag.name for bag in source.recordings)],
            "parameters": [[list(pair) for pair in variant.parameters] for variant in campaign.variants],
        }
    )
