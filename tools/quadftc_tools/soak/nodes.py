# pyright: basic
"""`scripts/soak nodes`: nodes killed, stopped and slowed in flight, messages lost and late."""

from __future__ import annotations

import random
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from rich.table import Table

from quadftc_cli.screen import plain_table
from quadftc_tools.soak.node_flight import (
    ACTIONS,
    HOLD_BACK,
    LOSE,
    NETWORK,
    NODES,
    STRESSES,
    Hit,
    best_scheduling,
    fly,
)
from quadftc_tools.soak.node_judgement import Judge, Trial

TOGETHER = 3  # hits in a flight
ALL = tuple(
    [Hit(node, action, stress) for stress in STRESSES for action in ACTIONS for node in NODES]
    + [Hit(NETWORK, action, stress) for stress in STRESSES for action in (LOSE, HOLD_BACK)]
)


def soak(
    trials: int, seed: int, only: str, keep: Path | None, follow: Callable[[Trial], None]
) -> list[Trial]:
    """Hit so many times, everything in turn that has ``only`` in its name; ``follow`` gets each trial.

    Bags of flights in which something was wrong go to ``keep``. ValueError if ``only`` leaves nothing.
    """
    chosen = [hit for hit in ALL if only in f"{hit.node} {hit.action} {hit.stress}"]
    if not chosen:
        raise ValueError(f"--only: nothing has '{only}' in it")
    done: list[Trial] = []
    for number, hits in enumerate(flights_of(chosen, trials, random.Random(seed))):
        found = flown(hits, seed * 1000 + number, keep)
        for trial in found:
            follow(trial)
        done += found
    return done


def flown(hits: Sequence[Hit], seed: int, keep: Path | None = None) -> list[Trial]:
    """Fly once, and judge."""
    with tempfile.TemporaryDirectory(prefix="quadftc_soak_") as folder:
        bag = Path(folder, "bag")
        records = fly(hits, seed, bag)
        judge = Judge(bag)
        found = [judge.judge(record) for record in records]
        if keep is not None and any(trial.wrong for trial in found):
            shutil.copytree(bag, keep / f"flight_{seed}")
    return found


def flights_of(chosen: Sequence[Hit], trials: int, generator: random.Random) -> Iterator[list[Hit]]:
    """Hits in an order that is drawn, so many together as fit; what concerns the network comes alone."""

    def endless() -> Iterator[Hit]:
        while True:
            yield from generator.sample(chosen, len(chosen))

    together: list[Hit] = []
    for hit in islice(endless(), trials):
        if hit.node == NETWORK:
            yield [hit]
            continue
        together.append(hit)
        if len(together) == TOGETHER:
            yield together
            together = []
    if together:
        yield together


def table(done: Sequence[Trial]) -> Table:
    """One row for each kind of hit, and one for all; without trials that are void."""
    done = [each for each in done if not each.void]
    numbers = ("trials", "survived", "worst error [deg]", "worst return [s]", "worst jump [%]")
    shown = plain_table(("node", "what", "during"), numbers, "Faults of nodes in flight")
    for hit in ALL:
        rows = [each for each in done if Hit(each.node, each.action, each.stress) == hit]
        if rows:
            shown.add_row(hit.node, hit.action, hit.stress, *_cells(rows))
    if done:
        shown.add_row("all", "", "", *_cells(done))
    return shown


def _cells(rows: Sequence[Trial]) -> list[str]:
    return [
        str(len(rows)),
        str(sum(not each.wrong for each in rows)),
        f"{max(each.largest for each in rows):.2f}",
        f"{max(each.returned for each in rows):.2f}",
        f"{100.0 * max(each.jump for each in rows):.1f}",
    ]


def summary(done: Sequence[Trial], seed: int) -> dict[str, Any]:
    """What was found, ready for JSON."""
    void = sum(each.void for each in done)
    done = [each for each in done if not each.void]
    return {
        "fault": "nodes killed, stopped, stalled; messages lost and late",
        "seed": seed,
        "realtime_priority": best_scheduling().priority,
        "trials": len(done),
        "void": void,
        "survived": sum(not each.wrong for each in done),
        "worst_error_deg": max((each.largest for each in done), default=None),
        "worst_return_s": max((each.returned for each in done), default=None),
        "worst_jump": max((each.jump for each in done), default=None),
        "passed": bool(done) and not any(each.wrong for each in done),
    }
