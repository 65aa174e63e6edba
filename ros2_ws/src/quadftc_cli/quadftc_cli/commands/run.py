# pyright: basic
"""``quadftc run``."""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.table import Table
from typer import Argument, Option

from quadftc_cli.commands import CHECK_FAILED, GOOD, INTERRUPTED, options
from quadftc_cli.metric_table import diagnosis_table, fitting, heading, text
from quadftc_cli.screen import Bars, console, plain_table
from quadftc_flight.runs import RunError, RunOptions, prepare, run_name, write_summary
from quadftc_flight.runs import run as run_scenario
from quadftc_flight.scenario import (
    Scenario,
    Scheme,
    find_scenario,
    label_of,
    load_scenario,
    relabelled,
    with_components,
)
from quadftc_flight.side_by_side import run_side_by_side
from quadftc_flight.summary import refuse_wrong_checks, relate_to_undiagnosed
from quadftc_model.samples import AXES
from quadftc_ros.executor import StopSignals
from quadftc_ros.scheduling import Scheduling

# metrics (dotted path below "metrics") of each axis; where there is no room, the last go first
COLUMNS = (
    "tracking_rmse_deg",
    "fault_windows.0.tracking_mean_deg",
    "fault_windows.0.fault_estimate_settling_s",
    "fault_estimate_max_settled_deg",
    "tracking_max_deg",
    "torque_total_variation",
)

GraphOption = Annotated[
    Literal["composed", "processes"], Option(help="All nodes in one process, or a process each.")
]
WaitOption = Annotated[
    Literal["sleep", "poll"],
    Option(help="Real time, between samples: sleep, or poll, which is faster and takes a whole core."),
]
PriorityOption = Annotated[
    int, Option("--realtime-priority", metavar="1-99", help="Real time: priority of SCHED_RR, if permitted.")
]
CoreOption = Annotated[list[int], Option(help="Real time: processor core to run on; may be repeated.")]


def run(
    scenarios: Annotated[list[str], Argument(help="Scenario files, or names (see: quadftc list scenarios).")],
    scheme: Annotated[str, Option(help="Scheme to fly, or 'all'; default: the scenario's first.")] = "",
    observer: options.ObserverOption = "",
    disturbance_observer: options.DisturbanceObserverOption = "",
    controller: options.ControllerOption = "",
    mode: Annotated[
        Literal["lockstep", "realtime"],
        Option(help="lockstep: as fast as it goes; realtime: by the wall clock."),
    ] = "lockstep",
    graph: GraphOption = "composed",
    namespace: Annotated[str, Option(help="ROS namespace of the vehicle.")] = "",
    rate: Annotated[str, Option(help="Control rate, such as 500 or '500 Hz'.")] = "",
    seed: Annotated[str, Option(help="Seed of the random numbers.")] = "",
    set_: options.SetOption = [],  # noqa: B006
    gains: options.GainsOption = "",
    label: Annotated[
        str, Option(help="What to call the scheme in names and reports; default: by its parts that differ.")
    ] = "",
    out: Annotated[Path, Option(help="Directory of the runs.")] = Path("results"),
    wait: WaitOption = "sleep",
    realtime_priority: PriorityOption = 0,
    core: CoreOption = [],  # noqa: B006
    force: Annotated[bool, Option("--force", help="Replace earlier runs of the same name.")] = False,
    jobs: Annotated[
        int | None, Option(min=1, help="Lock-step flights side by side; default: one for each core.")
    ] = None,
) -> None:
    """Fly scenarios through the node graph; write a bag and a summary for each run."""
    overrides = [*set_, *([f"rate={rate}"] if rate else []), *([f"seed={seed}"] if seed else [])]
    parts = {"observer": observer, "disturbance_observer": disturbance_observer, "controller": controller}
    how = RunOptions(graph, mode, namespace, force, Scheduling(wait, realtime_priority, tuple(core)))
    flights: list[tuple[Scenario, Scheme]] = []
    for name in scenarios:
        plain = load_scenario(find_scenario(name), overrides, gains)
        loaded = with_components(plain, **parts)
        chosen = list(loaded.schemes) if scheme == "all" else [loaded.scheme(scheme or None).name]
        for each in chosen:
            given = f"{each}-{label}" if label and len(chosen) > 1 else label
            flights.append(relabelled(loaded, each, given or label_of(loaded, each, plain)))
    names = [run_name(*job) for job in flights]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise RunError(f"{twice}: asked for twice; give scenarios other names")
    workers = 1 if mode == "realtime" else min(jobs or len(os.sched_getaffinity(0)), len(flights))
    raise typer.Exit(fly_jobs(flights, out, how, workers))


def fly_jobs(jobs: list[tuple[Scenario, Scheme]], out: Path, how: RunOptions, workers: int = 1) -> int:
    """Fly scenarios with their schemes, show what came out, and return the exit code."""
    for scenario, _ in jobs:
        refuse_wrong_checks(scenario)
    names, screen = [run_name(*job) for job in jobs], console()
    prepare(out, names, how.force)
    with StopSignals() as stop, Bars(screen, still=how.mode == "realtime") as bars:
        updates = [bars.add(name) for name in names]

        def follow(number: int, share: float) -> bool:
            updates[number](share)
            return not stop.requested

        if workers > 1:
            results = run_side_by_side(jobs, out, how, workers, follow)
        else:
            shows = [functools.partial(follow, number) for number in range(len(jobs))]
            results = [run_scenario(*job, out, how, show) for job, show in zip(jobs, shows, strict=True)]
    if stop.requested:
        screen.print(f"interrupted; what was flown is in {out}")
        return INTERRUPTED
    summaries = [result for result in results if result is not None]
    for related in relate_to_undiagnosed(summaries):
        write_summary(out, related)
    _print_tables(summaries, screen)
    for item in summaries:
        if item["metrics"]["lost"]:
            screen.print(f"[red]LOST[/] {item['name']}-{item['scheme']}: tilted or off by more than 60 deg")
        if (other := item.get("without_diagnosis")) and (ratio := other["attitude_error_max_deg_ratio"]):
            error = f"largest attitude error {ratio:.2g} times that of '{other['scheme']}'"
            screen.print(f"{item['name']}-{item['scheme']}: {error}")
        for check in (check for check in item["checks"] if not check["passed"]):
            what = f"{check['metric']} {check['axis'] or ''}".rstrip()
            value = f"{_number(check['value'], 1.0, 4)}, required {check['bound']}"
            screen.print(f"[red]FAILED[/] {item['name']}-{item['scheme']}: {what} = {value}")
    screen.print(f"bags and summaries: {out}")
    return GOOD if all(item["passed"] for item in summaries) else CHECK_FAILED


def _print_tables(summaries: Sequence[Mapping[str, Any]], screen: Console) -> None:
    """Print what became of each axis, and of the faults if there were any."""
    screen.print(_run_table(summaries, screen))
    if any(item["metrics"]["diagnosis"]["fault_count"] for item in summaries):
        named = {f"{item['name']}-{item['scheme']}": item["metrics"] for item in summaries}
        screen.print(diagnosis_table(named, screen))


def _run_table(summaries: Sequence[Mapping[str, Any]], screen: Console) -> Table:
    """Table of runs: a row for each axis of each run, with as many columns as the screen has room for."""
    return fitting((_narrow_table(summaries, count) for count in range(len(COLUMNS), 0, -1)), screen)


def _narrow_table(summaries: Sequence[Mapping[str, Any]], count: int) -> Table:
    """Table with the first ``count`` columns."""
    table = plain_table(("run", "axis"), map(heading, COLUMNS[:count]))
    table.add_column("checks\npassed", no_wrap=True)
    for item in summaries:
        factor = item["real_time_factor"]
        first = (item["name"], f"  {item['scheme']}", "" if factor is None else f"  {factor:.1f} x real time")
        good, judged = sum(check["passed"] for check in item["checks"]), len(item["checks"])
        verdict = f"[{'green' if good == judged else 'red'}]{good} of {judged}[/]" if judged else "-"
        for words, axis in zip(first, AXES, strict=True):
            cells = [text(item["metrics"], path, axis) for path in COLUMNS[:count]]
            table.add_row(words, axis, *cells, verdict if axis == AXES[0] else "")
        table.add_section()
    return table


def _number(value: Any, scale: float, digits: int) -> str:
    return "-" if value is None else f"{scale * value:.{digits}f}"
