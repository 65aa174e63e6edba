# pyright: basic
"""What became of the checks of runs, replays and campaigns: lines on the screen, JUnit XML, an exit code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console

from quadftc_cli.commands import CHECK_FAILED, GOOD
from quadftc_flight.junit import check_cases, write_junit

Checks = Sequence[Mapping[str, object]]  # as in summary.json


def judge(checks: Mapping[str, Checks], screen: Console, junit: Path | None, command: str) -> int:
    """Say which checks failed, by name of a run; write all of them as JUnit XML, if asked to.

    Return the exit code.
    """
    cases = [case for name, each in checks.items() for case in check_cases(name, each)]
    failed = [case for case in cases if case.failures]
    for case in failed:
        screen.print(f"[red]FAILED[/] {case.group}: {case.failures[0].message}")
    if junit is not None:
        screen.print(f"JUnit: {write_junit(junit, f'quadftc {command}', cases)}")
    return CHECK_FAILED if failed else GOOD
