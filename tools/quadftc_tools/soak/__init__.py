"""Long tests of the software itself, `scripts/soak`: faults put into the programs, at random times."""

from __future__ import annotations

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table


def soak_table(title: str, names: Sequence[str], numbers: Sequence[str]) -> Table:
    """Start a table of results: columns with names on the left, with numbers on the right."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, title=title)
    for heading in names:
        table.add_column(heading)
    for heading in numbers:
        table.add_column(escape(heading), justify="right")
    return table
