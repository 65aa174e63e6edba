# pyright: basic
"""The ``quadftc`` command.

Exit codes: 0 good, 1 a check of a scenario failed, 2 bad input, 3 internal error, 130 interrupted.
"""

from __future__ import annotations

import enum
import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

# this machine only, unless asked otherwise; read when ROS starts, so before any of its modules
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

from quadftc_bench.bags import BagError
from quadftc_bench.catalogue import catalogue_table, kinds
from quadftc_bench.doctor import examine
from quadftc_bench.graph_plan import GraphError
from quadftc_bench.play import play as play_bag
from quadftc_bench.run import RunError, RunOptions, prepare, run_name
from quadftc_bench.run import run as run_scenario
from quadftc_bench.scenario import (
    Scenario,
    ScenarioError,
    Scheme,
    find_scenario,
    load_scenario,
    with_controller,
    with_disturbance_observer,
    with_observer,
)
from quadftc_bench.tables import console, failed_checks, run_table
from quadftc_ros.executor import StopSignals

STRIDE = 0.005  # share of a flight between two looks of the progress bar
GOOD, CHECK_FAILED, BAD_INPUT, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 130

app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None
)


class Graph(str, enum.Enum):
    """Where the nodes run."""

    composed = "composed"
    processes = "processes"


class Mode(str, enum.Enum):
    """What drives the flight."""

    lockstep = "lockstep"
    realtime = "realtime"


@app.callback()
def _root() -> None:
    """Fault-tolerant attitude control for multirotors: fly scenarios, record, judge."""


@app.command()
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
    out: Annotated[Path, typer.Option(help="Directory of the runs.")] = Path("results"),
    force: Annotated[bool, typer.Option("--force", help="Replace earlier runs of the same name.")] = False,
) -> None:
    """Fly scenarios through the node graph; write a bag and a summary for each run."""
    overrides = [*set_, *([f"rate={rate}"] if rate else []), *([f"seed={seed}"] if seed else [])]
    jobs: list[tuple[Scenario, Scheme]] = []
    for name in scenarios:
        loaded = load_scenario(find_scenario(name), overrides)
        for change, kind in (
            (with_observer, observer),
            (with_disturbance_observer, disturbance_observer),
            (with_controller, controller),
        ):
            loaded = change(loaded, kind) if kind else loaded
        chosen = list(loaded.schemes) if scheme == "all" else [loaded.scheme(scheme or None).name]
        jobs += [(loaded, loaded.scheme(each)) for each in chosen]
    names = [run_name(*job) for job in jobs]
    if len(set(names)) < len(names):
        raise RunError(
            f"{next(n for n in names if names.count(n) > 1)}: asked for twice; give scenarios other names"
        )
    prepare(out, names, force)
    raise typer.Exit(_run_all(jobs, out, RunOptions(graph.value, mode.value, namespace, force)))


def _run_all(jobs: list[tuple[Scenario, Scheme]], out: Path, options: RunOptions) -> int:
    screen = console()
    summaries: list[dict[str, Any]] = []
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with StopSignals() as stop, Progress(*columns, console=screen) as bars:
        for scenario, scheme in jobs:
            bar = bars.add_task(run_name(scenario, scheme), total=1.0)
            result = run_scenario(scenario, scheme, out, options, _follower(bars, bar, stop))
            if result is None:
                screen.print(f"interrupted; what was flown is in {out / run_name(scenario, scheme)}")
                return INTERRUPTED
            bars.update(bar, completed=1.0)
            summaries.append(result)
    screen.print(run_table(summaries, screen))
    for line in failed_checks(summaries):
        screen.print(f"[red]FAILED[/] {line}")
    screen.print(f"bags and summaries: {out}")
    return GOOD if all(item["passed"] for item in summaries) else CHECK_FAILED


def _follower(bars: Progress, bar: TaskID, stop: StopSignals) -> Callable[[float], bool]:
    """Return what moves a bar, in strides, as it is called for every message, until a signal comes."""
    shown = 0.0

    def follow(share: float) -> bool:
        nonlocal shown
        if share - shown > STRIDE:
            bars.update(bar, completed=share)
            shown = share
        return not stop.requested

    return follow


@app.command()
def play(
    bag: Annotated[Path, typer.Argument(help="A rosbag2 directory, or an .mcap file.")],
    rate: Annotated[float, typer.Option(help="Speed, as a multiple of the recorded one.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    topic: Annotated[list[str], typer.Option(help="Only this topic; may be repeated.")] = [],  # noqa: B006
    delay: Annotated[
        float, typer.Option(help="Seconds from making the publishers to the first message.")
    ] = 1.0,
) -> None:
    """Publish a bag on the live graph, with the recorded timing."""
    count = play_bag(bag, rate, loop=loop, topics=topic or None, delay=delay)
    console().print(f"{count} messages published")


@app.command("list")
def list_(
    kind: Annotated[str, typer.Argument(help=" | ".join(kinds()) + "; default: all")] = "",
) -> None:
    """Show what there is, with parameters, units and defaults."""
    for each in [kind] if kind else kinds():
        console().print(catalogue_table(each))


@app.command()
def doctor() -> None:
    """Check the installation; say what is missing and how to mend it."""
    findings = examine()
    screen = console()
    for finding in findings:
        mark = "[green]good[/]" if finding.good else "[red]BAD [/]"
        screen.print(f"{mark} {finding.part}: {finding.what}")
        if not finding.good:
            screen.print(f"     {finding.mend}")
    raise typer.Exit(GOOD if all(finding.good for finding in findings) else CHECK_FAILED)


def main() -> None:
    """Run the command; turn every error into a line and an exit code."""
    sys.exit(_guarded(sys.argv[1:]))


def _guarded(arguments: list[str]) -> int:
    screen = console(stderr=True)
    try:
        result = app(arguments or ["--help"], standalone_mode=False)
        return result if isinstance(result, int) else GOOD
    except typer.TyperException as error:
        words = error.format_message() if hasattr(error, "format_message") else str(error)
        screen.print(f"error: {words}", markup=False, soft_wrap=True)
        return BAD_INPUT
    except (ScenarioError, BagError, RunError, ValueError) as error:
        for line in str(error).splitlines():
            screen.print(f"error: {line}", markup=False, soft_wrap=True)
        return BAD_INPUT
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except GraphError as error:
        screen.print(f"error: {error}", markup=False, soft_wrap=True)
        return INTERNAL
    except Exception as error:
        screen.print(f"internal error: {type(error).__name__}: {error}", markup=False, soft_wrap=True)
        if os.environ.get("QUADFTC_DEBUG"):
            traceback.print_exc()
        else:
            screen.print("set QUADFTC_DEBUG=1 to see where", markup=False)
        return INTERNAL


if __name__ == "__main__":
    main()
