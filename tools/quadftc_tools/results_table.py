"""Table of results on the screen."""

from __future__ import annotations

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table


def results_table(title: str, names: Sequence[str], numbers: Sequence[str]) -> Table:
    """Start a table: columns with names on the left, with numbers on the right."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, title=escape(title))
    for heading in names:
        table.add_column(escape(heading))
    for heading in numbers:
        table.add_column(escape(heading), justify="right")
    return table
