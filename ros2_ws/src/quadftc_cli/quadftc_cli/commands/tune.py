# pyright: basic
"""``quadftc tune``."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from typer import Argument, Option

from quadftc_campaign.errors import CampaignError
from quadftc_cli.commands import CHECK_FAILED, INTERRUPTED
from quadftc_cli.commands.options import WorkersOption, workers_here
from quadftc_cli.screen import Bars, console, say

if TYPE_CHECKING:
    from quadftc_campaign.tune.tuning import Tuned


def tune(
    file: Annotated[Path, Argument(help="Campaign file with a key 'tune' (see campaigns/).")],
    out: Annotated[Path | None, Option(help="File for the gains; default: gains/NAME.yaml.")] = None,
    workers: WorkersOption = None,
    force: Annotated[bool, Option("--force", help="Replace the file.")] = False,
) -> None:
    """Tune gains by gradients through the closed loop; judge them on other flights."""
    from quadftc_campaign.campaign_file import load_campaign  # with what it needs, half a second
    from quadftc_campaign.tune.tuning import checked, write
    from quadftc_campaign.tune.tuning import tune as tuned_for

    cores = workers_here(workers)
    loaded = load_campaign(file)
    start = checked(loaded)
    path = out or Path("gains") / f"{loaded.name}.yaml"
    if path.exists() and not force:
        raise CampaignError(f"{path}: exists; --force replaces it")
    screen = console()
    numbers = f"{len(start.logarithms)} numbers in {', '.join(start.names)}"
    say(f"{loaded.name}: {numbers}; scheme {loaded.variants[0].scheme}; compiling first")
    total, done = loaded.tune.steps if loaded.tune else 1, itertools.count(1)
    try:
        with Bars(screen) as bars:
            update = bars.add("tuning")
            update(0.0, "compiling")
            found = tuned_for(loaded, cores, lambda cost: update(next(done) / total, f"cost {cost:.4f}"))
    except KeyboardInterrupt:
        screen.print("interrupted; nothing is written")
        raise typer.Exit(INTERRUPTED) from None
    _show(found)
    if not found.after.cost < found.before.cost or found.after.crashed > found.before.crashed:
        screen.print("[red]no better[/]: nothing is written")
        raise typer.Exit(CHECK_FAILED)
    write(found, loaded, path)
    screen.print(f"gains: {path}")


def _show(found: Tuned) -> None:
    """Print gains, and flights not used for tuning, before and after."""
    screen = console()
    gains = Table("gain", "before", "after")
    for name, before in found.start.plain().items():
        gains.add_row(name, _shown(before), _shown(found.gains.plain()[name]))
    screen.print(gains)
    held = Table("flights not used for it: mean", "before", "after", "change")
    pairs = {name: (found.before.metrics[name], found.after.metrics[name]) for name in found.before.metrics}
    for name, (before, after) in {"cost": (found.before.cost, found.after.cost), **pairs}.items():
        held.add_row(name, f"{before:.4g}", f"{after:.4g}", f"{100.0 * (after / before - 1.0):+.1f} %")
    for name in ("missed", "false_alarms", "crashed"):
        pair = (str(getattr(each, name)) for each in (found.before, found.after))
        held.add_row(name.replace("_", " "), *pair)
    screen.print(held)
    failing = f"conditions that failed before are not asked for: {'; '.join(sorted(found.failing))}"
    holding = "quadftc check: every condition that the scheme needs holds, as before"
    screen.print(failing if found.failing else holding)


def _shown(value: float | list[float]) -> str:
    numbers = value if isinstance(value, list) else [value]
    return ", ".join(f"{number:.4g}" for number in numbers)
