"""Tables as the page shows them: groups of rows of cells, below a label for each run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from quadftc_report.wording import NOTHING


class Cell(NamedTuple):
    """A cell; ``look``: CSS classes such as ``number``, ``run`` (with a rule on its left), ``best``."""

    text: str
    look: str = ""
    columns: int = 1  # that it spans
    small: str = ""  # small print below
    data: Mapping[str, str] | None = None  # attributes for machines: run, metric, axis, value


Row = tuple[Cell, ...]  # the first cell is its heading


class Table(NamedTuple):
    """A table; below each label stand as many ``columns``, or a single one without heading."""

    caption: str
    labels: Sequence[str]
    groups: Mapping[str, Sequence[Row]]  # by their heading; an empty one is not shown
    look: str  # CSS class
    columns: Sequence[str] = ()


def fact_table(
    caption: str, labels: Sequence[str], facts: Sequence[Mapping[str, Mapping[str, Any]]]
) -> Table:
    """Return a table of facts side by side: of each label group to name to value; bold where they differ."""
    groups: dict[str, list[Row]] = {}
    for title in dict.fromkeys(title for each in facts for title in each):
        parts = [each.get(title, {}) for each in facts]
        names = dict.fromkeys(name for part in parts for name in part)
        groups[title] = [(Cell(name), *_fact_cells([part.get(name) for part in parts])) for name in names]
    return Table(caption, labels, groups, "facts")


def _fact_cells(values: Sequence[Any]) -> Row:
    texts = [_fact_text(value) for value in values]
    if len(set(texts)) == 1:
        return (Cell(texts[0], "text", columns=len(texts)),)
    return tuple(Cell(text, "text differs") for text in texts)


def _fact_text(value: Any) -> str:
    if value is None:
        return NOTHING
    if isinstance(value, str):
        return value
    if isinstance(value, list) and all(isinstance(item, str) for item in value):
        return "\n".join(value) or NOTHING
    return json.dumps(value, ensure_ascii=False, default=str)
