"""The isolability matrix on the screen: a table, and what it says in lines."""

from __future__ import annotations

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from quadftc_theory.isolability import IsolabilityResult
from quadftc_theory.vehicle_equations import CHOICES

LASTING, CHANGING, NEVER, CANCELLED, ITSELF = "●", "○", "·", "!", ""

LEGEND = (
    f"{LASTING} also while the fault is constant   {CHANGING} only while it changes   {NEVER} never   "
    f"{CANCELLED} by structure, but this vehicle's coefficients cancel"
)


def isolability_table(result: IsolabilityResult) -> Table:
    """Table with a row for each fault: whether it is seen, and told apart from the fault of each column.

    Columns carry the numbers of the rows, so that 16 faults fit on a screen of 80 characters. The marks are
    those of `LEGEND`.
    """
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=0)
    table.add_column("", justify="right", no_wrap=True)
    table.add_column("fault", no_wrap=True)
    table.add_column("seen", justify="center", no_wrap=True)
    for number in range(1, len(result.faults) + 1):
        table.add_column(str(number), justify="right", no_wrap=True)
    seen = zip(result.detectable, result.rank_detectable, result.strongly_detectable, strict=True)
    pairs = np.stack([result.isolable, result.rank_isolable, result.strongly_isolable], axis=-1)
    for row, (fault, answers) in enumerate(zip(result.faults, seen, strict=True)):
        marks = [ITSELF if column == row else _mark(*each) for column, each in enumerate(pairs[row])]
        table.add_row(str(row + 1), fault, _mark(*answers), *marks)
    return table


def isolability_lines(result: IsolabilityResult) -> list[str]:
    """What was assumed, and what the matrix says, in lines of plain text."""
    assumed = [words[result.assumptions[key]] for key, words in CHOICES.items() if key in result.assumptions]
    lines = [f"{result.name}: {', '.join([*assumed, f'{result.causality} causality'])}"]
    pairs = [" / ".join(pair) for pair in dict.fromkeys(tuple(sorted(pair)) for pair in result.cancelled)]
    for meaning, items in (
        ("cannot be detected", result.undetectable),
        ("detected only while they change", result.transient),
        ("cannot be told apart", [" / ".join(group) for group in result.groups]),
        ("told apart by structure only, coefficients cancel", pairs),
    ):
        if items:
            lines.append(f"{meaning}: {', '.join(items)}")
    if not result.undetectable and not result.groups:
        lines.append("every fault can be told apart from every other")
    return lines


def _mark(structure: bool, rank: bool, strong: bool) -> str:
    if not structure:
        return NEVER
    if not rank:
        return CANCELLED
    return LASTING if strong else CHANGING
