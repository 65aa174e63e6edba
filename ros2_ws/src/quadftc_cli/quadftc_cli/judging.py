# pyright: basic
"""What became of the checks of runs, replays and campaigns: lines on the screen, JUnit XML, an exit code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from quadftc_cli.commands import CHECK_FAILED, GOOD
from quadftc_flight.junit import check_cases, write_junit

Checks = Sequence[Mapping[str, Any]]  # as in summary.json


def judge(checks: Mapping[str, Checks], screen: Console, junit: Path | None, command: str) -> int:
    """Say which checks failed, by name of a run; write all of them as JUnit XML, if asked to.

    Return the exit code.
    """
    for name, each in checks.items():
        for check in (check for check in each if not check["passed"]):
            what = f"{check['metric']} {check['axis'] or ''}".rstrip()
            value = "-" if check["value"] is None else f"{check['value']:.4f}"
            screen.print(f"[red]FAILED[/] {name}: {what} = {value}, required {check['bound']}")
    if junit is not None:
        cases = [case for name, each in checks.items() for case in check_cases(name, each)]
        screen.print(f"JUnit: {write_junit(junit, f'quadftc {command}', cases)}")
    return GOOD if all(check["passed"] for each in checks.values() for check in each) else CHECK_FAILED
