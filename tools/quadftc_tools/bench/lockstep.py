# pyright: basic
"""How fast the graph flies in lock-step, and what one step of each fault observer costs."""

from __future__ import annotations

import itertools
import multiprocessing
import signal
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import median_high
from typing import Any

from rich.table import Table

from quadftc_fdi.fault_observer import fault_observer_from, fault_observers
from quadftc_flight.closed_loop import fly
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.scenario import Scenario, Scheme, load_scenario, node_parameters
from quadftc_model.compiled import CompiledLaw
from quadftc_model.samples import FaultObserverInputs, ImuSample
from quadftc_tools.results_table import results_table

RECORDING, COMPILED, COMPOSED, SINGLE, APART, ALONE = FORMS = (
    "composed, recording",
    "composed, recording, compiled",
    "composed",
    "composed, SingleThreadedExecutor",
    "composed, each vehicle in a process of its own",
    "closed loop without ROS",
)
MEETING = 120.0  # s; for all processes to be ready
STEP_RATE, STEP_DURATION = 250.0, 6.0  # Hz, s; of the flight for step costs; by then an observer has started
STEPS = 250  # of a batch
MICROSECONDS = 1e6

_barriers: list[Any] = []  # where the processes of `_wall_time_apart` wait for each other


def forms(vehicles: int, compiled: bool = False) -> tuple[str, ...]:
    """Those of `FORMS` that differ for a number of vehicles; ``compiled``: that one, too."""
    left_out = [APART] * (vehicles == 1) + [COMPILED] * (not compiled)
    return tuple(form for form in FORMS if form not in left_out)


def measure_lockstep(
    scenario: Scenario, scheme: Scheme, form: str, vehicles: int, progress: Callable[[int], bool]
) -> dict[str, Any] | None:
    """Fly a scenario in one of `FORMS`; None if ``progress``, called with the samples so far, ended it.

    ``real_time_factor`` is of the whole, ``sample_us`` of one sample of one vehicle, as is ``processor_us``,
    the processor time of all threads of this process; None if others fly. GraphError if the graph
    does not start or stalls.
    """
    parameters = node_parameters(scenario, scheme)
    if form == ALONE:
        begin, busy = time.monotonic(), time.process_time()
        for _ in range(vehicles):
            fly(scenario, scheme)
        wall_time, busy = time.monotonic() - begin, time.process_time() - busy
    elif form == APART:
        wall_time, busy = _wall_time_apart(parameters, vehicles), None
    else:
        going_on = True

        def follow(samples: int) -> bool:
            nonlocal going_on
            going_on = progress(samples)
            return going_on

        wall_time, busy = _times_together(parameters, form, vehicles, follow)
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
        "sample_us": round(MICROSECONDS * wall_time / samples, 1),
        "processor_us": None if busy is None else round(MICROSECONDS * busy / samples, 1),
    }


def _times_together(
    parameters: Mapping[str, Mapping[str, Any]], form: str, vehicles: int, follow: Callable[[int], bool]
) -> tuple[float, float]:
    """Fly all vehicles in this process, each in a namespace of its own; wall and processor time [s]."""
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        records = form in (RECORDING, COMPILED)
        bags = [Path(folder, f"bag_{number}") if records else None for number in range(vehicles)]
        plans = [
            GraphPlan(parameters, "lockstep", f"vehicle_{number}", bag, compiled=form == COMPILED)
            for number, bag in enumerate(bags)
        ]
        with ComposedGraph(*plans, executor="single" if form == SINGLE else "events") as graph:
            graph.wait_until_connected()
            busy = time.process_time()
            return graph.run(follow), time.process_time() - busy


def _wall_time_apart(parameters: Mapping[str, Mapping[str, Any]], vehicles: int) -> float:
    """Fly each vehicle in a process of its own, all at a time; return the time of the slowest [s]."""
    context = multiprocessing.get_context("spawn")  # a process that has ROS in it must not be forked
    barrier = context.Barrier(vehicles)
    with ProcessPoolExecutor(vehicles, context, _prepare_process, (barrier,)) as pool:
        return max(pool.map(_fly_one, itertools.repeat(parameters), range(vehicles)))


def _prepare_process(barrier: Any) -> None:
    _barriers.append(barrier)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits for this one


def _fly_one(parameters: Mapping[str, Mapping[str, Any]], number: int) -> float:
    with ComposedGraph(GraphPlan(parameters, "lockstep", namespace=f"vehicle_{number}")) as graph:
        graph.wait_until_connected()
        _barriers[-1].wait(MEETING)
        return graph.run()


def lockstep_table(results: Sequence[Mapping[str, Any]]) -> Table:
    """One row for each rate, number of vehicles and form; medians of the runs."""
    title = f"lock-step, {results[0]['observer']}"
    numbers = ("times real time", "one sample [us]", "of the closed loop", "processor [us]")
    table = results_table(title, ("rate [Hz]", "vehicles", "form"), numbers)
    for rate, count in dict.fromkeys((item["rate"], item["vehicles"]) for item in results):
        rows = [item for item in results if (item["rate"], item["vehicles"]) == (rate, count)]
        alone = median_high([row["sample_us"] for row in rows if row["form"] == ALONE])
        for form in dict.fromkeys(row["form"] for row in rows):
            sample, factor = (
                median_high([row[key] for row in rows if row["form"] == form])
                for key in ("sample_us", "real_time_factor")
            )
            busy = [row["processor_us"] for row in rows if row["form"] == form and row["processor_us"]]
            processor = f"{median_high(busy):.0f}" if busy else "-"
            cells = (f"{factor:.2f}", f"{sample:.0f}", f"{sample / alone:.2f}", processor)
            table.add_row(f"{rate:g}", f"{count}", form, *cells)
    return table


def step_costs(batches: int, compiled: bool = False) -> Iterator[dict[str, Any]]:
    """Measure every fault observer on a simulated healthy flight with a MEMS IMU at 250 Hz.

    Yields ``observer``, and ``best_us`` and ``median_us`` of batches of 250 steps.
    """
    from quadftc_campaign.open_motion import simulate
    from quadftc_tools.study.diagnosis_results import SCENARIO

    short = [f"duration={STEP_DURATION} s", f"rate={STEP_RATE} Hz", "faults=[]"]
    recording = simulate(load_scenario(SCENARIO, short))
    samples = [
        FaultObserverInputs(ImuSample(*row), torque)
        for *row, torque in zip(*recording.imu, recording.torque, strict=True)
    ]
    for name in fault_observers.names():
        law = fault_observer_from({"vehicle": "qball_x4", "observer": name})
        advance = CompiledLaw(law, samples[0]).step if compiled else law.step
        state, _ = advance(law.init(samples[0]), samples[0], 0.0)
        for inputs in samples[1:-STEPS]:
            state, _ = advance(state, inputs, 1.0 / STEP_RATE)
        costs = [_step_cost(advance, state, samples[-STEPS:]) for _ in range(batches)]
        best, median = round(min(costs), 1), round(statistics.median(costs), 1)
        yield {"observer": name, "best_us": best, "median_us": median}


def _step_cost(advance: Any, state: Any, samples: list[FaultObserverInputs]) -> float:
    """Mean time of a step [us]."""
    begin = time.perf_counter()
    for inputs in samples:
        state, _ = advance(state, inputs, 1.0 / STEP_RATE)
    return MICROSECONDS * (time.perf_counter() - begin) / len(samples)


def step_table(results: Sequence[Mapping[str, Any]]) -> Table:
    """One row for each fault observer."""
    table = results_table("one step [us], of batches of 250", ("observer",), ("best", "median"))
    for item in results:
        table.add_row(item["observer"], f"{item['best_us']:.1f}", f"{item['median_us']:.1f}")
    return table
