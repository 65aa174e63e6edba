# pyright: basic
"""Flying the scenarios of ``quadftc run``: what is asked for, through the graph or the loop, into tables."""

from __future__ import annotations

import functools
import importlib.util
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from quadftc_cli.commands import INTERRUPTED
from quadftc_cli.judging import judge
from quadftc_cli.metric_table import diagnosis_table, fitting, heading, text
from quadftc_cli.screen import Bars, console, plain_table
from quadftc_flight.checks import refuse_wrong_checks
from quadftc_flight.loop_run import run_loop
from quadftc_flight.loss import command_up_to_loss, loss_story, lost_at
from quadftc_flight.run_directory import read_run
from quadftc_flight.run_files import RunError, prepare, run_name, write_summary
from quadftc_flight.scenario import (
    Scenario,
    Scheme,
    find_scenario,
    label_of,
    load_scenario,
    relabelled,
    with_components,
    with_duration,
)
from quadftc_flight.summary import Summary, relate_to_undiagnosed
from quadftc_model.samples import AXES
from quadftc_ros.scheduling import ORDINARY, Scheduling

if TYPE_CHECKING:
    from quadftc_flight.runs import RunOptions

# metrics (dotted path below "metrics") of each axis; where there is no room, the last go first
COLUMNS = (
    "tracking_rmse_deg",
    "fault_windows.0.tracking_mean_deg",
    "fault_windows.0.fault_estimate_settling_s",
    "fault_estimate_max_settled_deg",
    "tracking_max_deg",
    "torque_total_variation",
)

# names of scenarios, scheme, overrides, gains, components by role, label, where to end [s]
What = tuple[Sequence[str], str, Sequence[str], str, Mapping[str, str], str, float]
Job = tuple[Scenario, Scheme]
LOOP = "loop"  # in place of a graph: in this process, without ROS
# graph, mode, namespace, whether to replace, what `Scheduling` takes, and the engine
How = tuple[str, str, str, bool, tuple[str, int, tuple[int, ...]], str]


def fly_named(what: What, out: Path, how: How, jobs: int | None, junit: Path | None) -> int:
    """Fly the schemes of scenarios, so many side by side, and return the exit code."""
    names, scheme, overrides, gains, parts, label, until = what
    graph, mode, namespace, force, scheduling, engine = how
    graph = graph or ("composed" if importlib.util.find_spec("rclpy") else LOOP)
    if graph == LOOP and (mode == "realtime" or namespace or Scheduling(*scheduling) != ORDINARY):
        raise ValueError("--graph loop: flies in lock-step; real time and namespaces need ROS 2")
    flights: list[tuple[Scenario, Scheme]] = []
    for name in names:
        plain = load_scenario(find_scenario(name), overrides, gains)
        loaded = with_components(plain, **parts)
        loaded = with_duration(loaded, until) if until < loaded.duration else loaded
        chosen = list(loaded.schemes) if scheme == "all" else [loaded.scheme(scheme or None).name]
        for each in chosen:
            given = f"{each}-{label}" if label and len(chosen) > 1 else label
            flights.append(relabelled(loaded, each, given or label_of(loaded, each, plain)))
    runs = [run_name(*job) for job in flights]
    if len(set(runs)) < len(runs):
        twice = next(name for name in runs if runs.count(name) > 1)
        raise RunError(f"{twice}: asked for twice; give scenarios other names")
    if graph == LOOP:
        return fly_loops(flights, out, engine, force, junit)
    from quadftc_flight.runs import RunOptions

    options = RunOptions(graph, mode, namespace, force, Scheduling(*scheduling), engine)
    workers = 1 if mode == "realtime" else min(jobs or len(os.sched_getaffinity(0)), len(flights))
    return fly_jobs(flights, out, options, workers, junit)


def fly_loops(jobs: list[Job], out: Path, engine: str, force: bool, junit: Path | None = None) -> int:
    """Fly scenarios with their schemes in this process, without ROS; else as `fly_jobs`."""
    for scenario, _ in jobs:
        refuse_wrong_checks(scenario)
    names, screen, summaries = [run_name(*job) for job in jobs], console(), list[Summary]()
    prepare(out, names, force)
    with Bars(screen) as bars:
        for name, job in zip(names, jobs, strict=True):
            update = bars.add(name)
            summaries.append(run_loop(*job, out, engine))
            update(1.0)
    return show_runs(summaries, out, screen, junit)


def fly_jobs(jobs: list[Job], out: Path, how: RunOptions, workers: int = 1, junit: Path | None = None) -> int:
    """Fly scenarios with their schemes, show what came out, and return the exit code.

    ``junit``: the file that gets the checks as JUnit XML.
    """
    from quadftc_flight.runs import run as run_scenario
    from quadftc_flight.side_by_side import run_side_by_side
    from quadftc_ros.executor import StopSignals

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
    return show_runs([result for result in results if result is not None], out, screen, junit)


def show_runs(summaries: list[Summary], out: Path, screen: Console, junit: Path | None) -> int:
    """Show what came out of the runs in a directory, and return the exit code."""
    for related in relate_to_undiagnosed(summaries):
        write_summary(out, related)
    _print_tables(summaries, screen)
    for item in summaries:
        if item["metrics"]["lost"]:
            _print_loss(item, out, screen)
        if (other := item.get("without_diagnosis")) and (ratio := other["attitude_error_max_deg_ratio"]):
            error = f"largest attitude error {ratio:.2g} times that of '{other['scheme']}'"
            screen.print(f"{item['name']}-{item['scheme']}: {error}")
    screen.print(f"bags and summaries: {out}")
    checks = {f"{item['name']}-{item['scheme']}": item["checks"] for item in summaries}
    return judge(checks, screen, junit, "run")


def _print_loss(item: Summary, out: Path, screen: Console) -> None:
    """Say when a flight was lost, what led there, and how to fly only up to there."""
    bag = out / item["bag"]
    flight = read_run(bag).flight
    screen.print(f"[red]LOST[/] {item['name']}-{item['scheme']}: {loss_story(flight)}", markup=True)
    if lost_at(flight) is not None:
        bare = "; add --observer none for that without diagnosis" * (item["observer"] != "none")
        screen.print(f"  up to there alone{bare}:")
        screen.print(f"  {command_up_to_loss(flight, bag, item['scheme'])}", soft_wrap=True)


def _print_tables(summaries: Sequence[Summary], screen: Console) -> None:
    """Print what became of each axis, in as many columns as there is room for, and of the faults if any."""
    tables = (_narrow_table(summaries, count) for count in range(len(COLUMNS), 0, -1))
    screen.print(fitting(tables, screen))
    if any(item["metrics"]["diagnosis"]["fault_count"] for item in summaries):
        named = {f"{item['name']}-{item['scheme']}": item["metrics"] for item in summaries}
        screen.print(diagnosis_table(named, screen))


def _narrow_table(summaries: Sequence[Summary], count: int) -> Table:
    """Table of runs, a row for each axis of each, with the first ``count`` columns."""
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
