# pyright: basic
"""`scripts/soak endurance`: does memory, the number of open files or the rate drift in long flights?

Another process, ``python -m quadftc_tools.soak.endurance MODE GRAPH RATE LENGTH MINUTES FOLDER``, repeats
flights; each is recorded to ``FOLDER/NUMBER``, and in lock-step the time may cut the last, unless it is the
first. Every `LOOK` seconds this one notes resident memory, open files and threads of each of its processes.
Growth is the slope of a straight line through the values after the warm-up.
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
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from scipy.stats import linregress

from quadftc_bags.bag import read_bag
from quadftc_flight.flight import flight_from_bag
from quadftc_flight.graph.plan import GraphError, GraphPlan
from quadftc_flight.runs import GRAPHS
from quadftc_flight.scenario import Scenario, node_parameters
from quadftc_flight.summary import summary as summary_of
from quadftc_ros.scheduling import ORDINARY
from quadftc_tools.soak.flights import best_scheduling, soak_scenario

LOOK = 2.0  # s
WARM_UP = 0.2  # of the time watched
HOUR, MEGABYTE = 3600.0, 1e6
MEMORY_GROWTH = 1.0  # MB/h
FILES_GROWTH = 1.0  # 1/h
RATE_DRIFT = 1e-3  # 1; over the whole time, in real time
MISSING = 1e-4  # 1; share of the samples, in real time; in lock-step none
ATTITUDE = 5.0  # deg
RATE_WINDOW = 10.0  # s
CYCLE, REST = 60.0, 5.0  # s; in each of which both faults act and end, once the gyro bias is learned
REFERENCE = "{kind: sine, amplitude: [3 deg, 2 deg, 5 deg], frequency: [0.7 rad/s, 0.9 rad/s, 0.5 rad/s]}"


@dataclasses.dataclass(frozen=True)
class Flown:
    """One whole flight."""

    samples: int
    wall_s: float  # that it took
    largest_deg: float  # attitude error, the largest of the axes
    missing: int  # samples and messages that are not in the bag
    rate_hz: float  # of torque/command by its log times
    rate_drift: float  # change from begin to end, relative
    wrong: str


@dataclasses.dataclass(frozen=True)
class Growth:
    """Growth of one process, or of those with one name that followed each other."""

    process: str
    looks: int  # after the warm-up
    memory_mb: float  # median
    growth_mb_h: float
    error_mb_h: float  # standard error of the growth
    open_files: int  # most
    files_growth_h: float
    threads: int  # most
    wrong: str


def scenario_of(rate: float, length: float, seed: int) -> Scenario:
    """Flight of a length [s] at a rate [Hz]."""
    faults: list[str] = []
    disturbances: list[str] = []
    for cycle in range(int(length // CYCLE)):
        begin = REST + CYCLE * cycle
        for fault, start in (("axes: roll, value: 2 deg", 5.0), ("axes: pitch, value: -3 deg", 10.0)):
            first = begin + start
            faults.append(f"kind: bias, {fault}, start: {first:g} s, stop: {first + 20.0:g} s")
        disturbances.append(f"start: {begin + 35.0:g} s, stop: {begin + 50.0:g} s")
    return soak_scenario(faults, disturbances, length, seed, rate, REFERENCE)


def soak(mode: str, graph: str, rate: float, length: float, minutes: float) -> Iterator[Flown | Growth]:
    """Fly, watch, and judge.

    ``rate`` in Hz, ``length`` of a flight in s. GraphError if the graph does not start, or ends early;
    ScenarioError if there is no flight of such a rate or length.
    """
    scenario_of(rate, length, 1)
    with tempfile.TemporaryDirectory(prefix="quadftc_soak_") as folder:
        arguments = [mode, graph, f"{rate}", f"{length}", f"{minutes}", folder]
        command = [sys.executable, "-m", __name__, *arguments]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            try:
                yield from _watch(process, Path(folder), mode, rate, length)
            finally:
                process.terminate()


def _watch(
    process: subprocess.Popen[bytes], folder: Path, mode: str, rate: float, length: float
) -> Iterator[Flown | Growth]:
    looks = Looks(process.pid)
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
            flying = "flown" not in told
            if not flying:
                bag = folder / str(told["flown"])
                if not told["cut"]:
                    yield _judge(bag, told, scenario_of(rate, length, told["flown"]), mode)
                shutil.rmtree(bag)
    if process.wait() != 0:
        raise GraphError(f"the flights ended with exit code {process.returncode}")
    yield from looks.growth()


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
            line, files_growth = linregress(hours, memory), float(linregress(hours, files).slope)
            grows = line.slope >= MEMORY_GROWTH or files_growth >= FILES_GROWTH
            found.append(
                Growth(
                    *(name, len(seen), float(np.median(memory)), float(line.slope), float(line.stderr)),
                    *(int(files.max()), files_growth, int(seen[:, 3].max()), "it grows" * bool(grows)),
                )
            )
        return found

    def _name(self, process: psutil.Process) -> str:
        if process.pid == self._root.pid:
            return "graph"
        return next((Path(word).name for word in process.cmdline()[1:] if not word.startswith("-")), "?")


def _judge(bag: Path, told: dict[str, Any], scenario: Scenario, mode: str) -> Flown:
    recorded = read_bag(bag)
    flight = flight_from_bag(recorded)
    result = summary_of(flight, scenario, scenario.scheme(None), None)["metrics"]
    largest = max(result["tracking_max_deg"].values())
    missing = round(scenario.duration * scenario.rate) - scenario.sensor.delay - len(flight) + told["dropped"]
    times = recorded.series("torque/command").log_time_ns / 1e9
    rates = np.histogram(times, np.arange(times[0], times[-1], RATE_WINDOW))[0] / RATE_WINDOW
    rate, drift = float(rates.mean()) if len(rates) else 0.0, 0.0
    if len(rates) > 1:
        drift = float(linregress(np.linspace(0.0, 1.0, len(rates)), rates).slope / rate)
    wrong = "off its reference; " * (largest > ATTITUDE)
    if mode == "lockstep":
        wrong += "samples are missing" * (missing != 0)
    else:
        wrong += "samples are missing; " * (missing > MISSING * len(flight))
        wrong += "not at its rate" * (max(abs(rate / scenario.rate - 1.0), abs(drift)) >= RATE_DRIFT)
    return Flown(len(flight), told["wall_s"], largest, missing, rate, drift, wrong)


def fly_repeatedly(mode: str, kind: str, rate: float, length: float, minutes: float, folder: Path) -> None:
    """Fly until the time is over; a flight in real time to its end."""
    end = time.monotonic() + 60.0 * minutes
    scheduling = best_scheduling() if mode == "realtime" else ORDINARY
    number = 0
    while time.monotonic() < end:
        number += 1
        parameters = node_parameters(scenario_of(rate, length, number))
        plan = GraphPlan(parameters, mode, bag=folder / str(number), scheduling=scheduling)

        def cut() -> bool:
            return mode == "lockstep" and number > 1 and time.monotonic() >= end  # noqa: B023

        with GRAPHS[kind](plan) as graph:
            graph.wait_until_connected()
            _tell(flies=number)
            wall = graph.run(lambda _: not cut())
            recorder = graph.recorder
            assert recorder is not None
            status = recorder.finish()
        _tell(flown=number, wall_s=wall, cut=cut(), dropped=sum(status.dropped.values()) + status.lost)


def _tell(**what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    chosen, of_graph, *numbers, where = sys.argv[1:]
    fly_repeatedly(chosen, of_graph, *(float(each) for each in numbers), folder=Path(where))
