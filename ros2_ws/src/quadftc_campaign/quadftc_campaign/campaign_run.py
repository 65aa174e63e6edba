"""A campaign in a directory: chunks to the workers, tables to the disk, results when all are there.

DIR/campaign.json      what is flown; chunks of anything else are never mixed in
DIR/chunks/00000.parquet ...
DIR/flights.parquet    all chunks, when all are there
DIR/summary.json
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import itertools
import json
import math
import os
import time
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, cast

import polars as pl

from quadftc_campaign.batch.engine import JAX, Progress, compile_laws, fly_all, without_words
from quadftc_campaign.batch.records import fault_records, flight_record
from quadftc_campaign.campaign_checks import campaign_results
from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.errors import CampaignError
from quadftc_campaign.flights import batch_flight, first_columns, flight_scenario
from quadftc_campaign.open_loop import fly_open, loops_of
from quadftc_campaign.table import ORDER, Rows, summary_of, table_of, with_ratios
from quadftc_campaign.workers import devices, run_tasks, started_workers
from quadftc_flight.diagnosis_metrics.columns import Record
from quadftc_flight.scenario import Scenario
from quadftc_flight.summary import Summary
from quadftc_sim.assembly import sample_count

MANIFEST, CHUNKS, FLIGHTS, SUMMARY = "campaign.json", "chunks", "flights.parquet", "summary.json"
FORMAT = 3
ANOTHER = "choose another --out"
FLIGHTS_A_CHUNK = 32
CHUNKS_AT_LEAST = 16  # of flights in a loop, where there are so many: so that all cores have some
PATIENCE = 20.0  # s; a worker hands over what it has flown after that, the most that a kill loses
TOGETHER_A_CHUNK = 2048  # in JAX, which flies them together


class Extent(NamedTuple):
    """How much there is to fly."""

    chunks: int
    missing: int
    samples: int  # of the chunks that are missing
    damaged: tuple[str, ...]  # one line each: a chunk that could not be used, and is missing now


@contextlib.contextmanager
def report_refusal(path: Path, advice: str = "") -> Generator[None, None, None]:
    """Turn what the system refuses into a `CampaignError`."""
    try:
        yield
    except OSError as error:
        raise CampaignError(f"{path}: {error.strerror or error}{advice}") from None


# directories that this process keeps to itself, by inode and device; the lock goes with the descriptor
_LOCKED: dict[tuple[int, ...], int] = {}


class CampaignRun:
    """A campaign in a directory; ``size`` is the number of flights of a chunk, which has one variant."""

    def __init__(self, campaign: Campaign, directory: Path, size: int | None = None) -> None:
        self.campaign, self._directory = campaign, directory
        pieces = chunks_of(campaign, size)
        self._chunks = [(numbers, variant) for variant in campaign.variants for numbers in pieces]
        self._paths = [directory / CHUNKS / f"{place:05d}.parquet" for place in range(len(self._chunks))]

    def _missing(self) -> dict[int, list[int]]:
        """Return the flights that are not on the disk, by the place of their chunk."""
        missing: dict[int, list[int]] = {}
        for place, ((numbers, _), path) in enumerate(zip(self._chunks, self._paths, strict=True)):
            there = {*pl.read_parquet(path, columns=["flight"])["flight"]} if path.is_file() else set[int]()
            if left := [number for number in numbers if number not in there]:
                missing[place] = left
        return missing

    def open(self, resume: bool) -> Extent:
        """Make the directory or go on with it; say how much is to be flown.

        A `CampaignError` refuses a directory with another campaign, or with this one if it is not to be
        resumed. The first flight of each chunk is built: better an error now than when hours are over. So are
        its laws, in C, for all workers of this machine. A chunk that cannot be used is removed.
        """
        first = [flight_scenario(self.campaign, numbers[0], variant) for numbers, variant in self._chunks]
        directory, path = self._directory, self._directory / MANIFEST
        manifest = _describe(self.campaign, len(self._chunks))
        with report_refusal(directory):
            if path.exists():
                _compare(path, manifest, resume)
            elif directory.exists() and any(directory.iterdir()):
                raise CampaignError(f"{directory}: is not empty, and holds no campaign; {ANOTHER}")
            (directory / CHUNKS).mkdir(parents=True, exist_ok=True)
            self._lock()
            path.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
            damaged = tuple(self._remove_damaged())
        missing = self._missing()
        scenarios = [first[place] for place in missing]
        if self.campaign.engine == "c":
            is_loop = self.campaign.source.kind == "loop"
            loops = ([batch_flight(each).loop] if is_loop else loops_of(each) for each in scenarios)
            compile_laws(itertools.chain.from_iterable(loops))
        counts = (sample_count(scenario.duration, scenario.rate) for scenario in scenarios)
        samples = sum(len(left) * count for left, count in zip(missing.values(), counts, strict=True))
        return Extent(len(self._chunks), len(missing), samples, damaged)

    def _lock(self) -> None:
        """Keep the directory to this process until it ends; a `CampaignError` says that another has it."""
        held = os.open(self._directory, os.O_RDONLY)
        key = os.fstat(held)[1:3]  # inode, device
        if key in _LOCKED:
            os.close(held)
            return
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(held)
            words = f"another process flies this campaign now; wait for it, or {ANOTHER}"
            raise CampaignError(f"{self._directory}: {words}") from None
        _LOCKED[key] = held

    def _remove_damaged(self) -> Iterator[str]:
        """Remove chunks that are no tables or hold other flights than they should; say which, and why."""
        for path, (numbers, variant) in zip(self._paths, self._chunks, strict=True):
            if not path.exists():
                continue
            try:
                rows = pl.read_parquet(path)
                fits = {*rows["flight"]} <= {*numbers} and {*rows["variant"]} == {variant.name}
                why = "" if fits else "holds other flights"
            except Exception as error:  # whatever the library makes of bytes that are no table
                why = str(error).partition("\n")[0] or type(error).__name__
            if why:
                path.unlink()
                yield f"{path}: {why}; its {len(numbers)} flights are flown again"

    def fly(self, count: int, progress: Progress, told: Callable[[str], None] = lambda devices: None) -> None:
        """Fly what is missing in so many processes; ``told`` gets their devices.

        A chunk that takes longer than `PATIENCE` is flown piece by piece; its file grows.
        """
        missing = self._missing()
        if not missing:
            return
        alone = {
            each.name: self.campaign.model_copy(update={"variants": (each,)})
            for each in self.campaign.variants
        }
        function = functools.partial(fly_chunk, patience=PATIENCE)
        with started_workers(min(count, len(missing))) as workers:
            told(devices(workers, self.campaign.engine))
            while missing:
                places = [*missing]
                tasks = [(alone[self._chunks[place][1].name], missing[place]) for place in places]
                for index, rows in run_tasks(workers, function, tasks, progress):
                    path = self._paths[places[index]]
                    before = [pl.read_parquet(path)] if path.is_file() else []
                    _write_table(pl.concat([*before, table_of(rows)], how="diagonal_relaxed"), path)
                missing = self._missing()

    def finish(self) -> tuple[pl.DataFrame, Summary]:
        """Join the chunks, and summarise; both are written, or it is a `CampaignError`."""
        try:
            frames = list(map(pl.read_parquet, self._paths))
            frame = with_ratios(pl.concat(frames, how="diagonal_relaxed").sort(ORDER, nulls_last=True))
        except Exception as error:
            raise CampaignError(f"{self._directory / CHUNKS}: {error}") from None
        _write_table(frame, self._directory / FLIGHTS)
        summary, path = summary_of(self.campaign, frame), self._directory / SUMMARY
        summary["checks"] = campaign_results(self.campaign.checks, summary["variants"])
        summary["passed"] = all(check["passed"] for check in summary["checks"])
        with report_refusal(path):
            path.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        return frame, summary


def chunks_of(campaign: Campaign, size: int | None = None) -> list[list[int]]:
    """Divide the flights into chunks of about equal size, each with flights of one structure.

    What changes the structure (`quadftc_model.numbers`) from one combination of the grids to another, such as
    the rate, keeps them apart. Others, such as inertias, are mixed. Structures take turns, so that workers
    that compile have one each and not the same one at the same time. Flights on one recording stay together:
    it is read once.
    """
    is_loop, bags = campaign.source.kind == "loop", len(campaign.recordings)
    cells = bags or campaign.cells
    together = TOGETHER_A_CHUNK if campaign.engine == JAX else FLIGHTS_A_CHUNK
    if not bags and campaign.engine != JAX:
        together = min(together, -(-campaign.flights // CHUNKS_AT_LEAST))
    size = size or together
    groups: dict[Hashable, list[int]] = {}
    for cell in range(min(cells, campaign.flights)):
        structure = cell if bags else None
        if is_loop and cells > 1:
            structure = batch_flight(flight_scenario(campaign, cell, campaign.variants[0])).structure
        groups.setdefault(structure, []).extend(range(cell, campaign.flights, cells))
    turns = itertools.zip_longest(*(pieces_of(sorted(numbers), size) for numbers in groups.values()))
    return [chunk for turn in turns for chunk in turn if chunk is not None]


def pieces_of(numbers: list[int], size: int) -> list[list[int]]:
    """Divide a list into the fewest pieces of at most ``size``, all about equal."""
    count = -(-len(numbers) // size)
    edges = [len(numbers) * place // count for place in range(count + 1)]
    return [numbers[low:high] for low, high in itertools.pairwise(edges)]


def fly_chunk(
    campaign: Campaign,
    numbers: Sequence[int],
    progress: Progress = lambda samples: None,
    patience: float = math.inf,
) -> Rows:
    """Fly some flights of a campaign with all its variants here; return rows of `quadftc_campaign.table`.

    After ``patience`` [s] it returns the rows of those flown, at least one; JAX flies all at the same time.
    A `ScenarioError`: drawn values make no scenario. A `ValueError`: JAX cannot trace a law.
    """
    rows: Rows = []
    end = time.monotonic() + patience
    fly = _fly_loop if campaign.source.kind == "loop" else fly_open
    for variant in campaign.variants:
        scenarios = [flight_scenario(campaign, number, variant) for number in numbers]
        flown = zip(numbers, scenarios, fly(campaign, numbers, scenarios, progress), strict=True)
        for number, scenario, (whole, records) in flown:
            flight = first_columns(campaign, number, variant, scenario) | whole
            faults = ({f"fault.{name}": value for name, value in each.items()} for each in records)
            of_faults = [{**flight, "fault": index, **fault} for index, fault in enumerate(faults)]
            rows += of_faults or [{**flight, "fault": None}]
            if time.monotonic() > end:
                return rows
    return rows


def _fly_loop(
    campaign: Campaign, numbers: Sequence[int], scenarios: Sequence[Scenario], progress: Progress
) -> Iterator[tuple[Record, list[Record]]]:
    """Yield the metrics of each flight and of its faults, from the batch engine."""
    flights = list(map(batch_flight, scenarios))
    if campaign.engine == JAX:
        from quadftc_campaign.batch.jax_engine import engine_of_process, lanes_for

        jax_engine = engine_of_process(campaign.precision == "float32", lanes_for(len(numbers)))
        outcomes = jax_engine.fly(flights, progress)
    else:
        outcomes = fly_all(flights, campaign.engine, progress, without_words)
    for outcome, scenario in zip(outcomes, scenarios, strict=True):
        events = (*scenario.fault_events, *scenario.rotor_events)
        yield flight_record(outcome), fault_records(outcome, events)


def _describe(campaign: Campaign, chunks: int) -> dict[str, object]:
    """Describe what a campaign is made of, ready for JSON."""
    base, source = json.dumps(campaign.base.data, sort_keys=True, default=str), campaign.source
    manifest: dict[str, object] = {
        "format": FORMAT,
        "name": campaign.name,
        "flights": campaign.flights,
        "seed": campaign.seed,
        "variants": [variant.name for variant in campaign.variants],
        "vary": {path: repr(each) for path, each in campaign.vary.items()},
        "engine": campaign.engine,
        "precision": campaign.flown_precision,
        "scenario": hashlib.sha256(base.encode()).hexdigest(),
        "chunks": chunks,
    }
    if source.kind != "loop":
        bags = [bag.name for bag in campaign.recordings]
        manifest |= {"source": [source.kind, repr(source.delay), *bags]}
    return manifest


def _compare(path: Path, manifest: dict[str, object], resume: bool) -> None:
    """Refuse a directory with another campaign, or with this one if it is not to be resumed."""
    if not resume:
        raise CampaignError(f"{path.parent}: holds a campaign; --resume goes on with it, or {ANOTHER}")
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        raise CampaignError(f"{path}: is no JSON; {ANOTHER}") from None
    if there != manifest:
        found = cast("dict[str, object]", there if isinstance(there, dict) else {})
        names = ", ".join(key for key, value in manifest.items() if found.get(key) != value)
        raise CampaignError(f"{path}: another campaign ({names or 'other keys'} differ); {ANOTHER}")


def _write_table(frame: pl.DataFrame, path: Path) -> None:
    """Write a table as Parquet, all of it or nothing."""
    part = path.with_name(f".{path.name}.part")
    with report_refusal(path, "; when it can be written, --resume goes on"):
        try:
            with part.open("wb") as file:
                frame.write_parquet(file, compression="zstd", statistics=True)
                file.flush()
                os.fsync(file.fileno())
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
