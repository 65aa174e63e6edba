"""``quadftc check``."""

from __future__ import annotations

from typing import Annotated

import typer
from typer import Argument, Option

from quadftc_cli.commands import CHECK_FAILED, options


def check(
    target: Annotated[
        str,
        Argument(
            metavar="SCENARIO|BAG|VEHICLE",
            help="Scenario or vehicle (file or name), or a recorded run, with Lyapunov functions along it.",
            autocompletion=options.complete_scenario,
        ),
    ],
    scheme: Annotated[str, Option(help="Scheme to judge; default: the scenario's first.")] = "",
    observer: options.ObserverOption = "",
    disturbance_observer: options.DisturbanceObserverOption = "",
    controller: options.ControllerOption = "",
    set_: options.SetOption = [],  # noqa: B006
    gains: options.GainsOption = "",
    isolability: Annotated[
        bool, Option("--isolability", help="Instead: which faults can be detected and told apart.")
    ] = False,
    sensors: Annotated[
        str, Option(help="The same, by some sensors: names, by comma.", show_default="attitude,gyro")
    ] = "",
    as_json: Annotated[bool, Option("--json", help="For machines.")] = False,
) -> None:
    """Say where the theory holds: one line for each condition, with its numbers.

    Of a vehicle (VEHICLE.toml, or a name of quadftc list vehicles), a page: hover, authority, time constants,
    a plan of its rotors, warnings.
    """
    from quadftc_cli.checking import check_target  # with what it needs, over a second

    parts = {"observer": observer, "disturbance_observer": disturbance_observer, "controller": controller}
    instead = (sensors or "attitude,gyro") if isolability or sensors else None
    if not check_target(target, scheme, parts, (set_, gains), instead, as_json):
        raise typer.Exit(CHECK_FAILED)
