# pyright: basic
"""``quadftc run``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from quadftc_cli.commands import options
from quadftc_model.units import quantity

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


def _end_of(until: str) -> float:
    """Return where flights end [s]; infinite: at their own end."""
    try:
        end = quantity(until or math.inf, "s")
    except ValueError as error:
        raise ValueError(f"--until: {error}") from None
    if not end > 0.0:
        raise ValueError(f"--until {until}: must be positive")
    return end


def run(
    scenarios: Annotated[
        list[str],
        Argument(
            help="Scenario files, or names (see: quadftc list scenarios).",
            autocompletion=options.complete_scenario,
        ),
    ],
    scheme: Annotated[str, Option(help="Scheme to fly, or 'all'; default: the scenario's first.")] = "",
    observer: options.ObserverOption = "",
    disturbance_observer: options.DisturbanceObserverOption = "",
    controller: options.ControllerOption = "",
    mode: Annotated[
        Literal["lockstep", "realtime"],
        Option(help="lockstep: as fast as it goes; realtime: by the wall clock."),
    ] = "lockstep",
    graph: Annotated[
        Literal["composed", "processes", "loop"] | None,
        Option(
            show_default=False,
            help="All nodes in one process, or a process each, or laws alone without ROS; default: composed"
            " where ROS 2 is installed.",
        ),
    ] = None,
    namespace: Annotated[str, Option(help="ROS namespace of the vehicle.")] = "",
    rate: Annotated[str, Option(help="Control rate, such as 500 or '500 Hz'.")] = "",
    seed: Annotated[str, Option(help="Seed of the random numbers.")] = "",
    set_: options.SetOption = [],  # noqa: B006
    until: Annotated[
        str, Option(help="End flights here, such as 8s: the same flights, without what is later.")
    ] = "",
    gains: options.GainsOption = "",
    label: Annotated[
        str, Option(help="What to call the scheme in names and reports; default: by its parts that differ.")
    ] = "",
    out: Annotated[Path, Option(help="Directory of the runs.")] = Path("results"),
    wait: WaitOption = "sleep",
    realtime_priority: PriorityOption = 0,
    core: CoreOption = [],  # noqa: B006
    engine: options.EngineOption = "c",
    force: Annotated[bool, Option("--force", help="Replace earlier runs of the same name.")] = False,
    jobs: Annotated[
        int | None, Option(min=1, help="Lock-step flights side by side; default: one for each core.")
    ] = None,
    junit: options.JunitOption = None,
) -> None:
    """Fly scenarios through the node graph, or without ROS; write a bag and a summary for each run.

    Exits with 1 if a check fails. A flight that is lost fails none by that.
    """
    from quadftc_cli.flying import fly_named  # with what it needs, a second

    overrides = [*set_, *([f"rate={rate}"] if rate else []), *([f"seed={seed}"] if seed else [])]
    parts = {"observer": observer, "disturbance_observer": disturbance_observer, "controller": controller}
    what = (scenarios, scheme, overrides, gains, parts, label, _end_of(until))
    how = (graph or "", mode, namespace, force, (wait, realtime_priority, tuple(core)), engine)
    raise typer.Exit(fly_named(what, out, how, jobs, junit))
