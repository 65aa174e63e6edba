# pyright: basic
"""``quadftc bench``."""

from __future__ import annotations

import enum
import itertools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from quadftc_cli.commands import GOOD, INTERRUPTED
from quadftc_cli.commands.run import CoreOption, GraphOption, PriorityOption
from quadftc_cli.screen import console, plain_table, say
from quadftc_flight.run_files import RunError
from quadftc_flight.scenario import (
    Scenario,
    find_scenario,
    load_scenario,
    with_components,
    with_duration,
    with_rate,
)
from quadftc_ros.executor import StopSignals
from quadftc_ros.scheduling import Scheduling

if TYPE_CHECKING:
    from quadftc_tools.bench.machine import Result

    Draw = Callable[[Sequence[Result], Path], Path]  # writes a figure into a folder

SCENARIO = "mems_faults"
NO_DELAY = "sensors.delay=0"  # the modelled delay of the sensor is no latency of the graph


class Runs(str, enum.Enum):
    """What runs the laws."""

    c = "c"
    numpy = "numpy"


bench = typer.Typer(
    help="Measure how fast it is, on this machine: each within two minutes.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # else units in brackets vanish from the help
)

Observer = Annotated[str, typer.Option(help="Fault observer.")]
Repeat = Annotated[int, typer.Option(min=1, help="How often; medians are shown.")]
Engines = Annotated[list[Runs], typer.Option("--engine", help="What runs the laws; several in turn.")]
Out = Annotated[Path | None, typer.Option(help="Directory for the results: JSON, and a figure of latencies.")]


@bench.command()
def latency(
    rate: Annotated[list[float], typer.Option(help="Control rates [Hz].")] = [250.0, 500.0, 1000.0],  # noqa: B006
    graph: GraphOption = "composed",
    observer: Observer = "supervised",
    duration: Annotated[float, typer.Option(min=1.5, help="Length of a flight [s].")] = 20.0,
    repeat: Repeat = 1,
    record: Annotated[bool, typer.Option(help="Record a bag meanwhile.")] = True,
    engine: Engines = [Runs.c],  # noqa: B006
    wait: Annotated[
        Literal["sleep", "poll"] | None,
        typer.Option(help="Between samples; default: poll, where it is possible."),
    ] = None,
    realtime_priority: PriorityOption = 0,
    core: CoreOption = [],  # noqa: B006
    out: Out = None,
) -> None:
    """From the stamp of an IMU sample to its torque, stage by stage, in real time: a bit over a minute."""
    from quadftc_tools.bench import latency as part

    if wait is None:
        wait = "sleep" if graph == "processes" or realtime_priority else "poll"
    scheduling = Scheduling(wait, realtime_priority, tuple(core))
    forms = {each: part.LatencyOptions(graph, record, each, scheduling) for each in _values(engine)}
    results: list[Result] = []
    with StopSignals() as stop, _bars() as bars:
        for each, number, runs in itertools.product(rate, range(repeat), forms):
            scenario = _scenario(observer, duration, each)
            bar = bars.add_task(f"{each:g} Hz, {runs}, {number + 1} of {repeat}", total=duration * each)
            bars.refresh()  # not in flight: drawing would take milliseconds from it

            def follow(samples: int, bar: TaskID = bar) -> bool:
                bars.update(bar, completed=samples)
                return not stop.requested

            found = part.measure_latency(scenario, scenario.scheme(None), forms[runs], follow)
            results.append(_unless_stopped(found))
            bars.refresh()
    for each, runs in itertools.product(rate, forms):
        of_rate = [item for item in results if (item["rate"], item["engine"]) == (each, runs)]
        console().print(part.latency_table(of_rate))
        say(*map(part.counts_line, of_rate), part.usage_line(of_rate))
    _finish(out, "latency", results, part.latency_figure)


@bench.command()
def lockstep(
    rate: Annotated[list[float], typer.Option(help="Control rates [Hz].")] = [250.0],  # noqa: B006
    scenario: Annotated[str, typer.Option(help="Scenario to fly, by its first scheme.")] = SCENARIO,
    observer: Observer = "sliding_mode",
    engine: Engines = [Runs.c, Runs.numpy],  # noqa: B006
    duration: Annotated[float, typer.Option(min=0.5, help="Length of a flight [s].")] = 10.0,
    repeat: Repeat = 3,
    out: Out = None,
) -> None:
    """How many times real time the graph flies in lock-step, beside the closed loop without ROS: a minute."""
    from quadftc_tools.bench.lockstep import forms, lockstep_table, measure_lockstep

    results: list[Result] = []
    with StopSignals() as stop, _bars() as bars:
        for each in rate:
            flown = _scenario(observer, duration, each, scenario)
            chosen = forms(_values(engine))
            bar = bars.add_task(f"{each:g} Hz", total=repeat * len(chosen))
            # all forms in turn, so that a busy machine is as bad for all
            for _, form in itertools.product(range(repeat), chosen):
                found = measure_lockstep(flown, flown.scheme(None), *form, lambda _: not stop.requested)
                results.append(_unless_stopped(found))
                bars.advance(bar)
                bars.refresh()
    console().print(lockstep_table(results))
    _finish(out, "lockstep", results)


@bench.command()
def step(
    batches: Annotated[int, typer.Option(min=1, help="How often 250 steps are timed.")] = 20,
    engine: Engines = [Runs.c],  # noqa: B006
    only: Annotated[list[str], typer.Option(help="Only laws of this name; may be repeated.")] = [],  # noqa: B006
    docs: Annotated[
        Path | None, typer.Option(help="Directory of performance.md; its table is renewed.")
    ] = None,
    out: Out = None,
) -> None:
    """What one step of each law costs, for one vehicle, and in C what it takes to compile: a minute."""
    from quadftc_tools.bench.step import STEP_HEADS, cases, step_costs, step_rows
    from quadftc_tools.study.page import markdown, write_tables

    if lost := sorted(set(only) - {case.law for case in cases()}):
        raise RunError(f"--only {lost[0]}: no such law")
    results = [item for each in _values(engine) for item in step_costs(each, batches, only)]
    rows = step_rows(results)
    table = plain_table(STEP_HEADS[:1], STEP_HEADS[1:], "one step, processor time")
    for row in rows:
        table.add_row(*row)
    console().print(table)
    if docs is not None:
        write_tables(docs / "performance.md", {"law-costs": markdown(STEP_HEADS, rows)})
    _finish(out, "step", results)


def _scenario(observer: str, duration: float, rate: float, name: str = SCENARIO) -> Scenario:
    loaded = with_duration(load_scenario(find_scenario(name), [NO_DELAY]), duration)
    return with_components(with_rate(loaded, rate), observer=observer)


def _values(engines: list[Runs]) -> list[str]:
    return [each.value for each in dict.fromkeys(engines)]


def _bars() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console(), auto_refresh=False)


def _unless_stopped(result: Result | None) -> Result:
    """Return a result; end the command if there is none, as the user has stopped it."""
    if result is None:
        raise typer.Exit(INTERRUPTED)
    return result


def _finish(out: Path | None, kind: str, results: list[Result], draw: Draw | None = None) -> None:
    """Print what it ran on; write all of it, if asked; end with the exit code."""
    from quadftc_tools.bench.machine import machine

    what = machine()
    slow = what["slowness"]
    say(
        f"{what['processor']}, {what['usable_cores']} of {what['cores']} cores,"
        f" load {what['load_average'][0]:.2f}, a calculation took {slow['p50']:.2f} (p90"
        f" {slow['p90']:.2f}) times its best; "
        + ", ".join(f"{name} {version}" for name, version in what["versions"].items())
    )
    if out is None:
        raise typer.Exit(GOOD)
    try:
        out.mkdir(parents=True, exist_ok=True)
        path = out / f"{kind}.json"
        text = json.dumps({"machine": what, "results": results}, indent=2, allow_nan=False)
        path.write_text(text + "\n", encoding="utf-8")
        say(*(f"written: {each}" for each in (path, *([] if draw is None else [draw(results, out)]))))
    except OSError as error:
        raise RunError(f"{out}: {error.strerror}") from None
    raise typer.Exit(GOOD)
