"""Steps of the closed loop per second and memory of the batch engine, beside other simulators.

Each measurement starts new processes, one pinned to each core, that fly at the same time. In C a process
flies one flight after the other, in JAX all at once. See `quadftc_tools.bench.batch_child`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import quadftc_tools
from quadftc_flight.run_files import RunError

SCENARIO, SCHEME = "mems_faults", "supervised"
OTHER_SCHEMES = ("proposed", "conventional")
WHOLE, WHOLE_DURATION = "one whole flight", 80.0  # s
BARE_ENGINE, BARE = "bare, in the engine", "bare"
FREE, FREE_SCENARIO, FREE_SCHEMES = "free flight", "free_circle", ("isolating", "conventional")
BARE_FLIGHT = "bare, free flight"
CRAZYFLOW, ROTORPY = "crazyflow", "RotorPy"
IN_JAX = "jax"
IN_TURN = 16  # flights at most, where they are flown one after the other
LEAST = 0.5  # s; a shorter run is repeated
OURS, THEIRS = "quadftc_tools.bench.batch_worker", "quadftc_tools.bench.batch_others"
NANOSECONDS = 1e9
VERSION = "import sys; print(sys.version_info >= (3, 10))"
# sys.path last, so that another Python keeps its own packages
BOOT = (
    "import runpy, sys; sys.path.append(sys.argv.pop(1));"
    " runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)
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
    """Plan the measurements: all numbers of flights of a process on the fewest cores, the most on all.

    What is flown in C is in double precision, and how many flights there are makes no difference.
    """
    fewest, most = min(cores), max(flights)
    everywhere = [(count, fewest) for count in flights]
    everywhere += [(most, count) for count in cores if count != fewest]
    largest = [(most, count) for count in cores]
    first, alone = largest[:1], [(1, fewest)]
    in_turn = [(min(most, IN_TURN), count) for count in cores]
    engine = {"task": "engine", "scenario": SCENARIO, "duration": duration}
    whole = {**engine, "scheme": SCHEME, "duration": WHOLE_DURATION}
    free = {**engine, "scenario": FREE_SCENARIO}
    both, single, double = tuple(float32), (True,), (False,)
    crazyflow, rotorpy = {"simulator": "crazyflow"}, {"simulator": "rotorpy"}
    crazyflow_rk4 = {**crazyflow, "integrator": "rk4", "steps_a_call": 500}
    crazyflow_euler = {**crazyflow, "integrator": "euler", "steps_a_call": 1}
    rows: list[tuple[str, str, Sequence[tuple[int, int]], Sequence[bool], dict[str, Any]]] = [
        *((each, OURS, in_turn, double, {**engine, "scheme": each}) for each in (SCHEME, *OTHER_SCHEMES)),
        (f"{SCHEME}, {IN_JAX}", OURS, everywhere, both, {**engine, "scheme": SCHEME, "engine": IN_JAX}),
        (f"{SCHEME}, {WHOLE}", OURS, alone, double, whole),
        (BARE_ENGINE, OURS, in_turn, double, {"task": "bare engine", "duration": duration}),
        (BARE, OURS, in_turn, double, {"task": "bare", "duration": duration}),
        *((f"{FREE}, {each}", OURS, in_turn, double, {**free, "scheme": each}) for each in FREE_SCHEMES),
        (BARE_FLIGHT, OURS, in_turn, double, {"task": "bare flight", "duration": duration}),
        (CRAZYFLOW, THEIRS, everywhere, single, crazyflow_rk4),
        (f"{CRAZYFLOW}, its own way", THEIRS, first, single, crazyflow_euler),
        (ROTORPY, THEIRS, everywhere, double, {**rotorpy, "single": False}),
        (f"{ROTORPY}, one drone", THEIRS, alone, double, {**rotorpy, "single": True}),
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
    """Full path of the Python that has the other simulators; None: of this one."""
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

    ``others`` is the Python that has the other simulators. The row says ``absent`` or ``failed`` if another
    simulator does not run. RunError if a process does not start, or the engine fails.
    """
    row: dict[str, Any] = {"name": what.name, "flights": what.flights}
    row |= {"precision": PRECISIONS[what.float32], "cores": what.cores}
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
    compile_s = round(max(answer["compile_s"] for answer in ready), 2)
    last = {"compile_s": compile_s, "memory_mib": max(memory), "what": ready[0]["what"]}
    return {**row, **_summary(rounds), **last}


class FlyingProcess:
    """The other end of `quadftc_tools.bench.batch_child`; RunError if it does not start.

    ``python`` is a Python that has nothing of ours installed; None: this one, in its environment.
    """

    def __init__(self, module: str, job: Mapping[str, Any], python: str | None = None) -> None:
        root = str(Path(quadftc_tools.__file__).parents[1])
        start = [sys.executable, "-m"] if python is None else [python, "-E", "-c", BOOT, root]
        self._name = start[0]
        self._folder = tempfile.TemporaryDirectory(prefix="quadftc_")  # some write where they are
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        # one thread, the CPU, and the compiler at its best; for the other simulators, too
        single = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
        try:
            self._process = subprocess.Popen(
                [*start, module, json.dumps(job)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                cwd=None if python is None else self._folder.name,
                env={"JAX_PLATFORMS": "cpu", "NPROC": "1", **os.environ, **single},
            )
        except OSError as error:
            self._clean_up()
            raise RunError(f"{self._name}: {error.strerror}") from None

    def go(self) -> None:
        """Have it fly."""
        if self._process.stdin is not None:
            self._process.stdin.write("go\n")
            self._process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        """Wait for what it says next; RunError if it has ended."""
        line = self._process.stdout.readline() if self._process.stdout is not None else ""
        try:
            found: dict[str, Any] = json.loads(line)
        except ValueError:
            raise RunError(f"{self._name}: no answer: {self._last_words()}") from None
        return found

    def finish(self) -> dict[str, Any]:
        """Close its input, and return its last answer."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        return self.answer()

    def close(self) -> None:
        """End it, if it has not ended."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._clean_up()

    def _clean_up(self) -> None:
        self._errors.close()
        self._folder.cleanup()

    def _last_words(self) -> str:
        self._process.kill()
        self._process.wait()
        self._errors.seek(0)
        lines = [line.strip() for line in self._errors.read().splitlines() if line.strip()]
        return lines[-1] if lines else f"it ended with code {self._process.returncode}"


def _process(what: Measurement, place: int, core: int, others: str) -> FlyingProcess:
    job = {**what.job, "flights": what.flights, "float32": what.float32, "core": core, "least": LEAST}
    job["first_seed"] = 1 + place * what.flights
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
