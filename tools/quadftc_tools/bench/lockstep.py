# pyright: basic
"""How fast the graph flies in lock-step, beside the closed loop without ROS."""

from __future__ import annotations

import itertools
import multiprocessing
import signal
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import median_high
from typing import Any

from rich.table import Table

from quadftc_compile.engine import CEngine
from quadftc_flight.closed_loop import fly, loop_of
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.scenario import Scenario, Scheme, node_parameters
from quadftc_tools.results_table import results_table

RECORDING, COMPOSED, SINGLE, APART, ALONE = FORMS = (
    "composed, recording",
    "composed",
    "composed, SingleThreadedExecutor",
    "composed, each vehicle in a process of its own",
    "closed loop without ROS",
)
MEETING = 120.0  # s; for all processes to be ready
MICROSECONDS = 1e6

_barriers: list[Any] = []  # where the processes of `_wall_time_apart` wait for each other


def forms(vehicles: int, engines: Sequence[str] = ("c",)) -> list[tuple[str, str]]:
    """Those of `FORMS` that differ for a number of vehicles, each with its engine.

    All forms are flown with the first engine, one in the graph and the closed loop with the others.
    """
    chosen = [form for form in FORMS if form != APART or vehicles > 1]
    return [
        (form, engine) for form in chosen for engine in engines[: None if form in (RECORDING, ALONE) else 1]
    ]


def measure_lockstep(
    scenario: Scenario,
    scheme: Scheme,
    form: str,
    engine: str,
    vehicles: int,
    progress: Callable[[int], bool],
) -> dict[str, Any] | None:
    """Fly a scenario in one of `FORMS`; None if ``progress``, called with the samples so far, ended it.

    ``real_time_factor`` is of the whole, ``sample_us`` of one sample of one vehicle, as is ``processor_us``,
    the processor time of all threads of this process; None if others fly. GraphError if the graph
    does not start or stalls.
    """
    parameters = node_parameters(scenario, scheme)
    if form == ALONE:
        if engine == "c":
            CEngine().prepare(loop_of(scenario, scheme).laws.values())  # compiling is not measured
        begin, busy = time.monotonic(), time.process_time()
        for _ in range(vehicles):
            fly(scenario, scheme, engine=engine)
        wall_time, busy = time.monotonic() - begin, time.process_time() - busy
    elif form == APART:
        wall_time, busy = _wall_time_apart(parameters, engine, vehicles), None
    else:
        going_on = True

        def follow(samples: int) -> bool:
            nonlocal going_on
            going_on = progress(samples)
            return going_on

        wall_time, busy = _times_together(parameters, form, engine, vehicles, follow)
        if not going_on:
            return None
    samples = scenario.duration * scenario.rate * vehicles
    return {
        "form": form,
        "engine": engine,
        "scenario": scenario.name,
        "rate": scenario.rate,
        "vehicles": vehicles,
        "observer": scheme.observer.kind,
        "real_time_factor": round(scenario.duration / wall_time, 3),
        "sample_us": round(MICROSECONDS * wall_time / samples, 1),
        "processor_us": None if busy is None else round(MICROSECONDS * busy / samples, 1),
    }


def _times_together(
    parameters: Mapping[str, Mapping[str, Any]],
    form: str,
    engine: str,
    vehicles: int,
    follow: Callable[[int], bool],
) -> tuple[float, float]:
    """Fly all vehicles in this process, each in a namespace of its own; wall and processor time [s]."""
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        records = form == RECORDING
        bags = [Path(folder, f"bag_{number}") if records else None for number in range(vehicles)]
        plans = [
            GraphPlan(parameters, "lockstep", f"vehicle_{number}", bag, engine=engine)
            for number, bag in enumerate(bags)
        ]
        with ComposedGraph(*plans, executor="single" if form == SINGLE else "events") as graph:
            graph.wait_until_connected()
            busy = time.process_time()
            return graph.run(follow), time.process_time() - busy


def _wall_time_apart(parameters: Mapping[str, Mapping[str, Any]], engine: str, vehicles: int) -> float:
    """Fly each vehicle in a process of its own, all at a time; return the time of the slowest [s]."""
    context = multiprocessing.get_context("spawn")  # a process that has ROS in it must not be forked
    barrier = context.Barrier(vehicles)
    with ProcessPoolExecutor(vehicles, context, _prepare_process, (barrier,)) as pool:
        return max(
            pool.map(_fly_one, itertools.repeat(parameters), itertools.repeat(engine), range(vehicles))
        )


def _prepare_process(barrier: Any) -> None:
    _barriers.append(barrier)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits for this one


def _fly_one(parameters: Mapping[str, Mapping[str, Any]], engine: str, number: int) -> float:
    plan = GraphPlan(parameters, "lockstep", namespace=f"vehicle_{number}", engine=engine)
    with ComposedGraph(plan) as graph:
        graph.wait_until_connected()
        _barriers[-1].wait(MEETING)
        return graph.run()


def lockstep_table(results: Sequence[Mapping[str, Any]]) -> Table:
    """One row for each rate, number of vehicles, form and engine; medians of the runs.

    Forms are compared with the closed loop of the same engine.
    """
    title = f"lock-step, {results[0]['observer']}"
    numbers = ("times real time", "one sample [us]", "of the closed loop", "processor [us]")
    table = results_table(title, ("rate [Hz]", "vehicles", "form", "engine"), numbers)
    for rate, count in dict.fromkeys((item["rate"], item["vehicles"]) for item in results):
        rows = [item for item in results if (item["rate"], item["vehicles"]) == (rate, count)]
        for form, engine in dict.fromkeys((row["form"], row["engine"]) for row in rows):
            same = [row for row in rows if row["engine"] == engine]
            alone = median_high([row["sample_us"] for row in same if row["form"] == ALONE])
            same = [row for row in same if row["form"] == form]
            sample, factor = (
                median_high([row[key] for row in same]) for key in ("sample_us", "real_time_factor")
            )
            busy = [row["processor_us"] for row in same if row["processor_us"]]
            processor = f"{median_high(busy):.0f}" if busy else "-"
            cells = (f"{factor:.2f}", f"{sample:.0f}", f"{sample / alone:.2f}", processor)
            table.add_row(f"{rate:g}", f"{count}", form, engine, *cells)
    return table
