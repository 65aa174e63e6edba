# pyright: basic
"""`scripts/soak endurance`: does memory, the number of open files or the rate drift in long flights?

`quadftc_tools.soak.endurance_flight` flies the graph in another process. Every `LOOK` seconds this one notes
resident memory, open files and threads of each of its processes. Growth is the slope of a straight line
through the values after the warm-up.
"""

from __future__ import annotations

import dataclasses
import json
import selectors
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from rich.table import Table
from scipy.stats import linregress

from quadftc_bags.bag import read_bag
from quadftc_cli.screen import plain_table
from quadftc_flight.flight import flight_from_bag
from quadftc_flight.graph.plan import GraphError
from quadftc_flight.summary import summary as summary_of
from quadftc_tools.soak.endurance_flight import scenario_of

LOOK = 2.0  # s
WARM_UP = 0.2  # of the time watched
HOUR, MEGABYTE = 3600.0, 1e6
MEMORY_GROWTH = 1.0  # MB/h
FILES_GROWTH = 1.0  # 1/h
RATE_DRIFT = 1e-3  # 1; over the whole time, in real time
MISSING = 1e-4  # 1; share of the samples, in real time; in lock-step none
ATTITUDE = 5.0  # deg
RATE_WINDOW = 10.0  # s


@dataclasses.dataclass(frozen=True)
class Flown:
    """One whole flight."""

    samples: int
    wall: float  # s that it took
    largest: float  # deg; attitude error, the largest of the axes
    missing: int  # samples and messages that are not in the bag
    rate: float  # Hz; of torque/command by its log times
    rate_drift: float  # change from begin to end, relative


@dataclasses.dataclass(frozen=True)
class Growth:
    """Growth of one process, or of those with one name that followed each other."""

    name: str
    looks: int  # after the warm-up
    memory: float  # MB; median
    slope: float  # MB/h
    error: float  # MB/h; standard error of the slope
    files: tuple[int, int]  # fewest and most open
    files_slope: float  # 1/h
    threads: int  # most


def soak(
    mode: str, graph: str, rate: float, length: float, minutes: float, follow: Callable[[str], None]
) -> tuple[list[Flown], list[Growth]]:
    """Fly, watch, and judge; ``follow`` is called with a line for each flight.

    ``rate`` in Hz, ``length`` of a flight in s. GraphError if the graph does not start, or ends early;
    ScenarioError if there is no flight of such a rate or length.
    """
    scenario_of(rate, length, 1)
    with tempfile.TemporaryDirectory(prefix="quadftc_soak_") as folder:
        arguments = [mode, graph, f"{rate}", f"{length}", f"{minutes}", folder]
        command = [sys.executable, "-m", "quadftc_tools.soak.endurance_flight", *arguments]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            try:
                return _watch(process, Path(folder), rate, length, follow)
            finally:
                process.terminate()


def _watch(
    process: subprocess.Popen[bytes], folder: Path, rate: float, length: float, follow: Callable[[str], None]
) -> tuple[list[Flown], list[Growth]]:
    looks = Looks(process.pid)
    flown: list[Flown] = []
    assert process.stdout is not None
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        flying = False
        while True:
            if not selector.select(LOOK):
                if flying:
                    looks.look()
                continue
            line = process.stdout.readline()
            if not line:
                break
            told = json.loads(line)
            flying = "flown" not in told and (flying or told.get("samples", 0) > 0)
            if "flown" in told:
                bag = folder / str(told["flown"])
                if not told["cut"]:
                    flown.append(_judge(bag, told, scenario_of(rate, length, told["flown"])))
                    last = flown[-1]
                    follow(
                        f"flight {told['flown']}: {last.samples} samples in {last.wall:.1f} s, attitude off"
                        f" by at most {last.largest:.2f} deg, {last.missing} samples missing"
                    )
                shutil.rmtree(bag)
    if process.wait() != 0:
        raise GraphError(f"the flights ended with exit code {process.returncode}")
    return flown, looks.growth()


class Looks:
    """Memory, open files and threads of the processes of a graph, seen again and again."""

    def __init__(self, process_id: int) -> None:
        self._root = psutil.Process(process_id)
        self._begin = time.monotonic()
        self._seen: dict[str, list[tuple[float, float, int, int]]] = defaultdict(list)

    def look(self) -> None:
        """Note how much each process has now."""
        now = time.monotonic() - self._begin
        for process in [self._root, *self._root.children(recursive=True)]:
            with suppress(psutil.Error), process.oneshot():  # it may have just ended
                row = (now, float(process.memory_info().rss), process.num_fds(), process.num_threads())
                self._seen[self._name(process)].append(row)

    def growth(self) -> list[Growth]:
        """By how much each has grown since the warm-up."""
        end = time.monotonic() - self._begin
        found = []
        for name, rows in self._seen.items():
            seen = np.array([row for row in rows if row[0] >= WARM_UP * end])
            if len(seen) < 3:
                continue
            hours, memory, files = seen[:, 0] / HOUR, seen[:, 1] / MEGABYTE, seen[:, 2]
            line = linregress(hours, memory)
            found.append(
                Growth(
                    *(name, len(seen), float(np.median(memory)), float(line.slope), float(line.stderr)),
                    files=(int(files.min()), int(files.max())),
                    files_slope=float(linregress(hours, files).slope),
                    threads=int(seen[:, 3].max()),
                )
            )
        return found

    def _name(self, process: psutil.Process) -> str:
        if process.pid == self._root.pid:
            return "graph"
        return next((Path(word).name for word in process.cmdline()[1:] if not word.startswith("-")), "?")


def _judge(bag: Path, told: dict[str, Any], scenario: Any) -> Flown:
    recorded = read_bag(bag)
    flight = flight_from_bag(recorded)
    result = summary_of(flight, scenario, scenario.scheme(None), None)["metrics"]
    wanted = round(scenario.duration * scenario.rate) - scenario.sensor.delay
    times = recorded.series("torque/command").log_time_ns / 1e9
    edges = np.arange(times[0], times[-1], RATE_WINDOW)
    rates = np.histogram(times, edges)[0] / RATE_WINDOW if len(edges) > 2 else np.zeros(0)
    drift = (
        linregress(np.linspace(0.0, 1.0, len(rates)), rates).slope / rates.mean() if len(rates) > 2 else 0.0
    )
    return Flown(
        len(flight),
        told["wall_s"],
        max(result["tracking_max_deg"].values()),
        wanted - len(flight) + told["dropped"],
        float(rates.mean()) if len(rates) else 0.0,
        float(drift),
    )


def table(grown: list[Growth]) -> Table:
    """One row for each process."""
    numbers = ("looks", "memory [MB]", "growth [MB/h]", "open files", "growth [1/h]", "threads")
    shown = plain_table(("process",), numbers, "After the warm-up")
    for each in grown:
        shown.add_row(
            *(each.name, str(each.looks), f"{each.memory:.1f}", f"{each.slope:+.2f} ± {each.error:.2f}"),
            *(f"{each.files[0]}..{each.files[1]}", f"{each.files_slope:+.2f}", str(each.threads)),
        )
    return shown


def summary(mode: str, graph: str, rate: float, flown: list[Flown], grown: list[Growth]) -> dict[str, Any]:
    """What was found, ready for JSON."""
    worst_drift = max((abs(each.rate_drift) for each in flown), default=None)
    return {
        "fault": "none but time",
        "mode": mode,
        "graph": graph,
        "rate_hz": rate,
        "flights": len(flown),
        "samples": sum(each.samples for each in flown),
        "missing": sum(each.missing for each in flown),
        "wall_s": sum(each.wall for each in flown),
        "largest_error_deg": max((each.largest for each in flown), default=None),
        "rate_drift": worst_drift,
        "memory_growth_mb_h": max((each.slope for each in grown), default=None),
        "files_growth_h": max((each.files_slope for each in grown), default=None),
        "growth": [dataclasses.asdict(each) for each in grown],
        "passed": bool(flown and grown)
        and all(_passed(each, mode, rate) for each in flown)
        and all(each.slope < MEMORY_GROWTH and each.files_slope < FILES_GROWTH for each in grown),
    }


def _passed(flown: Flown, mode: str, rate: float) -> bool:
    if flown.largest > ATTITUDE:
        return False
    if mode == "lockstep":
        return flown.missing == 0
    kept = abs(flown.rate / rate - 1.0) < RATE_DRIFT and abs(flown.rate_drift) < RATE_DRIFT
    return kept and flown.missing <= MISSING * flown.samples
