"""Steps of the closed loop per second and memory of the batch engine, beside other simulators.

Each measurement is made in processes of their own, one a core and pinned to it, that fly at the same time:
JAX reads its settings when it is imported. See `quadftc_tools.bench.batch_child`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from quadftc_flight.runs import RunError
from quadftc_tools.bench.batch_process import FlyingProcess

SCENARIO, SCHEME = "mems_faults", "supervised"
OTHER_SCHEMES = ("proposed", "conventional")
WHOLE, WHOLE_DURATION = "one whole flight", 80.0  # s
BARE_ENGINE, BARE = "bare, in the engine", "bare"
CRAZYFLOW, ROTORPY = "crazyflow", "RotorPy"
PLAIN_VMAP = "plain vmap"
LEAST = 0.5  # s; a shorter run is repeated
OURS, THEIRS = "quadftc_tools.bench.batch_worker", "quadftc_tools.bench.batch_others"
NANOSECONDS = 1e9
VERSION = "import sys; print(sys.version_info >= (3, 10))"
PRECISIONS = {True: "float32", False: "float64"}


@dataclasses.dataclass(frozen=True)
class Measurement:
    """One row of the results."""

    name: str
    module: str  # of the worker
    flights: int  # in each process
    float32: bool
    cores: int  # a process on each
    job: Mapping[str, Any]  # what else the worker has to know

    @property
    def title(self) -> str:
        """In words."""
        return f"{self.name}, {PRECISIONS[self.float32]}, {self.flights} flights, cores: {self.cores}"


def measurements(
    flights: Sequence[int], float32: Sequence[bool], cores: Sequence[int], duration: float
) -> list[Measurement]:
    """Plan everything that is measured: all numbers of flights on the fewest cores, the most on all.

    Parameters
    ----------
    flights : sequence of int
        In each process.
    float32 : sequence of bool
    cores : sequence of int
    duration : float
        Of a flight [s].
    """
    fewest, most = min(cores), max(flights)
    everywhere = [(count, fewest) for count in flights]
    everywhere += [(most, count) for count in cores if count != fewest]
    largest = [(most, count) for count in cores]
    engine = {"task": "engine", "scenario": SCENARIO, "duration": duration}
    both, single, double = tuple(float32), (True,), (False,)
    own_way = f"{CRAZYFLOW}, its own way"
    crazyflow, rotorpy = {"simulator": "crazyflow"}, {"simulator": "rotorpy"}
    rows: list[tuple[str, str, Sequence[tuple[int, int]], Sequence[bool], dict[str, Any]]] = [
        (SCHEME, OURS, everywhere, both, {**engine, "scheme": SCHEME}),
        *((each, OURS, largest[:1], both, {**engine, "scheme": each}) for each in OTHER_SCHEMES),
        *(
            (f"{each}, {PLAIN_VMAP}", OURS, largest[:1], both, {**engine, "scheme": each, "staged": False})
            for each in (SCHEME, *OTHER_SCHEMES)
        ),
        (
            f"{SCHEME}, {WHOLE}",
            OURS,
            [(1, fewest)],
            both,
            {**engine, "scheme": SCHEME, "duration": WHOLE_DURATION},
        ),
        (BARE_ENGINE, OURS, largest, both, {"task": "bare engine", "duration": duration}),
        (BARE, OURS, everywhere, both, {"task": "bare", "duration": duration}),
        (CRAZYFLOW, THEIRS, everywhere, single, {**crazyflow, "integrator": "rk4", "steps_a_call": 500}),
        (own_way, THEIRS, largest[:1], single, {**crazyflow, "integrator": "euler", "steps_a_call": 1}),
        (ROTORPY, THEIRS, everywhere, double, {**rotorpy, "single": False}),
        (f"{ROTORPY}, one drone", THEIRS, [(1, fewest)], double, {**rotorpy, "single": True}),
    ]
    return [
        Measurement(name, module, count, precision, core_count, job)
        for name, module, places, precisions, job in rows
        for precision in precisions
        for count, core_count in places
    ]


def usable_cores() -> list[int]:
    """Numbers of the cores that this process may use."""
    return sorted(os.sched_getaffinity(0))


def python_of(others: str | None) -> str:
    """Full path of the Python in which other simulators are; None: of this one.

    Raises
    ------
    RunError
        If there is no such program, or it is no Python that our workers run in.
    """
    if others is None:
        return sys.executable
    found = shutil.which(others)
    if found is None:
        raise RunError(f"--others {others}: no such program")
    path = str(Path(found).absolute())
    asked = subprocess.run([path, "-E", "-c", VERSION], capture_output=True, check=False)
    if asked.stdout.strip() != b"True":
        raise RunError(f"--others {others}: no Python of 3.10 or later")
    return path


def measure(
    what: Measurement, repeats: int, others: str, stopped: Callable[[], bool] = lambda: False
) -> dict[str, Any] | None:
    """Measure; None if ``stopped``, asked between two repeats, says so.

    Parameters
    ----------
    what : Measurement
    repeats : int
    others : str
        Python that has the other simulators.
    stopped : callable

    Returns
    -------
    dict
        The measured numbers; ``absent`` or ``failed`` where another simulator does not run.

    Raises
    ------
    RunError
        If a process does not start, or the engine fails.
    """
    row: dict[str, Any] = {
        "name": what.name,
        "flights": what.flights,
        "precision": PRECISIONS[what.float32],
        "cores": what.cores,
    }
    with contextlib.ExitStack() as stack:
        processes: list[FlyingProcess] = []
        for place, core in enumerate(usable_cores()[: what.cores]):
            processes.append(_process(what, place, core, others))
            stack.callback(processes[-1].close)
        ready = [each.answer() for each in processes]
        for reason in ("absent", "failed"):
            if reason in ready[0]:
                if what.module == OURS:
                    raise RunError(f"{what.name}, {what.flights} flights: {ready[0][reason]}")
                return {**row, reason: ready[0][reason]}
        rounds: list[list[dict[str, Any]]] = []
        for _ in range(repeats):
            if stopped():
                return None
            for each in processes:
                each.go()
            rounds.append([each.answer() for each in processes])
        memory = [each.finish()["memory_mib"] for each in processes]
    return {
        **row,
        **_summary(rounds),
        "compile_s": round(max(answer["compile_s"] for answer in ready), 2),
        "memory_mib": max(memory),
        "what": ready[0]["what"],
    }


def _process(what: Measurement, place: int, core: int, others: str) -> FlyingProcess:
    job = {
        **what.job,
        "flights": what.flights,
        "float32": what.float32,
        "first_seed": 1 + place * what.flights,
        "core": core,
        "least": LEAST,
    }
    return FlyingProcess(what.module, job, None if what.module == OURS else others)


def _summary(rounds: Sequence[Sequence[Mapping[str, float]]]) -> dict[str, Any]:
    """Of each repeat, the steps of all processes over the time of the slowest."""
    rates = [sum(one["steps"] for one in each) / max(one["seconds"] for one in each) for each in rounds]
    cores = len(rounds[0])
    flat = [one for each in rounds for one in each]
    runs = [one["seconds"] / one["runs"] for one in flat]  # all flights of a process, once
    return {
        "steps_per_second": {"best": round(max(rates)), "median": round(statistics.median(rates))},
        "ns_per_step_and_core": round(NANOSECONDS * cores / max(rates), 1),
        "seconds": {"best": round(min(runs), 6), "median": round(statistics.median(runs), 6)},
        "drawing_share": round(sum(one["drawing"] for one in flat) / sum(one["seconds"] for one in flat), 3),
        "repeats": [round(rate) for rate in rates],
    }
