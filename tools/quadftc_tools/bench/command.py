# pyright: basic
"""``quadftc bench``."""

from __future__ import annotations

import enum
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from quadftc_cli.commands import GOOD, INTERRUPTED
from quadftc_cli.commands.run import CoreOption, Graph, PriorityOption, Wait
from quadftc_cli.tables import console
from quadftc_flight.runs import RunError
from quadftc_flight.scenario import (
    Scenario,
    find_scenario,
    load_scenario,
    with_duration,
    with_observer,
    with_rate,
)
from quadftc_ros.executor import StopSignals
from quadftc_ros.scheduling import Scheduling

SCENARIO = "mems_faults"
NO_DELAY = "sensors.delay=0"  # the modelled delay of the sensor is no latency of the graph


class Executor(str, enum.Enum):
    """What runs the nodes of the composed graph."""

    events = "events"
    single = "single"


class Precision(str, enum.Enum):
    """Of all numbers of a batch."""

    float64 = "float64"
    float32 = "float32"


bench = typer.Typer(help="Measure how fast it is, on this machine.", no_args_is_help=True)

Observer = Annotated[str, typer.Option(help="Fault observer.")]
Duration = Annotated[float, typer.Option(min=3.0, help="Length of a flight [s].")]
Out = Annotated[
    Path | None,
    typer.Option(help="Directory for the results: JSON, and a figure of latencies or of batches."),
]
Repeat = Annotated[int, typer.Option(min=1, help="How often; medians are shown.")]


@bench.command()
def latency(
    rate: Annotated[list[float], typer.Option(help="Control rates [Hz].")] = [250.0, 500.0, 1000.0],  # noqa: B006
    graph: Annotated[
        Graph, typer.Option(help="All nodes in one process, or a process each.")
    ] = Graph.composed,
    executor: Annotated[Executor, typer.Option(help="Executor of the composed graph.")] = Executor.events,
    observer: Observer = "supervised",
    duration: Duration = 60.0,
    repeat: Repeat = 1,
    record: Annotated[bool, typer.Option(help="Record a bag meanwhile.")] = True,
    wait: Annotated[
        Wait | None, typer.Option(help="Between samples; default: poll, where it is possible.")
    ] = None,
    realtime_priority: PriorityOption = 0,
    core: CoreOption = [],  # noqa: B006
    out: Out = None,
) -> None:
    """From the stamp of an IMU sample to its torque, stage by stage, in real time."""
    from quadftc_tools.bench.latency import LatencyOptions, measure_latency
    from quadftc_tools.bench.latency_table import counts_line, latency_table, usage_line

    if wait is None:
        wait = Wait.sleep if graph is Graph.processes or realtime_priority else Wait.poll
    scheduling = Scheduling(wait.value, realtime_priority, tuple(core))
    options = LatencyOptions(graph.value, executor.value, record, scheduling)
    results: list[dict[str, Any]] = []
    jobs = [(each, number) for each in rate for number in range(repeat)]
    with StopSignals() as stop, _bars() as bars:
        for each, number in jobs:
            scenario = _scenario(observer, duration, each)
            bar = bars.add_task(f"{each:g} Hz, {number + 1} of {repeat}", total=duration * each)
            bars.refresh()  # not in flight: drawing would take milliseconds from it
            result = measure_latency(
                scenario, scenario.scheme(None), options, _follower(bars, bar, lambda: stop.requested)
            )
            if result is None:
                raise typer.Exit(INTERRUPTED)
            results.append(result)
            bars.refresh()
    screen = console()
    for each in rate:
        of_rate = [item for item in results if item["rate"] == each]
        screen.print(latency_table(of_rate))
        for item in of_rate:
            screen.print(counts_line(item))
        screen.print(usage_line(of_rate), soft_wrap=True)
    _write(out, "latency", results)
    raise typer.Exit(GOOD)


@bench.command()
def lockstep(
    rate: Annotated[list[float], typer.Option(help="Control rates [Hz].")] = [250.0],  # noqa: B006
    vehicles: Annotated[list[int], typer.Option(min=1, help="In one process, and in as many.")] = [1],  # noqa: B006
    observer: Observer = "sliding_mode",
    duration: Duration = 20.0,
    repeat: Repeat = 5,
    out: Out = None,
) -> None:
    """How many times real time the graph flies in lock-step, beside the closed loop without ROS."""
    from quadftc_tools.bench.lockstep import forms, measure_lockstep
    from quadftc_tools.bench.lockstep_table import lockstep_table

    results: list[dict[str, Any]] = []
    with StopSignals() as stop, _bars() as bars:
        for each, count in itertools.product(rate, vehicles):
            scenario = _scenario(observer, duration, each)
            bar = bars.add_task(f"{each:g} Hz, vehicles: {count}", total=repeat * len(forms(count)))
            for _ in range(repeat):
                for form in forms(count):  # in turn, so that a busy machine is as bad for all
                    found = measure_lockstep(
                        scenario, scenario.scheme(None), form, count, lambda _: not stop.requested
                    )
                    if found is None:
                        raise typer.Exit(INTERRUPTED)
                    results.append(found)
                    bars.advance(bar)
                    bars.refresh()
    console().print(lockstep_table(results))
    _write(out, "lockstep", results)
    raise typer.Exit(GOOD)


@bench.command()
def step(out: Out = None) -> None:
    """What one step of each fault observer costs, for one vehicle in NumPy."""
    from quadftc_tools.bench.steps import step_costs

    table = Table("observer", box=SIMPLE_HEAD, title="one step [us], of batches of 250")
    for name in ("best", "median"):
        table.add_column(name, justify="right")
    results = list(step_costs())
    for item in results:
        table.add_row(item["observer"], f"{item['best_us']:.1f}", f"{item['median_us']:.1f}")
    console().print(table)
    _write(out, "step", results)
    raise typer.Exit(GOOD)


@bench.command()
def batch(
    flights: Annotated[list[int], typer.Option(min=1, help="In each process.")] = [1, 64, 256, 1024],  # noqa: B006
    precision: Annotated[list[Precision], typer.Option(help="Of the batch engine.")] = list(Precision),  # noqa: B006
    cores: Annotated[
        list[int],
        typer.Option(min=1, help="So many processes, a core each. Default: one, and all there are."),
    ] = [],  # noqa: B006
    repeats: Annotated[int, typer.Option(min=1, help="How often each is measured.")] = 5,
    duration: Annotated[float, typer.Option(min=0.1, help="Length of a flight [s].")] = 8.0,
    others: Annotated[
        str | None, typer.Option(help="Python with crazyflow and RotorPy; default: the one that runs this.")
    ] = None,
    out: Out = None,
) -> None:
    """Closed-loop steps per second of the batch engine, beside other simulators."""
    from quadftc_tools.bench.batch import measure, measurements, python_of, usable_cores
    from quadftc_tools.bench.batch_table import batch_table, flight_lines, ratio_lines, what_lines

    usable = len(usable_cores())
    if max(cores, default=1) > usable:
        raise RunError(f"--cores {max(cores)}: this process may use {usable}")
    python = python_of(others)
    chosen = sorted(set(cores)) or sorted({1, usable})
    single = [each is Precision.float32 for each in dict.fromkeys(precision)]
    plan = measurements(sorted(set(flights)), single, chosen, duration)
    results: list[dict[str, Any]] = []
    with StopSignals() as stop, _bars() as bars:
        bar = bars.add_task("", total=len(plan))
        for each in plan:
            bars.update(bar, description=each.title)
            bars.refresh()
            found = measure(each, repeats, python, lambda: stop.requested)
            if found is None:
                raise typer.Exit(INTERRUPTED)
            results.append(found)
            bars.advance(bar)
        bars.refresh()
    screen = console()
    screen.print(batch_table(results))
    for line in [*flight_lines(results), *ratio_lines(results), *what_lines(results)]:
        screen.print(line, markup=False, soft_wrap=True)
    _write(out, "batch", results)
    raise typer.Exit(GOOD)


def _scenario(observer: str, duration: float, rate: float) -> Scenario:
    loaded = with_duration(load_scenario(find_scenario(SCENARIO), [NO_DELAY]), duration)
    return with_observer(with_rate(loaded, rate), observer)


def _bars() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeRemainingColumn(),
        console=console(),
        auto_refresh=False,
    )


def _follower(bars: Progress, bar: Any, stopped: Callable[[], bool]) -> Callable[[int], bool]:
    def follow(samples: int) -> bool:
        bars.update(bar, completed=samples)
        return not stopped()

    return follow


def _write(out: Path | None, kind: str, results: list[dict[str, Any]]) -> None:
    """Print what it ran on; write all of it, if asked.

    Raises
    ------
    RunError
        If it cannot be written.
    """
    from quadftc_tools.bench.machine import machine

    what = machine()
    screen = console()
    screen.print(
        f"{what['processor']}, {what['usable_cores']} of {what['cores']} cores,"
        f" load {what['load_average'][0]:.2f}, a calculation took {what['slowness']['p50']:.2f} (p90"
        f" {what['slowness']['p90']:.2f}) times its best; "
        + ", ".join(f"{name} {version}" for name, version in what["versions"].items()),
        soft_wrap=True,
    )
    if out is None:
        return
    try:
        out.mkdir(parents=True, exist_ok=True)
        path = out / f"{kind}.json"
        text = json.dumps({"machine": what, "results": results}, indent=2, allow_nan=False)
        path.write_text(text + "\n", encoding="utf-8")
        screen.print(f"written: {path}", markup=False, soft_wrap=True)
        if kind in ("latency", "batch"):
            from quadftc_tools.bench.bench_figures import batch_figure, latency_figure

            draw = latency_figure if kind == "latency" else batch_figure
            screen.print(f"written: {draw(results, out)}", markup=False, soft_wrap=True)
    except OSError as error:
        raise RunError(f"{out}: {error.strerror}") from None
