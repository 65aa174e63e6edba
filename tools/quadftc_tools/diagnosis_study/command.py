# pyright: basic
"""The study of diagnosis: ``scripts/study_diagnosis``."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from quadftc_cli.commands import BAD_INPUT, GOOD, INTERRUPTED
from quadftc_cli.tables import console
from quadftc_tools.diagnosis_study.campaign import Study, bags_in, fly_all, missing
from quadftc_tools.diagnosis_study.publish import publish
from quadftc_tools.diagnosis_study.results import gather
from quadftc_tools.diagnosis_study.store import Store

FLIGHTS, SEEDS = 200, 20


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="study_diagnosis",
        description="Fly every fault observer through random faults; write tables and figures.",
        epilog="What was flown is kept in --out; the same command goes on where it was.",
    )
    parser.add_argument("--out", type=Path, required=True, help="directory of the results")
    parser.add_argument(
        "--flights", type=int, default=FLIGHTS, help=f"simulated flights (default: {FLIGHTS})"
    )
    parser.add_argument(
        "--recordings", type=Path, help="directory of rosbag2 bags of healthy IMUs; default: none are flown"
    )
    parser.add_argument(
        "--seeds", type=int, default=SEEDS, help=f"draws of faults for each recording (default: {SEEDS})"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the whole study (default: 0)")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: as many as cores)"
    )
    parser.add_argument(
        "--docs", type=Path, help="directory of diagnosis.md and figures/ to write into; default: not written"
    )
    parser.add_argument(
        "--no-flights", action="store_true", help="take what is stored, by whatever version of the code"
    )
    return parser.parse_args(arguments)


def run(options: argparse.Namespace, screen: Console) -> None:
    """Fly what is missing, and write the results.

    Raises
    ------
    ValueError
        If an option is wrong or there is nothing to write about.
    """
    for name, low in (("flights", 0), ("seeds", 1), ("seed", 0), ("jobs", 1)):
        if getattr(options, name) < low:
            raise ValueError(f"--{name}: {getattr(options, name)}: must be at least {low}")
    bags = bags_in(options.recordings) if options.recordings else ()
    if not bags:
        screen.print("recordings: skipped; name a directory of bags with --recordings", soft_wrap=True)
    study = Study(options.flights, bags, options.seeds, options.seed)
    store = Store(options.out)
    if not options.no_flights:
        _fly(study, store, options.jobs, screen)
    results = gather(study, store, any_code=options.no_flights)
    for path in publish(results, options.out, options.docs):
        screen.print(f"written: {path}", markup=False, soft_wrap=True)


def _fly(study: Study, store: Store, jobs: int, screen: Console) -> None:
    tasks = missing(study, store)
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(TextColumn("flights"), *columns, console=screen, disable=not screen.is_terminal) as bars:
        bar = bars.add_task("", total=len(tasks))
        fly_all(tasks, store, jobs, lambda done: bars.update(bar, completed=done))
    screen.print(f"flights: {len(tasks)} flown, the others were stored in {store.path}", soft_wrap=True)


def main() -> int:
    """Run the command; turn wrong input into lines and an exit code."""
    screen = console(stderr=True)
    try:
        run(parse(sys.argv[1:]), screen)
    except (ValueError, OSError) as error:
        for line in str(error).splitlines():
            screen.print(f"error: {line}", markup=False, soft_wrap=True)
        return BAD_INPUT
    except KeyboardInterrupt:
        screen.print("interrupted; the same command goes on from here")
        return INTERRUPTED
    return GOOD


if __name__ == "__main__":
    sys.exit(main())
