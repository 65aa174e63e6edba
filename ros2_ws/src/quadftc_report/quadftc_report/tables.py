"""Tables as the page shows them: rows of headings, groups of rows, cells that span columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from quadftc_report.wording import short


class Cell(NamedTuple):
    """A cell.

    Parameters
    ----------
    text : str
    look : str
        CSS classes: ``number``, ``run`` (with a rule on its left), ``best``, ``faint``, ``text``, ``good``,
        ``bad``, ``code``.
    columns, rows : int
        How many it spans.
    small : str
        Small print below.
    data : mapping
        Attributes for machines: run, metric, axis, value.
    """

    text: str
    look: str = ""
    columns: int = 1
    rows: int = 1
    small: str = ""
    data: Mapping[str, str] | None = None


Row = tuple[Cell, ...]  # the first cell is its heading


class Group(NamedTuple):
    """Rows under a heading of their own, if ``title`` is not empty; ``link``: an anchor of the page."""

    title: str
    rows: tuple[Row, ...]
    link: str = ""
    marks: tuple[Cell, ...] = ()


class Table(NamedTuple):
    """A table; ``look``: its CSS class."""

    caption: str
    heads: tuple[Row, ...]
    groups: tuple[Group, ...]
    look: str = ""

    @property
    def width(self) -> int:
        """Number of columns."""
        return sum(cell.columns for cell in self.heads[0])


def two_heads(first: Sequence[str], heads: Sequence[tuple[str, Sequence[str]]]) -> tuple[Row, Row]:
    """Return two rows of headings: single ones over both, and wide ones over those of their columns."""
    wide = (Cell(title, "run", columns=len(columns)) for title, columns in heads)
    narrow = (
        Cell(column, "number" if index else "number run")
        for _, columns in heads
        for index, column in enumerate(columns)
    )
    return (*(Cell(title, rows=2) for title in first), *wide), tuple(narrow)


def metric_cell(
    value: float | None, run: str, path: str, axis: str | None, text: str | None = None, look: str = ""
) -> Cell:
    """Return a number of a summary; its attributes name its run and its path there."""
    exact = "" if value is None else repr(float(value))
    data = {"run": run, "metric": path, "axis": axis or "", "value": exact}
    return Cell(short(value) if text is None else text, f"number {look}".rstrip(), data=data)


def fact_table(
    caption: str, columns: Sequence[str], groups: Mapping[str, Mapping[str, Sequence[str]]]
) -> Table:
    """Return a table of texts: group to name to a value for each column; in bold where they differ."""
    return Table(
        caption,
        ((Cell(""), *(Cell(column) for column in columns)),),
        tuple(
            Group(title, tuple((Cell(name), *_fact(values)) for name, values in facts.items()))
            for title, facts in groups.items()
        ),
        "facts",
    )


def _fact(values: Sequence[str]) -> Row:
    if len(set(values)) == 1:
        return (Cell(values[0], "text", columns=len(values)),)
    return tuple(Cell(value, "text differs") for value in values)
