# pyright: basic
"""How fast the graph flies in lock-step, beside the closed loop without ROS."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median_high

from rich.table import Table

from quadftc_cli.screen import plain_table
from quadftc_compile.engine import CEngine
from quadftc_flight.closed_loop import fly, loop_of
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.scenario import Scenario, Scheme, node_parameters
from quadftc_model.assembly import NodeParameters
from quadftc_tools.bench.machine import Result

RECORDING, COMPOSED, ALONE = FORMS = ("composed, recording", "composed", "closed loop without ROS")
MICROSECONDS = 1e6


def forms(engines: Sequence[str] = ("c",)) -> list[tuple[str, str]]:
    """Pairs of form and engine: all `FORMS` with the first engine, two of them with the others."""
    return [
        (form, engine) for form in FORMS for engine in engines[: None if form in (RECORDING, ALONE) else 1]
    ]


def measure_lockstep(
    scenario: Scenario, scheme: Scheme, form: str, engine: str, progress: Callable[[int], bool]
) -> Result | None:
    """Fly a scenario in one of `FORMS`; None if ``progress``, called with the samples so far, ended it.

    ``real_time_factor`` is of the whole, ``sample_us`` of one sample, as is ``processor_us``, the processor
    time of all threads of this process. GraphError if the graph does not start or stalls.
    """
    if form == ALONE:
        if engine == "c":
            CEngine().prepare(loop_of(scenario, scheme).laws.values())  # compiling is not measured
        begin, busy = time.monotonic(), time.process_time()
        fly(scenario, scheme, engine=engine)
        wall_time, busy = time.monotonic() - begin, time.process_time() - busy
    else:
        times = _graph_times(node_parameters(scenario, scheme), form, engine, progress)
        if times is None:
            return None
        wall_time, busy = times
    samples = scenario.duration * scenario.rate
    return {
        "form": form,
        "engine": engine,
        "scenario": scenario.name,
        "rate": scenario.rate,
        "observer": scheme.observer.kind,
        "real_time_factor": round(scenario.duration / wall_time, 3),
        "sample_us": round(MICROSECONDS * wall_time / samples, 1),
        "processor_us": round(MICROSECONDS * busy / samples, 1),
    }


def _graph_times(
    parameters: Mapping[str, NodeParameters], form: str, engine: str, progress: Callable[[int], bool]
) -> tuple[float, float] | None:
    """Fly the graph in this process; wall and processor time [s], None if ``progress`` ended it."""
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        bag = Path(folder, "bag") if form == RECORDING else None
        plan = GraphPlan(parameters, "lockstep", bag=bag, engine=engine)
        with ComposedGraph(plan) as graph:
            graph.wait_until_connected()
            busy = time.process_time()
            wall_time = graph.run(progress)
            return (wall_time, time.process_time() - busy) if graph.flew_to_its_end else None


def lockstep_table(results: Sequence[Result]) -> Table:
    """One row for each rate, form and engine; medians of the runs.

    Forms are compared with the closed loop of the same engine.
    """
    title = f"lock-step, {results[0]['observer']}"
    numbers = ("times real time", "one sample [us]", "of the closed loop", "processor [us]")
    table = plain_table(("rate [Hz]", "form", "engine"), numbers, title)

    def median(key: str, rate: float, form: str, engine: str) -> float:
        wanted = (rate, form, engine)
        return median_high(
            [row[key] for row in results if (row["rate"], row["form"], row["engine"]) == wanted]
        )

    for which in dict.fromkeys((row["rate"], row["form"], row["engine"]) for row in results):
        rate, form, engine = which
        sample, factor, busy = (
            median(key, *which) for key in ("sample_us", "real_time_factor", "processor_us")
        )
        share = sample / median("sample_us", rate, ALONE, engine)
        cells = (f"{factor:.2f}", f"{sample:.0f}", f"{share:.2f}", f"{busy:.0f}")
        table.add_row(f"{rate:g}", form, engine, *cells)
    return table
