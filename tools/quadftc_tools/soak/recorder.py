# pyright: basic
"""`scripts/soak recorder` and `scripts/soak disk`: recorders hit at random times, how much each lost."""

from __future__ import annotations

import random
import statistics
from collections.abc import Callable, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from quadftc_tools.soak.recorder_trial import COMPOSED_FORMS, DISK_FULL, FORMS, KILLED, Trial, try_recorder

ALLOWED = 1.0  # s; that a recorder may lose
SUFFERERS = {KILLED: FORMS, DISK_FULL: COMPOSED_FORMS}


def soak(hit: str, trials: int, seed: int, follow: Callable[[Trial], None]) -> list[Trial]:
    """Hit so many recorders, of each form in turn.

    Parameters
    ----------
    hit : str
        `KILLED` or `DISK_FULL`.
    trials, seed : int
    follow : callable
        Called with each as it is done.

    Raises
    ------
    GraphError
        If a graph or a recorder does not start.
    """
    generator = random.Random(seed)
    done: list[Trial] = []
    forms = SUFFERERS[hit]
    for number in range(trials):
        done.append(try_recorder(forms[number % len(forms)], hit, generator))
        follow(done[-1])
    return done


def passed(trial: Trial) -> bool:
    """Whether no more was lost than may be, and the repaired bag is whole."""
    return not trial.wrong and trial.lost <= ALLOWED


def table(hit: str, done: Sequence[Trial]) -> Table:
    """One row for each form, and one for all."""
    shown = Table(box=SIMPLE_HEAD, pad_edge=False, title=f"{hit} at a random time")
    shown.add_column("form")
    for heading in (
        *("trials", "worst loss \\[s]", "median \\[s]", "worst in stamps \\[s]"),
        *("bad after repair", "messages read"),
    ):
        shown.add_column(heading, justify="right")
    for name in (*FORMS, "all"):
        rows = [trial for trial in done if name in (trial.form, "all")]
        if rows:
            shown.add_row(name, *_cells(rows))
    return shown


def _cells(rows: Sequence[Trial]) -> list[str]:
    lost = [trial.lost for trial in rows]
    return [
        str(len(rows)),
        f"{max(lost):.3f}",
        f"{statistics.median(lost):.3f}",
        f"{max(trial.lost_stamps for trial in rows):.3f}",
        str(sum(bool(trial.wrong) for trial in rows)),
        str(sum(trial.messages for trial in rows)),
    ]


def summary(hit: str, done: Sequence[Trial], seed: int) -> dict[str, Any]:
    """What was found, ready for JSON."""
    return {
        "fault": hit,
        "seed": seed,
        "trials": len(done),
        "worst_loss_s": max((trial.lost for trial in done), default=None),
        "bad_after_repair": sum(bool(trial.wrong) for trial in done),
        "passed": all(map(passed, done)),
    }
