# pyright: basic
"""`scripts/soak nodes`: nodes killed, stopped and slowed in flight, messages lost and late."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from quadftc_tools.soak.node_flight import (
    ACTIONS,
    HOLD_BACK,
    LOSE,
    NETWORK,
    NODES,
    STRESSES,
    Hit,
    fly,
)
from quadftc_tools.soak.node_judgement import Judge, Trial

TOGETHER = 3  # hits in a flight
ALL = tuple(
    [Hit(node, action, stress) for stress in STRESSES for action in ACTIONS for node in NODES]
    + [Hit(NETWORK, action, stress) for stress in STRESSES for action in (LOSE, HOLD_BACK)]
)


def soak(trials: int, seed: int, only: str) -> Iterator[Trial]:
    """Hit so many times, in turn all that has ``only`` in its name; ValueError if that leaves nothing."""
    chosen = [hit for hit in ALL if only in f"{hit.node} {hit.action} {hit.stress}"]
    if not chosen:
        raise ValueError(f"--only: nothing has '{only}' in it")
    for number, hits in enumerate(flights_of(chosen, trials, random.Random(seed))):
        yield from flown(hits, seed * 1000 + number)


def flown(hits: Sequence[Hit], seed: int) -> list[Trial]:
    """Fly once, and judge."""
    with tempfile.TemporaryDirectory(prefix="quadftc_soak_") as folder:
        bag = Path(folder, "bag")
        records = fly(hits, seed, bag)
        judge = Judge(bag)
        return [judge.judge(record) for record in records]


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
