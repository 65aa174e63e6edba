# pyright: basic
"""``quadftc play``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from quadftc_bags.play import play as play_bag
from quadftc_cli.screen import say


def play(
    bag: Annotated[Path, Argument(help="A rosbag2 directory, or an .mcap file.")],
    rate: Annotated[float, Option(help="Speed, as a multiple of the recorded one.")] = 1.0,
    loop: Annotated[bool, Option("--loop", help="Begin again at the end.")] = False,
    topic: Annotated[list[str], Option(help="Only this topic; may be repeated.")] = [],  # noqa: B006
    delay: Annotated[float, Option(help="Seconds from making the publishers to the first message.")] = 1.0,
) -> None:
    """Publish a bag on the live graph, with the recorded timing."""
    count = play_bag(bag, rate, loop=loop, topics=topic or None, delay=delay)
    say(f"{count} messages published")
