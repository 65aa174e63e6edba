# pyright: basic
"""``quadftc sitl --live``: the page of a flight of an autopilot's firmware."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from quadftc_cli.live_page.feed import Feed, Flown
from quadftc_cli.live_page.flying import serving
from quadftc_cli.screen import say
from quadftc_sitl.live import Live
from quadftc_sitl.plan import SitlPlan


@contextmanager
def showing(plan: SitlPlan, port: int, opens: bool) -> Iterator[Live]:
    """Serve the page of a flight, and open it in a browser if asked for; yields how the flight is shown."""
    scenario, observer = plan.scenario, plan.scheme.observer.kind
    parts = f"{Path(scenario.vehicle).stem}, observer {observer}, flown by {plan.autopilot.title}"
    title, parts = scenario.description or scenario.name, f"{parts}, {plan.rate:g} Hz"
    flown = Flown(title, parts, scenario.vehicle, "free_flight")
    with serving(port, [flown], opens) as (channel, address, stop):
        feed = Feed(channel, "", "free_flight")
        say(f"{title}: {parts}", f"page:   {address}", stderr=True)
        yield Live(stop, lambda line: say(line, stderr=True), feed.tap, feed.beat)
