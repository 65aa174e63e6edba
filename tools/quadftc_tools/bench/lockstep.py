# pyright: basic
"""How many times faster than real time the graph flies in lock-step."""

from __future__ import annotations

import itertools
import multiprocessing
import signal
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from quadftc_flight.closed_loop import fly
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.scenario import Scenario, Scheme, node_parameters

RECORDING, COMPOSED, SINGLE, APART, ALONE = FORMS = (
    "composed, recording",
    "composed",
    "composed, SingleThreadedExecutor",
    "composed, each vehicle in a process of its own",
    "closed loop without ROS",
)
MEETING = 120.0  # s; for all processes to be ready

_barriers: list[Any] = []  # where the processes of `_wall_time_apart` wait for each other


def forms(vehicles: int) -> tuple[str, ...]:
    """Those of `FORMS` that differ for a number of vehicles."""
    return tuple(form for form in FORMS if form != APART or vehicles > 1)


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
            fly(scenario, scheme)
        wall_time = time.monotonic() - begin
    elif form == APART:
        wall_time = _wall_time_apart(parameters, vehicles)
    else:
        with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
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


def _wall_time_apart(parameters: Mapping[str, Mapping[str, Any]], vehicles: int) -> float:
    """Fly each vehicle in a process of its own, all at a time; return the time of the slowest [s]."""
    context = multiprocessing.get_context("spawn")  # a process that has ROS in it must not be forked
    barrier = context.Barrier(vehicles)
    with ProcessPoolExecutor(vehicles, context, _ready, (barrier,)) as pool:
        return max(pool.map(_fly_one, itertools.repeat(parameters), range(vehicles)))


def _ready(barrier: Any) -> None:
    _barriers.append(barrier)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits for this one


def _fly_one(parameters: Mapping[str, Mapping[str, Any]], number: int) -> float:
    with ComposedGraph(GraphPlan(parameters, "lockstep", namespace=f"vehicle_{number}")) as graph:
        graph.wait_until_connected()
        _barriers[-1].wait(MEETING)
        return graph.run()
