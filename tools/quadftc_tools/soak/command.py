# pyright: basic
"""``scripts/soak PART``: each part injects one kind of fault into the software, many times.

Exit codes as of ``quadftc``: 1 if what was required did not hold in some trial. A new part is a module with
what it does and how it shows it, and a function here.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

os.environ.setdefault("ROS_DOMAIN_ID", str(81 + os.getpid() % 21))  # away from those of the tests, and from 0

from quadftc_cli.commands import CHECK_FAILED, GOOD
from quadftc_cli.main import guarded
from quadftc_cli.screen import console, say
from quadftc_ros.reach import stay_local

stay_local()

app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None
)

TrialsOption = Annotated[int, typer.Option(min=1, help="How many.")]
SeedOption = Annotated[int, typer.Option(help="Of the random times.")]
OutOption = Annotated[Path | None, typer.Option(metavar="FILE.json", help="Write every trial there.")]


@app.callback()
def _root() -> None:
    """Long tests of the software itself: one fault, injected many times, and the worst that came of it."""


@app.command()
def recorder(trials: TrialsOption = 50, seed: SeedOption = 1, out: OutOption = None) -> None:
    """Kill recorders at random times; repair their bags; tell how much was lost."""
    from quadftc_tools.soak.recorder import KILLED

    _hit_recorders(KILLED, trials, seed, out)


@app.command()
def disk(trials: TrialsOption = 20, seed: SeedOption = 1, out: OutOption = None) -> None:
    """Let disks be full at random times of flights, which are to go on; repair the bags."""
    from quadftc_tools.soak.recorder import DISK_FULL

    _hit_recorders(DISK_FULL, trials, seed, out)


@app.command()
def nodes(
    trials: TrialsOption = 51,
    seed: SeedOption = 1,
    only: Annotated[str, typer.Option(help="Only what has this in its name: node, action, stress.")] = "",
    keep: Annotated[Path | None, typer.Option(metavar="DIR", help="Keep bags of flights gone wrong.")] = None,
    out: OutOption = None,
) -> None:
    """Kill, stop and slow nodes in flight, lose and delay messages; tell how the vehicle took it."""
    from quadftc_tools.soak import nodes as part

    def follow(trial: part.Trial) -> None:
        say(
            f"{trial.node} {trial.action} during {trial.stress}: off by {trial.largest:.2f} deg, away"
            f" {trial.away:.1f} s, back within {trial.returned:.2f} s, torque jumped by"
            f" {100.0 * trial.jump:.1f} %: {'void: ' * trial.void}{trial.wrong or 'good'}"
        )

    done = part.soak(trials, seed, only, keep, follow)
    _finish(part.table(done), part.summary(done, seed), done, out)


@app.command()
def intruders(
    graph: Annotated[str, typer.Option(help="composed or processes.")] = "composed",
    seconds: Annotated[float, typer.Option(min=1.0, help="How long each attack lasts.")] = 10.0,
    seed: SeedOption = 1,
    only: Annotated[str, typer.Option(help="Only attacks that have this in their name.")] = "",
    out: OutOption = None,
) -> None:
    """Let a stranger publish in flight what a node would; tell how the vehicle took it, and who noticed."""
    from quadftc_tools.soak import intruders as part

    def follow(trial: part.Trial) -> None:
        say(
            f"{trial.attack}: {trial.sent} sent, {trial.refused} refused, off by {trial.largest:.2f} deg,"
            f" named after {trial.named:.2f} s: {trial.wrong or 'good'}"
        )

    done = part.soak(graph, seconds, seed, only, follow)
    _finish(part.table(done), part.summary(done, seed), done, out)


@app.command()
def endurance(
    mode: Annotated[str, typer.Option(help="lockstep or realtime.")] = "lockstep",
    graph: Annotated[str, typer.Option(help="composed or processes.")] = "composed",
    minutes: Annotated[float, typer.Option(min=0.1, help="How long.")] = 60.0,
    rate: Annotated[float, typer.Option(min=10.0, help="Of the control [Hz].")] = 250.0,
    length: Annotated[
        float, typer.Option(min=10.0, help="Of a flight [s]; as many follow each other as fit.")
    ] = 600.0,
    out: OutOption = None,
) -> None:
    """Fly for long; tell whether memory, open files or the rate drift."""
    from quadftc_flight.runs import GRAPHS
    from quadftc_ros.node import MODES
    from quadftc_tools.soak import endurance as part

    for name, value, known in (("mode", mode, MODES), ("graph", graph, GRAPHS)):
        if value not in known:
            raise ValueError(f"--{name}: no '{value}'; there are: {', '.join(known)}")
    flown, grown = part.soak(mode, graph, rate, length, minutes, say)
    _finish(part.table(grown), part.summary(mode, graph, rate, flown, grown), flown, out)


def _hit_recorders(hit: str, trials: int, seed: int, out: Path | None) -> None:
    from quadftc_tools.soak import recorder as part

    def follow(trial: part.Trial) -> None:
        verdict = trial.wrong or ("good" if part.passed(trial) else "too much is lost")
        say(
            f"{trial.form}: {hit} after {trial.after:.2f} s, lost {trial.lost:.3f} s"
            f" ({trial.lost_stamps:.3f} s of stamps), {trial.messages} messages read: {verdict}"
        )

    done = part.soak(hit, trials, seed, follow)
    _finish(part.table(hit, done), part.summary(hit, done, seed), done, out)


def _finish(table: Table, summary: dict[str, Any], trials: Sequence[Any], out: Path | None) -> None:
    """Print the table, write the results if asked to, and end with the exit code."""
    console().print(table)
    if out is not None:
        rows = {**summary, "each": [dataclasses.asdict(trial) for trial in trials]}
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    raise typer.Exit(GOOD if summary["passed"] else CHECK_FAILED)


if __name__ == "__main__":
    sys.exit(guarded(sys.argv[1:], app))  # every error becomes a line and an exit code
