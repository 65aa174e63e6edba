"""``quadftc live``: a flight in real time, and its picture in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from quadftc_cli.commands.options import EngineOption
from quadftc_cli.commands.run import CoreOption, PriorityOption, WaitOption


def live(
    scenario: Annotated[
        str, Option(help="Scenario to fly: its faults, its reference; default: hover, and sliders.")
    ] = "",
    scheme: Annotated[str, Option(help="Scheme of the scenario; default: its first.")] = "",
    vehicle: Annotated[
        str, Option(help="Vehicle: a name or a TOML file; default: that of the scenario.")
    ] = "",
    stand: Annotated[bool, Option("--stand", help="On a test stand, with sliders for the attitude.")] = False,
    sliders: Annotated[bool, Option("--sliders", help="Follow sliders, not the scenario.")] = False,
    rate: Annotated[str, Option(help="Control rate, such as 500 or '500 Hz'.")] = "",
    duration: Annotated[float, Option(min=0.0, help="Length of the flight [s]; 0: until Ctrl-C.")] = 0.0,
    record: Annotated[Path | None, Option(metavar="DIR", help="Bag to write; must not exist.")] = None,
    attach: Annotated[
        bool,
        Option("--attach", help="Fly nothing: show the graph that runs already, on a real vehicle, too."),
    ] = False,
    bag: Annotated[
        Path | None,
        Option(metavar="BAG", help="Fly nothing: play a recorded flight, its bag or the folder of it."),
    ] = None,
    speed: Annotated[
        float, Option(min=0.1, max=100.0, help="Of the recorded flight, as a multiple of real time.")
    ] = 1.0,
    namespace: Annotated[str, Option(help="ROS namespace of the vehicle.")] = "",
    port: Annotated[int, Option(min=0, max=65535, help="Port on 127.0.0.1; 0: any that is free.")] = 8348,
    browser: Annotated[bool, Option(help="Open the page in the browser.")] = True,
    wait: WaitOption = "sleep",
    realtime_priority: PriorityOption = 0,
    core: CoreOption = [],  # noqa: B006
    engine: EngineOption = "c",
) -> None:
    """Fly in real time, or play a recording, and show it in the browser: 3D, charts, states, faults.

    Only you can use the page, by the address that is printed. Ctrl-C ends flight and page.
    """
    from quadftc_cli.live_page.flying import Wish, fly_live, show_running  # with what it needs, a second

    how = (wait, realtime_priority, tuple(core))
    wish = Wish(scenario, scheme, vehicle, stand, sliders, rate, duration, record, namespace, engine)
    chosen = any((scenario, scheme, vehicle, stand, sliders, rate, duration, record))
    if bag is not None:
        if chosen or attach:
            raise ValueError(
                "--bag: plays what has flown; only --speed, --namespace, --port, --browser go with it"
            )
        from quadftc_cli.live_page.server import show_recorded

        return show_recorded(bag, speed, namespace, port, browser)
    if speed != 1.0:
        raise ValueError("--speed: belongs to --bag")
    if not attach:
        raise typer.Exit(fly_live(wish, port, browser, how))
    if chosen:
        raise ValueError("--attach: shows what flies already; only --namespace, --port, --browser go with it")
    raise typer.Exit(show_running(namespace, port, browser))
