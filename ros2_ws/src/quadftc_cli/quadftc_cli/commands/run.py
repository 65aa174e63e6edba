# pyright: basic
"""``quadftc run``."""

from __future__ import annotations

import enum
import functools
import os
from pathlib import Path
from typing import Annotated

import typer

from quadftc_cli.commands import CHECK_FAILED, GOOD, INTERRUPTED
from quadftc_cli.commands.options import GainsOption
from quadftc_cli.progress import Bars
from quadftc_cli.tables import console, failed_checks, run_table
from quadftc_flight.runs import RunError, RunOptions, prepare, run_name
from quadftc_flight.runs import run as run_scenario
from quadftc_flight.scenario import (
    Scenario,
    Scheme,
    find_scenario,
    load_scenario,
    with_controller,
    with_disturbance_observer,
    with_observer,
)
from quadftc_flight.side_by_side import run_side_by_side
from quadftc_ros.executor import StopSignals
from quadftc_ros.scheduling import Scheduling


class Graph(str, enum.Enum):
    """Where the nodes run."""

    composed = "composed"
    processes = "processes"


class Mode(str, enum.Enum):
    """What drives the flight."""

    lockstep = "lockstep"
    realtime = "realtime"


class Wait(str, enum.Enum):
    """What a graph in real time does between samples."""

    sleep = "sleep"
    poll = "poll"


WaitOption = Annotated[
    Wait,
    typer.Option(help="Real time, between samples: sleep, or poll, which is faster and takes a whole core."),
]
PriorityOption = Annotated[
    int,
    typer.Option(
        "--realtime-priority", metavar="1-99", help="Real time: priority of SCHED_RR, if permitted."
    ),
]
CoreOption = Annotated[list[int], typer.Option(help="Real time: processor core to run on; may be repeated.")]


def run(
    scenarios: Annotated[
        list[str], typer.Argument(help="Scenario files, or names (see: quadftc list scenarios).")
    ],
    scheme: Annotated[str, typer.Option(help="Scheme to fly, or 'all'; default: the scenario's first.")] = "",
    observer: Annotated[str, typer.Option(help="Fault observer in place of the scheme's.")] = "",
    disturbance_observer: Annotated[
        str, typer.Option(help="Disturbance observer in place of the scheme's.")
    ] = "",
    controller: Annotated[str, typer.Option(help="Controller in place of the scheme's.")] = "",
    mode: Annotated[
        Mode, typer.Option(help="lockstep: as fast as it goes; realtime: by the wall clock.")
    ] = Mode.lockstep,
    graph: Annotated[
        Graph, typer.Option(help="All nodes in one process, or a process each.")
    ] = Graph.composed,
    namespace: Annotated[str, typer.Option(help="ROS namespace of the vehicle.")] = "",
    rate: Annotated[str, typer.Option(help="Control rate, such as 500 or '500 Hz'.")] = "",
    seed: Annotated[str, typer.Option(help="Seed of the random numbers.")] = "",
    set_: Annotated[
        list[str], typer.Option("--set", help="Any value of the scenario: a.b=v, faults.0.value='2 deg'.")
    ] = [],  # noqa: B006
    gains: GainsOption = "",
    out: Annotated[Path, typer.Option(help="Directory of the runs.")] = Path("results"),
    wait: WaitOption = Wait.sleep,
    realtime_priority: PriorityOption = 0,
    core: CoreOption = [],  # noqa: B006
    force: Annotated[bool, typer.Option("--force", help="Replace earlier runs of the same name.")] = False,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Lock-step flights side by side; default: one for each core.")
    ] = None,
) -> None:
    """Fly scenarios through the node graph; write a bag and a summary for each run."""
    overrides = [*set_, *([f"rate={rate}"] if rate else []), *([f"seed={seed}"] if seed else [])]
    scheduling = Scheduling(wait.value, realtime_priority, tuple(core))
    options = RunOptions(graph.value, mode.value, namespace, force, scheduling)
    flights: list[tuple[Scenario, Scheme]] = []
    for name in scenarios:
        loaded = load_scenario(find_scenario(name), overrides, gains)
        for change, kind in (
            (with_observer, observer),
            (with_disturbance_observer, disturbance_observer),
            (with_controller, controller),
        ):
            loaded = change(loaded, kind) if kind else loaded
        chosen = list(loaded.schemes) if scheme == "all" else [loaded.scheme(scheme or None).name]
        flights += [(loaded, loaded.scheme(each)) for each in chosen]
    names = [run_name(*job) for job in flights]
    if len(set(names)) < len(names):
        raise RunError(
            f"{next(n for n in names if names.count(n) > 1)}: asked for twice; give scenarios other names"
        )
    prepare(out, names, force)
    workers = 1 if mode is Mode.realtime else min(jobs or len(os.sched_getaffinity(0)), len(flights))
    raise typer.Exit(_run_all(flights, out, options, workers))


def _run_all(jobs: list[tuple[Scenario, Scheme]], out: Path, options: RunOptions, workers: int) -> int:
    screen = console()
    with StopSignals() as stop, Bars(screen, still=options.mode == "realtime") as bars:
        updates = [bars.add(run_name(*job)) for job in jobs]

        def follow(number: int, share: float) -> bool:
            updates[number](share)
            return not stop.requested

        if workers > 1:
            results = run_side_by_side(jobs, out, options, workers, follow)
        else:
            results = [
                run_scenario(*job, out, options, functools.partial(follow, number))
                for number, job in enumerate(jobs)
            ]
    if stop.requested:
        screen.print(f"interrupted; what was flown is in {out}")
        return INTERRUPTED
    summaries = [result for result in results if result is not None]
    screen.print(run_table(summaries, screen))
    for line in failed_checks(summaries):
        screen.print(f"[red]FAILED[/] {line}")
    screen.print(f"bags and summaries: {out}")
    return GOOD if all(item["passed"] for item in summaries) else CHECK_FAILED
