# pyright: basic
"""How many times faster than real time the graph flies in lock-step."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from quadftc_bench.closed_loop import fly
from quadftc_bench.composed_graph import ComposedGraph
from quadftc_bench.graph_plan import GraphPlan
from quadftc_bench.scenario import Scenario, Scheme, node_parameters

RECORDING, COMPOSED, SINGLE, ALONE = FORMS = (
    "composed, recording",
    "composed",
    "composed, SingleThreadedExecutor",
    "closed loop without ROS",
)


def measure_lockstep(
    scenario: Scenario, scheme: Scheme, form: str, vehicles: int, progress: Callable[[int], bool]
) -> dict[str, Any] | None:
    """Fly a scenario in one of `FORMS`; None if ``progress``, called with the samples so far, ended it.

    Parameters
    ----------
    scenario, scheme : Scenario, Scheme
    form : str
    vehicles : int
        So many fly in one process, each in a namespace of its own.
    progress : callable

    Returns
    -------
    dict
        ``real_time_factor`` of the whole; ``sample_us`` of one sample of one vehicle; what was flown.

    Raises
    ------
    GraphError
        If the graph does not start or stalls.
    """
    parameters = node_parameters(scenario, scheme)
    if form == ALONE:
        begin = time.monotonic()
        for _ in range(vehicles):
            fly(parameters)
        wall_time = time.monotonic() - begin
    else:
        with tempfile.TemporaryDirectory(prefix="quadftc_bench_") as folder:
            plans = [
                GraphPlan(
                    parameters,
                    "lockstep",
                    namespace=f"vehicle_{number}",
                    bag=Path(folder, f"bag_{number}") if form == RECORDING else None,
                )
                for number in range(vehicles)
            ]
            going_on = True

            def follow(samples: int) -> bool:
                nonlocal going_on
                going_on = progress(samples)
                return going_on

            with ComposedGraph(*plans, executor="single" if form == SINGLE else "events") as graph:
                wall_time = graph.run(follow)
            if not going_on:
                return None
    samples = scenario.duration * scenario.rate * vehicles
    return {
        "form": form,
        "scenario": scenario.name,
        "rate": scenario.rate,
        "vehicles": vehicles,
        "observer": scheme.observer.kind,
        "real_time_factor": round(scenario.duration / wall_time, 3),
        "sample_us": round(1e6 * wall_time / samples, 1),
    }
