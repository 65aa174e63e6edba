"""The metrics of the runs of a comparison side by side, each number with its path in ``summary.json``.

How to read it: a column for each run, a row for each metric and axis. Where less is better, the smallest
value of the row is the best; a run that does not estimate at all is never best at estimating. Beside every
number stands its change against the baseline, the first run without a fault observer (the last run, if each
has one): ``-95 %`` is a twentieth of the baseline's value; ten times it and more is told as a factor, as ``x
25``. There is no change against a baseline of zero, or across zero.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from quadftc_flight.run_directory import NO_OBSERVER
from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import SideBySide, has_observer
from quadftc_report.measures import metric
from quadftc_report.metric_kinds import (
    DIAGNOSIS,
    EVENT,
    FLIGHT_KINDS,
    SETTLING,
    WINDOW,
    WINDOW_KINDS,
    Kind,
    kind_of,
    leaves,
    rank,
)
from quadftc_report.wording import plain

LARGE = 10.0  # times the baseline; from here on a change is told as a factor
TINY = 1e-12  # in any unit; a number below is the rounding of a zero
SMALL = 1e-3  # times the baseline; what is less is told as less than this


@dataclasses.dataclass(frozen=True)
class Cell:
    """One number of one run.

    Parameters
    ----------
    value : float, optional
        As in the summary; None: no value.
    text : str
        For people, in the row's unit.
    change : float, optional
        Against the baseline, as a share of its value: -0.5 is half of it. None: baseline, or no such number.
    change_text : str
        For people; empty if there is none.
    """

    value: float | None
    text: str
    change: float | None = None
    change_text: str = ""


@dataclasses.dataclass(frozen=True)
class Row:
    """One metric about one axis.

    Parameters
    ----------
    path : str
        Dotted path of its numbers in ``summary["metrics"]``.
    section, label, unit : str
    axis : str, optional
        None for a metric without axes.
    cells : tuple of Cell
        One for each column.
    best : int, optional
        Which cell is the best; None: less is not better here, or no cell is better than all others.
    """

    path: str
    section: str
    label: str
    unit: str
    axis: str | None
    cells: tuple[Cell, ...]
    best: int | None


@dataclasses.dataclass(frozen=True)
class MetricsTable:
    """All metrics of a comparison.

    Parameters
    ----------
    columns : tuple of str
        What the runs are called in this comparison.
    runs : tuple of str
        Their names.
    baseline : int, optional
        Column that changes are told against; None for a single run.
    rows : tuple of Row
    """

    columns: tuple[str, ...]
    runs: tuple[str, ...]
    baseline: int | None
    rows: tuple[Row, ...]


def metrics_table(comparison: SideBySide[Recorded]) -> MetricsTable:
    """Lay out every metric of every run of a comparison.

    A metric that is not known comes last, under its own name. What no run has a number for is left out of the
    diagnosis, where most is about some kind of fault, or about one that was found.
    """
    runs = comparison.runs
    baseline = _baseline(runs)
    rows = [_row(path, axis, runs, baseline) for path, axis in _paths(runs)]
    rows = [row for row in rows if not row.path.startswith(DIAGNOSIS) or _says_something(row)]
    came_up = {row.section: index for index, row in reversed(list(enumerate(rows)))}
    rows.sort(key=lambda row: (rank(row.section), came_up[row.section]))  # stable
    labels = tuple(comparison.label(run) for run in runs)
    return MetricsTable(labels, tuple(run.name for run in runs), baseline, tuple(rows))


def _baseline(runs: tuple[Recorded, ...]) -> int | None:
    if len(runs) < 2:
        return None
    return next((index for index, run in enumerate(runs) if not has_observer(run)), len(runs) - 1)


def _says_something(row: Row) -> bool:
    return any(cell.value is not None for cell in row.cells)


def _paths(runs: tuple[Recorded, ...]) -> Iterator[tuple[str, str | None]]:
    """Yield the path of every number that any run has, and its axis; in the order of the tables of kinds."""
    found: dict[str, str | None] = {}
    for run in runs:
        found.update(leaves(run.summary["metrics"]))
    yield from ((path, found[path]) for path in sorted(found, key=_place))


def _place(path: str) -> tuple[int, int, int]:
    """Where a metric stands: of the flight, of its diagnosis, of a window, of a fault, not known."""
    words = path.split(".")
    if path.startswith(WINDOW):
        return 2, int(words[1]), _index(list(WINDOW_KINDS), words[2])
    if path.startswith(EVENT):
        return 3, int(words[2]), 0
    if path.startswith(DIAGNOSIS):
        return 1, 0, 0
    known = words[0] in FLIGHT_KINDS
    return (0 if known else 4), _index(list(FLIGHT_KINDS), words[0]), 0


def _index(names: list[str], name: str) -> int:
    return names.index(name) if name in names else len(names)


def _row(path: str, axis: str | None, runs: tuple[Recorded, ...], baseline: int | None) -> Row:
    kind = kind_of(path, runs)
    found = [metric(run, path) for run in runs]
    if any(isinstance(value, bool) for value in found):
        return Row(path, kind.section, kind.label, kind.unit, axis, tuple(map(_verdict, found)), None)
    values = [_number(value) for value in found]
    compared = kind.less_is_better or not path.startswith(DIAGNOSIS)  # a number of faults is no achievement
    base = values[baseline] if baseline is not None and compared else None
    cells = tuple(
        _missing(path, run) if value is None else _cell(value, kind, None if index == baseline else base)
        for index, (run, value) in enumerate(zip(runs, values, strict=True))
    )
    return Row(path, kind.section, kind.label, kind.unit, axis, cells, _best(values, kind, path, runs))


def _number(found: Any) -> float | None:
    return float(found) if isinstance(found, (int, float)) else None


def _verdict(found: Any) -> Cell:
    return Cell(_number(found), {True: "yes", False: "no"}.get(found, "-"))


def _missing(path: str, run: Recorded) -> Cell:
    """A cell without a number; an estimate that was there all the time and did not settle says so."""
    never = SETTLING in path and metric(run, path.replace(SETTLING, "fault_estimate_max_deg")) is not None
    return Cell(None, "never" if never else "-")


def _cell(value: float, kind: Kind, base: float | None) -> Cell:
    text = plain(kind.scale * value) if abs(value) >= TINY else "0"
    if not base or value / base < 0.0:
        return Cell(value, text)
    return Cell(value, text, value / base - 1.0, _change_text(value / base))


def _change_text(ratio: float) -> str:
    if ratio >= LARGE:
        return f"x {plain(ratio)}"
    if ratio == 0.0:
        return "-100 %"
    if ratio < SMALL:
        return f"below -{plain(100.0 * (1.0 - SMALL))} %"
    change = round(100.0 * (ratio - 1.0), 1)
    return f"{'+' if change > 0.0 else ''}{plain(change)} %"


def _best(values: list[float | None], kind: Kind, path: str, runs: tuple[Recorded, ...]) -> int | None:
    """The smallest of several values, if it is the only one and not that of a run that does not estimate."""
    known = sorted(value for value in values if value is not None)
    if not kind.less_is_better or len(values) < 2 or not known or known[:1] == known[1:2]:
        return None
    best = values.index(known[0])
    return best if _judged(path, runs[best]) else None


def _judged(path: str, run: Recorded) -> bool:
    """Whether a run does at all what a metric measures."""
    name = path.split(".")[2 if path.startswith(WINDOW) else 0]
    if name.startswith("fault_estimate") or (path.startswith(DIAGNOSIS) and "tracking" not in path):
        return has_observer(run)
    return not name.startswith("disturbance_estimate") or run.disturbance_observer != NO_OBSERVER
