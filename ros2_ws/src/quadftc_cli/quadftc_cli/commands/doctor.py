# pyright: basic
"""``quadftc doctor``."""

from __future__ import annotations

import typer

from quadftc_cli.commands import CHECK_FAILED, GOOD
from quadftc_cli.doctor import examine
from quadftc_cli.tables import console


def doctor() -> None:
    """Check the installation; say what is missing and how to mend it."""
    findings = examine()
    screen = console()
    for finding in findings:
        mark = "[green]good[/]" if finding.good else "[red]BAD [/]"
        screen.print(f"{mark} {finding.part}: {finding.what}")
        if not finding.good:
            screen.print(f"     {finding.mend}")
    raise typer.Exit(GOOD if all(finding.good for finding in findings) else CHECK_FAILED)
