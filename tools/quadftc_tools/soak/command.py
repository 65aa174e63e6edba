# pyright: basic
"""``scripts/soak PART``: each part injects one kind of fault into the software, many times.

A part is a module whose ``soak`` yields trials. They are dataclasses of texts, which say what was tried, and
of numbers that are better when small. Their `wrong` is empty where all held. Exit codes as of ``quadftc``: 1
if something did not hold.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

os.environ.setdefault("ROS_DOMAIN_ID", str(81 + os.getpid() % 21))  # away from those of the tests, and from 0

from quadftc_cli.commands import CHECK_FAILED, GOOD
from quadftc_cli.main import guarded
from quadftc_cli.screen import console, plain_table, say
from quadftc_ros.reach import stay_local

stay_local()

app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None
)

Trials = Annotated[int, typer.Option(min=1, help="How many.")]
Seed = Annotated[int, typer.Option(help="Of the random times.")]
Only = Annotated[str, typer.Option(help="Only what has this in its name.")]
Out = Annotated[Path | None, typer.Option(metavar="FILE.json", help="Write every trial there.")]
Graph = Literal["composed", "processes"]
Mode = Literal["lockstep", "realtime"]
Seconds = Annotated[float, typer.Option(min=1.0, help="How long each attack lasts.")]
Minutes = Annotated[float, typer.Option(min=0.1, help="How long.")]
Rate = Annotated[float, typer.Option(min=10.0, help="Of the control [Hz].")]
Length = Annotated[float, typer.Option(min=10.0, help="Of a flight [s]; as many follow each other as fit.")]


@app.callback()
def _root() -> None:
    """Long tests of the software itself: one fault, injected many times, and the worst that came of it."""


@app.command()
def recorder(trials: Trials = 50, seed: Seed = 1, out: Out = None) -> None:
    """Kill recorders at random times; repair their bags; tell how much was lost."""
    from quadftc_tools.soak.recorder import KILLED, soak

    judge(soak(KILLED, trials, seed), out)


@app.command()
def disk(trials: Trials = 20, seed: Seed = 1, out: Out = None) -> None:
    """Let disks be full at random times of flights, which are to go on; repair the bags."""
    from quadftc_tools.soak.recorder import DISK_FULL, soak

    judge(soak(DISK_FULL, trials, seed), out)


@app.command()
def nodes(trials: Trials = 45, seed: Seed = 1, only: Only = "", out: Out = None) -> None:
    """Kill, stop and slow nodes in flight; tell how the vehicle took it."""
    from quadftc_tools.soak.nodes import soak

    judge(soak(trials, seed, only), out)


@app.command()
def intruders(
    graph: Graph = "composed", seconds: Seconds = 10.0, seed: Seed = 1, only: Only = "", out: Out = None
) -> None:
    """Let a stranger publish in flight what a node would; tell how the vehicle took it, and who noticed."""
    from quadftc_tools.soak.intruders import soak

    judge(soak(graph, seconds, seed, only), out)


@app.command()
def endurance(
    mode: Mode = "lockstep",
    graph: Graph = "composed",
    minutes: Minutes = 60.0,
    rate: Rate = 250.0,
    length: Length = 600.0,
    out: Out = None,
) -> None:
    """Fly for long; tell whether memory, open files or the rate drift."""
    from quadftc_tools.soak.endurance import soak

    judge(soak(mode, graph, rate, length, minutes), out)


def judge(trials: Iterable[Any], out: Path | None) -> None:
    """Show each trial as it comes, then the largest numbers; write them; end with the exit code."""
    done: list[Any] = []
    for trial in trials:
        done.append(trial)
        row = dataclasses.asdict(trial)
        wrong = row.pop("wrong") or "good"
        void = "void: " * row.pop("void", False)
        say(f"{', '.join(f'{name} {_text(value)}' for name, value in row.items())}: {void}{wrong}")
    for kind in dict.fromkeys(map(type, done)):
        _show([dataclasses.asdict(trial) for trial in done if type(trial) is kind])
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        rows = [dataclasses.asdict(trial) for trial in done]
        out.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    raise typer.Exit(GOOD if passed(done) else CHECK_FAILED)


def passed(trials: Sequence[Any]) -> bool:
    """Whether there are trials, and all held; one that is void does not count."""
    counted = [trial for trial in trials if not getattr(trial, "void", False)]
    return bool(counted) and not any(trial.wrong for trial in counted)


def _show(rows: list[dict[str, Any]]) -> None:
    """Print a row for each thing that was tried, and one for all: the largest of each number."""
    rows = [row for row in rows if not row.pop("void", False)]
    if not rows:
        return
    texts = [name for name, value in rows[0].items() if isinstance(value, str) and name != "wrong"]
    numbers = [name for name, value in rows[0].items() if not isinstance(value, str)]
    shown = plain_table(texts, ("trials", "good", *numbers), "The largest of each number")
    groups = {tuple(row[name] for name in texts): list[dict[str, Any]]() for row in rows}
    for row in rows:
        groups[tuple(row[name] for name in texts)].append(row)
    for group, part in (
        *(groups.items() if texts else ()),
        (("all", *[""] * len(texts))[: len(texts)], rows),
    ):
        counts = str(len(part)), str(sum(not row["wrong"] for row in part))
        shown.add_row(*group, *counts, *(_text(max(row[name] for row in part)) for name in numbers))
    console().print(shown)


def _text(value: str | float) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(guarded(sys.argv[1:], app))  # every error becomes a line and an exit code
