"""The tables of docs/robustness.md, in Markdown."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence

import polars as pl

from quadftc_tools.robustness_study.cells import Pair, faults_of, typical, typical_fault
from quadftc_tools.robustness_study.studies import GRADES, SIZED, VARIANTS, Sized, Study

NOTHING = "-"
LOST = "lost"
GRADE = "sensors.grade"

Write = Callable[[pl.DataFrame], str]


def study_tables(study: Study, frame: pl.DataFrame) -> dict[str, str]:
    """Tables of a study over a grid: those of its metrics, and that of the faults.

    Parameters
    ----------
    study : Study
    frame : polars.DataFrame
        Table of its campaign.
    """
    rows = [(_row_name(grade, value), cell) for grade, value, cell in cells(study, frame)]
    first = " and ".join(filter(None, ["sensors" if GRADE in frame.columns else "", study.title]))
    made = {
        f"{study.name}-{shown.key}": _table(first, rows, lambda cell, m=shown.metric: _pair(typical(cell, m)))
        for shown in study.shown
    }
    return {**made, f"{study.name}-faults": _table(first, rows, _faults)}


def cells(study: Study, frame: pl.DataFrame) -> Iterator[tuple[str, float, pl.DataFrame]]:
    """Cells of a study in order: grade (empty: all the same), value, rows."""
    for grade in grades_of(frame):
        own = frame.filter(pl.col(GRADE) == grade) if grade else frame
        for value in own[study.path].unique().sort().to_list():
            yield grade, value, own.filter(pl.col(study.path) == value)


def grades_of(frame: pl.DataFrame) -> list[str]:
    """Grades of the sensors that were flown; one empty text if they are not varied."""
    if GRADE not in frame.columns:
        return [""]
    there = frame[GRADE].unique().to_list()
    return [grade for grade in GRADES if grade in there]


def size_tables(frame: pl.DataFrame) -> dict[str, str]:
    """Tables of the study of sizes: estimate and tracking while the fault lasts, and faults missed."""
    rows = [
        (f"{sized.title}, {low:g} to {high:g}", cell)
        for sized in SIZED
        for low, high, cell in bins(sized, frame, sized.edges)
    ]
    writers: dict[str, Write] = {
        "estimate": lambda cell: _pair(typical_fault(cell, "estimate_rmse_deg") if _watched(cell) else None),
        "tracking": lambda cell: _pair(typical_fault(cell, "tracking_rmse_deg")),
        "missed": _missed,
    }
    tables = {f"fault_size-{key}": _table("fault", rows, write) for key, write in writers.items()}
    return {**tables, "fault_size-alarms": _table("", [("all flights", frame)], _alarms)}


def bins(
    sized: Sized, frame: pl.DataFrame, edges: Sequence[float]
) -> Iterator[tuple[float, float, pl.DataFrame]]:
    """Faults of a kind by size: low, high, rows."""
    own = frame.filter(pl.col("fault.kind") == sized.kind)
    size = pl.col(sized.path).abs()
    for low, high in itertools.pairwise(edges):
        yield low, high, own.filter((low <= size) & (size < high))


def _row_name(grade: str, value: float) -> str:
    return ", ".join(filter(None, [GRADES.get(grade, ""), f"{value:g}"]))


def _table(first: str, rows: Sequence[tuple[str, pl.DataFrame]], write: Write) -> str:
    """One row for each cell, one column for each variant."""
    names = [name for name in VARIANTS if name in set(rows[0][1]["variant"])]
    lines = [[first, *(f"`{name}`" for name in names)], ["---"] * (len(names) + 1)]
    for title, cell in rows:
        lines.append([title, *(write(cell.filter(pl.col("variant") == name)) for name in names)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _watched(cell: pl.DataFrame) -> bool:
    return faults_of(cell) is not None


def _pair(pair: Pair | None) -> str:
    return NOTHING if pair is None else " / ".join(_number(each) for each in pair)


def _number(value: float) -> str:
    """Two digits: more would pretend that so few flights tell them."""
    if not math.isfinite(value):
        return LOST
    if value == 0.0:
        return "0"
    value = float(f"{value:.1e}")
    digits = max(1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:.{min(digits, 4)}f}"


def _faults(cell: pl.DataFrame) -> str:
    found = faults_of(cell)
    return NOTHING if found is None else f"{_share(found.missed)} / {_share(found.alarmed)}"


def _missed(cell: pl.DataFrame) -> str:
    found = faults_of(cell)
    return NOTHING if found is None else _share(found.missed)


def _alarms(cell: pl.DataFrame) -> str:
    found = faults_of(cell)
    return NOTHING if found is None else _share(found.alarmed)


def _share(share: float) -> str:
    return NOTHING if math.isnan(share) else f"{100.0 * share:.0f} %"
