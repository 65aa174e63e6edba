"""The metrics of the runs of a comparison side by side, each number with its path in ``summary.json``.

A column for each run and axis. Where less is better, the smallest value is marked as the best; a run that
does not estimate at all is never best at estimating. Below every number stands its change against the
baseline, the first run without a fault observer (the last run, if each has one): ``-95 %`` is a twentieth of
the baseline's value; ten times it and more is a factor, ``x 25``. There is no change against a baseline of
zero, or across zero.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from quadftc_flight.run_directory import NO_OBSERVER
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import Comparison, has_observer, metric
from quadftc_report.metric_kinds import (
    DETAILS,
    DIAGNOSIS,
    SETTLING,
    WINDOW,
    Kind,
    kind_of,
    leaves,
    place_of,
    section_rank,
)
from quadftc_report.tables import Cell, Group, Row, Table, metric_cell, two_heads
from quadftc_report.wording import NOTHING, plain

LARGE = 10.0  # times the baseline; from here on a change is written as a factor
TINY = 1e-12  # in any unit; a smaller number is the rounding of a zero
SMALL = 1e-3  # times the baseline; a smaller number is written as below this


def metric_tables(comparison: Comparison[Recorded], what: str) -> list[Table]:
    """Return every metric of every run: a table of the whole, and one of each fault window and fault.

    A metric that no run has a number for is left out of the diagnosis, where most is about one kind of fault.
    """
    runs = comparison.runs
    baseline = _baseline(runs)
    axes: dict[str, str | None] = dict(leaf for run in runs for leaf in leaves(run.summary["metrics"]))
    found: list[tuple[str, Row]] = []
    for path in sorted(axes, key=place_of):
        section, kind = kind_of(path, runs)
        row = _row(path, AXES if axes[path] else (None,), kind, runs, baseline)
        if not path.startswith(DIAGNOSIS) or any(cell.data and cell.data["value"] for cell in row):
            found.append((section, row))
    came_up = {section: index for index, (section, _) in reversed(list(enumerate(found)))}
    found.sort(key=lambda item: (section_rank(item[0]), came_up[item[0]]))  # stable
    groups = [
        Group(section, tuple(row for _, row in rows))
        for section, rows in itertools.groupby(found, key=lambda item: item[0])
    ]
    labels = [comparison.label(run) for run in runs]
    note = (
        ""
        if baseline is None
        else f" In bold the best; in small print the change against {labels[baseline]}."
    )
    heads = two_heads(("metric",), [(label, AXES) for label in labels])
    parts = ("Fault window", DETAILS)
    whole = tuple(group for group in groups if not group.title.startswith(parts))
    single = tuple(group for group in groups if group.title.startswith(parts))
    return [
        Table(f"The whole {what}.{note}", heads, whole, "metrics"),
        *([Table(f"Each fault window by itself.{note}", heads, single, "metrics")] if single else []),
    ]


def _baseline(runs: Sequence[Recorded]) -> int | None:
    if len(runs) < 2:
        return None
    return next((index for index, run in enumerate(runs) if not has_observer(run)), len(runs) - 1)


def _row(
    path: str, axes: Sequence[str | None], kind: Kind, runs: Sequence[Recorded], baseline: int | None
) -> Row:
    """The numbers of one metric: run by run its axes, or one number for all."""
    columns = {axis: _cells(path, axis, kind, runs, baseline) for axis in axes}
    unit = f" [{kind.unit}]" if kind.unit else ""
    cells = [columns[axis][index] for index in range(len(runs)) for axis in axes]
    if len(axes) == 1:
        cells = [cell._replace(columns=len(AXES)) for cell in cells]
    starts = [
        cell._replace(look=f"{cell.look} run") if i % len(axes) == 0 else cell for i, cell in enumerate(cells)
    ]
    return Cell(f"{kind.label}{unit}"), *starts


def _cells(
    path: str, axis: str | None, kind: Kind, runs: Sequence[Recorded], baseline: int | None
) -> list[Cell]:
    """The number of each run, with its change and whether it is the best."""
    full = f"{path}.{axis}" if axis else path
    found = [metric(run, full) for run in runs]
    values = [float(value) if isinstance(value, (int, float)) else None for value in found]
    verdicts = any(isinstance(value, bool) for value in found)
    compared = not verdicts and (kind.less_is_better or not path.startswith(DIAGNOSIS))
    base = values[baseline] if baseline is not None and compared else None
    best = None if verdicts else _best(values, kind, path, runs)
    return [
        metric_cell(
            value,
            run.name,
            path,
            axis,
            _text(found[index], kind, path, full, run),
            "best" if index == best else "",
        )._replace(small="" if index == baseline else _change(value, base))
        for index, (run, value) in enumerate(zip(runs, values, strict=True))
    ]


def _text(found: Any, kind: Kind, path: str, full: str, run: Recorded) -> str:
    """A number for people; an estimate that was there all the time and did not settle says so."""
    if found is None:
        never = SETTLING in path and metric(run, full.replace(SETTLING, "fault_estimate_max_deg")) is not None
        return "never" if never else NOTHING
    if isinstance(found, bool):
        return "yes" if found else "no"
    return plain(kind.scale * found) if abs(found) >= TINY else "0"


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


def _best(values: Sequence[float | None], kind: Kind, path: str, runs: Sequence[Recorded]) -> int | None:
    """The smallest of several values, if it is the only one and its run estimates at all."""
    known = sorted(value for value in values if value is not None)
    if not kind.less_is_better or len(values) < 2 or not known or known[:1] == known[1:2]:
        return None
    best = values.index(known[0])
    return best if _is_judged(path, runs[best]) else None


def _is_judged(path: str, run: Recorded) -> bool:
    """Whether a run has the part that a metric measures."""
    name = path.split(".")[2 if path.startswith(WINDOW) else 0]
    if name.startswith("fault_estimate") or (path.startswith(DIAGNOSIS) and "tracking" not in path):
        return has_observer(run)
    return not name.startswith("disturbance_estimate") or run.disturbance_observer != NO_OBSERVER
