# pyright: basic
"""``quadftc watch``: a vehicle that flies, live in the terminal."""

from __future__ import annotations

import contextlib
import time
from functools import partial
from typing import Annotated

from rich.live import Live
from typer import Option

from quadftc_cli.commands.inject import NamespaceOption
from quadftc_cli.screen import console, say

REDRAW = 0.25  # s; between two pictures
LINE = 1.0  # s; between two lines, where there is no terminal
FIRST = 2.0  # s; for the first samples to come


def watch(
    namespace: NamespaceOption = "",
    duration: Annotated[float, Option(help="Seconds to watch; 0: until Ctrl-C.")] = 0.0,
    once: Annotated[bool, Option("--once", help="Print one line and end.")] = False,
) -> None:
    """Show a vehicle that flies: attitudes, faults and their estimates with curves, what warns.

    On a terminal a picture that is redrawn, elsewhere a line each second.
    """
    from quadftc_cli.live import AUTOPILOTS, CONTROLLER, OBSERVER, LiveGraph  # starts ROS
    from quadftc_cli.view import TOPICS, View

    with LiveGraph(namespace) as graph, contextlib.suppress(KeyboardInterrupt):
        graph.choose_vehicle(CONTROLLER, *AUTOPILOTS, OBSERVER)
        view = View(graph.namespace or "vehicle")
        for topic in TOPICS:
            graph.listen(topic, lambda message, topic=topic: view.take(topic, message, time.monotonic()))
        graph.until(partial(_begun, view), FIRST)
        end = time.monotonic() + duration if duration > 0.0 else float("inf")
        screen = console()
        if once or not screen.is_terminal:
            say(view.line(time.monotonic()))
            while not once and time.monotonic() + LINE <= end:
                graph.spin(LINE)
                say(view.line(time.monotonic()))
            return
        with Live(view.page(time.monotonic()), console=screen, auto_refresh=False, screen=True) as live:
            while time.monotonic() < end:
                graph.spin(REDRAW)
                live.update(view.page(time.monotonic()), refresh=True)


def _begun(view: object) -> bool:
    now = time.monotonic()
    return all(view.present(topic, now) is not None for topic in ("imu/data", "diagnosis", "/diagnostics"))  # type: ignore[attr-defined]
