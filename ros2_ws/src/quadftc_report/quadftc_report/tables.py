"""The tables of a comparison: the metrics of its runs side by side.

There is a column for each run and axis; each number names its path in ``summary.json``. Where less is better,
the smallest value is marked as the best; a run that does not estimate at all is never best at estimating. The
baseline is the first run without a fault observer (the last run, if each has one). Below every number stands
its change against the baseline: ``-95 %`` is a twentieth of the baseline's value; from ten times on it is a
factor, ``x 25``. There is no change against a baseline of zero, or across zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from quadftc_flight.summary import NO_OBSERVER
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import Comparison, has_observer, metric
from quadftc_report.metric_kinds import DETAILS, SECTIONS, SETTLING, Leaf, list_metrics
from quadftc_report.wording import NOTHING, plain

LARGE = 10.0  # times the baseline; from here on a change is written as a factor
SMALL = 1e-3  # times the baseline; a smaller number is written as below this


class Cell(NamedTuple):
    """A cell; ``look``: CSS classes such as ``number``, ``run`` (with a rule on its left), ``best``."""

    text: str
    look: str = ""
    columns: int = 1  # that it spans
    small: str = ""  # small print below
    data: Mapping[str, str] | None = None  # attributes for machines: run, metric, axis, value


Row = tuple[Cell, ...]  # the first cell is its heading


class Table(NamedTuple):
    """A table of metrics; below the label of each run stand the axes."""

    caption: str
    labels: Sequence[str]
    groups: Mapping[str, Sequence[Row]]  # by their heading


def metric_tables(comparison: Comparison[Recorded], what: str) -> list[Table]:
    """Return every metric of every run: a table of the whole, and one of each fault window and fault.

    Of the diagnosis and the position, a metric is left out that no run has a number for.
    """
    runs, baseline, note = comparison.runs, None, ""
    labels = [comparison.label(run) for run in runs]
    if len(runs) > 1:
        plain_runs = (index for index, run in enumerate(runs) if not has_observer(run))
        baseline = next(plain_runs, len(runs) - 1)
        note = f" In bold the best; in small print the change against {labels[baseline]}."
    leaves: dict[str, Leaf] = {}
    for run in runs:
        for leaf in list_metrics(run.summary["metrics"]):
            leaves.setdefault(leaf.path, leaf)
    # the sections of the whole run in their order, then the others as they come
    sections: dict[str, list[Row]] = {title: [] for title in SECTIONS}
    for leaf in leaves.values():
        row = _row(leaf, runs, baseline)
        optional = _is_diagnosis(leaf) or leaf.path.startswith("position_")
        if not optional or any(cell.data and cell.data["value"] for cell in row):
            sections.setdefault(leaf.section, []).append(row)
    whole = {title: rows for title, rows in sections.items() if rows and not title.startswith(DETAILS)}
    single = {title: rows for title, rows in sections.items() if rows and title.startswith(DETAILS)}
    tables = [Table(f"The whole {what}.{note}", labels, whole)]
    return [*tables, Table(f"Each fault window by itself.{note}", labels, single)] if single else tables


def _is_diagnosis(leaf: Leaf) -> bool:
    return leaf.path.startswith(("diagnosis.", "sensors."))


def _row(leaf: Leaf, runs: Sequence[Recorded], baseline: int | None) -> Row:
    """The numbers of one metric: run by run its axes, or one number for all."""
    columns = [_cells(leaf, axis, runs, baseline) for axis in (AXES if leaf.has_axes else (None,))]
    width = 1 if leaf.has_axes else len(AXES)
    starts = [cell._replace(look=f"{cell.look} run", columns=width) for cell in columns[0]]
    cells = [cell for group in zip(starts, *columns[1:], strict=True) for cell in group]
    return Cell(leaf.kind.heading), *cells


def _cells(leaf: Leaf, axis: str | None, runs: Sequence[Recorded], baseline: int | None) -> list[Cell]:
    """The number of each run, with its change and whether it is the best."""
    full = f"{leaf.path}.{axis}" if axis else leaf.path
    found = [metric(run, full) for run in runs]
    values = [float(value) if isinstance(value, (int, float)) else None for value in found]
    verdicts = any(isinstance(value, bool) for value in found)
    compared = not verdicts and (leaf.kind.less_is_better or not _is_diagnosis(leaf))
    base = values[baseline] if baseline is not None and compared else None
    best = None if verdicts else _best(leaf, values, runs)
    cells: list[Cell] = []
    for index, (run, value) in enumerate(zip(runs, values, strict=True)):
        exact = "" if value is None else repr(value)
        data = {"run": run.name, "metric": leaf.path, "axis": axis or "", "value": exact}
        change = "" if index == baseline else _change(value, base)
        look = "number best" if index == best else "number"
        cells.append(Cell(_text(leaf, found[index], full, run), look, small=change, data=data))
    return cells


def _text(leaf: Leaf, found: float | None, full: str, run: Recorded) -> str:
    """A number for people; an estimate that was there all the time and did not settle says so."""
    if found is None:
        never = SETTLING in full and metric(run, full.replace(SETTLING, "fault_estimate_max_deg")) is not None
        return "never" if never else NOTHING
    if isinstance(found, bool):
        return "yes" if found else "no"
    return leaf.kind.text(found)


def _change(value: float | None, base: float | None) -> str:
    """The change against the baseline; empty where there is none."""
    if not base or value is None or value / base < 0.0:
        return ""
    ratio = value / base
    if ratio >= LARGE:
        return f"x {plain(ratio)}"
    if 0.0 < ratio < SMALL:
        return f"below -{plain(100.0 * (1.0 - SMALL))} %"
    change = round(100.0 * (ratio - 1.0), 1)
    return f"{'+' if change > 0.0 else ''}{plain(change)} %"


def _best(leaf: Leaf, values: Sequence[float | None], runs: Sequence[Recorded]) -> int | None:
    """The smallest of several values, if it is the only one and its run estimates at all."""
    known = sorted(value for value in values if value is not None)
    if not leaf.kind.less_is_better or len(values) < 2 or not known or known[:1] == known[1:2]:
        return None
    best = values.index(known[0])
    return best if _estimates(runs[best], leaf) else None


def _estimates(run: Recorded, leaf: Leaf) -> bool:
    """Whether a run has the part that a metric measures."""
    name = leaf.path.split(".")[2 if leaf.path.startswith("fault_windows.") else 0]
    if name.startswith("fault_estimate") or (_is_diagnosis(leaf) and "tracking" not in leaf.path):
        return has_observer(run)
    return not name.startswith("disturbance_estimate") or run.disturbance_observer != NO_OBSERVER
