# pyright: basic
"""``quadftc repair``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from quadftc_bags.repair import Repair
from quadftc_bags.repair import repair as repair_bag
from quadftc_bags.storage import Damage
from quadftc_cli.screen import console, plain_table, say


def repair(
    bag: Annotated[Path, Argument(metavar="BAG", help="A rosbag2 directory of one .mcap file, or the file.")],
    out: Annotated[
        Path | None, Option(metavar="DIR", help="The repaired bag; default: BAG-repaired, beside BAG.")
    ] = None,
    force: Annotated[
        bool, Option("--force", help="Replace DIR if it is there; without --out, replace BAG.")
    ] = False,
) -> None:
    """Make a bag that can be read whole of one that was cut short: killed recorder, full disk, power cut.

    Says what was kept and what was lost. A bag with which nothing is wrong is left as it is.
    """
    done = repair_bag(bag, out, force)
    topics = done.found.topics
    start_ns = min((tally.first_ns for tally in topics.values() if tally.count), default=0)
    table = plain_table(("topic", "type"), ("messages", "last [s]"))
    for name, tally in sorted(topics.items()):
        last = _seconds(tally.last_ns - start_ns) if tally.count else "-"
        table.add_row(name, tally.type_name, str(tally.count), last)
    console().print(table)
    say(*_lines(done, start_ns))


def _lines(done: Repair, start_ns: int) -> Iterator[str]:
    """Say what was kept and lost, and where the new bag is."""
    found = done.found
    last_ns = max(tally.last_ns for tally in found.topics.values())
    span = f", {_seconds(last_ns - start_ns)} s, last stamp {last_ns} ns" if found.message_count else ""
    if done.out is None:
        yield f"{found.path}: whole: {found.message_count} messages{span}; nothing to repair"
        return
    yield f"kept: {found.message_count} messages on {len(found.topics)} topics{span}"
    for damage in found.damages:
        yield _lost(damage, start_ns)
    if found.left_out:
        yield f"left out: {found.left_out} messages whose topic is not known"
    for topic, reason in found.refused.items():
        yield f"left out: topic '{topic}': {reason}"
    if not found.is_indexed and not found.damages:
        yield "rebuilt: the index of the file"
    if done.complaint:
        yield f"rebuilt: metadata.yaml ({done.complaint})"
    if done.recorded:
        yield "still being recorded: what comes after this is in the bag only"
    yield f"repaired bag: {done.out}"


def _lost(damage: Damage, start_ns: int) -> str:
    kind = "cut off at the end" if damage.is_end else "damaged"
    what = ""
    if damage.is_index:
        what = ": of the index, no message"
    elif damage.span_ns is not None:
        first, last = (_seconds(each - start_ns) for each in damage.span_ns)
        what = f": a chunk of messages from {first} s to {last} s"
    return f"lost: {damage.size} bytes, {kind}, at byte {damage.offset}{what}"


def _seconds(time_ns: int) -> str:
    return f"{time_ns * 1e-9:.3f}"
