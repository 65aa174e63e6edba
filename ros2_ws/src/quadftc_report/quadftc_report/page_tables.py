"""Tables of the page: metrics with the axes side by side, parameters, and where the runs come from."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Iterable, Sequence
from typing import Any, cast

from quadftc_flight.run_directory import RecordedRun
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_report.metrics_table import Cell, MetricsTable, Row
from quadftc_report.wording import plain

NOTHING = "–"  # there is no such thing in this run
WINDOWS = ("Fault window", "Diagnosis of")  # sections that begin so go into a table of their own


@dataclasses.dataclass(frozen=True)
class Place:
    """A number of `MetricsTable` on the page: the cell, its run and axis, and whether it is the best."""

    cell: Cell
    run: str
    axis: str | None
    best: bool


@dataclasses.dataclass(frozen=True)
class Line:
    """One metric: all axes of all runs, run by run."""

    label: str
    unit: str
    path: str  # without the axis
    places: tuple[tuple[Place, ...], ...]  # for each run its axes, or one number for all


@dataclasses.dataclass(frozen=True)
class Group:
    """The lines of a section."""

    title: str
    lines: tuple[Line, ...]


def metric_groups(table: MetricsTable) -> tuple[list[Group], list[Group]]:
    """Put the axes of each metric side by side.

    Returns
    -------
    flight, windows : lists of Group
        What holds for the flight as a whole, and for each fault window by itself.
    """
    groups: list[Group] = []
    for title, section in itertools.groupby(table.rows, key=lambda row: row.section):
        lines = (_line(table, list(rows)) for _, rows in itertools.groupby(section, key=_without_axis))
        groups.append(Group(title, tuple(lines)))
    return (
        [group for group in groups if not group.title.startswith(WINDOWS)],
        [group for group in groups if group.title.startswith(WINDOWS)],
    )


def _without_axis(row: Row) -> str:
    return row.path.removesuffix(f".{row.axis}") if row.axis else row.path


def _line(table: MetricsTable, rows: Sequence[Row]) -> Line:
    """Rows of one metric; an axis without a row has no number."""
    first = rows[0]
    by_axis = {row.axis: row for row in rows}
    axes: Sequence[str | None] = (None,) if None in by_axis else AXES
    places = tuple(
        tuple(_place(by_axis.get(axis), column, run, axis) for axis in axes)
        for column, run in enumerate(table.runs)
    )
    return Line(first.label, first.unit, _without_axis(first), places)


def _place(row: Row | None, column: int, run: str, axis: str | None) -> Place:
    if row is None:
        return Place(Cell(None, NOTHING), run, axis, best=False)
    return Place(row.cells[column], run, axis, best=row.best == column)


@dataclasses.dataclass(frozen=True)
class Fact:
    """Something that each run has: a line of a table with a column for each run."""

    name: str
    values: tuple[str, ...]

    @property
    def differs(self) -> bool:
        """Whether the runs differ in it."""
        return len(set(self.values)) > 1


def parameters(runs: Sequence[Recorded]) -> list[tuple[str, list[Fact]]]:
    """Return the parameters of every node, in SI units: pairs of a node and its facts."""
    nodes = _names(run.parameters for run in runs)
    return [
        (
            node,
            [
                Fact(name, tuple(_text(run.parameters.get(node, {}), name) for run in runs))
                for name in _names(run.parameters.get(node, {}) for run in runs)
            ],
        )
        for node in nodes
    ]


def origins(runs: Sequence[RecordedRun]) -> list[Fact]:
    """Return where each run comes from: seed, rate, length, how it was flown, versions, commit."""
    summaries = [run.summary for run in runs]
    facts = [
        Fact("seed", tuple(str(item["seed"]) for item in summaries)),
        Fact("rate [Hz]", tuple(plain(item["rate"]) for item in summaries)),
        Fact("recorded [s]", tuple(f"{run.duration:g} of {run.scenario.duration:g}" for run in runs)),
        Fact("samples", tuple(str(item["samples"]) for item in summaries)),
        Fact("of them withheld", tuple(str(item["samples_withheld"]) for item in summaries)),
        Fact("mode", tuple(str(item.get("mode", NOTHING)) for item in summaries)),
        Fact("graph", tuple(str(item.get("graph", NOTHING)) for item in summaries)),
    ]
    return facts + _made_with(runs)


def replay_origins(runs: Sequence[RecordedReplay]) -> list[Fact]:
    """Return what each replay is of and where it comes from."""
    origins = [run.origin for run in runs]
    summaries = [run.summary for run in runs]
    facts = [
        Fact("recording", tuple(origin.recording for origin in origins)),
        Fact("topic", tuple(origin.topic for origin in origins)),
        Fact("torque", tuple(origin.torque for origin in origins)),
        Fact("truth", tuple(origin.truth for origin in origins)),
        Fact("rate [Hz]", tuple(plain(item["rate"]) for item in summaries)),
        Fact("replayed [s]", tuple(f"{run.duration:.6g} of {run.origin.duration:.6g}" for run in runs)),
        Fact("samples", tuple(f"{len(run.flight)} of {run.origin.samples}" for run in runs)),
        Fact("of them withheld", tuple(str(item["samples_withheld"]) for item in summaries)),
        Fact("left out of the recording", tuple(str(sum(origin.left_out.values())) for origin in origins)),
    ]
    return facts + _made_with(runs)


def _made_with(runs: Sequence[Recorded]) -> list[Fact]:
    versions = _names(run.versions for run in runs)
    return [
        Fact("read from", tuple(str(run.path) for run in runs)),
        *(Fact(name, tuple(run.versions.get(name, NOTHING) for run in runs)) for name in versions),
    ]


def _names(mappings: Iterable[Any]) -> list[str]:
    """Keys of all mappings, in the order in which they come up."""
    return list(dict.fromkeys(name for mapping in mappings for name in mapping))


def _text(values: dict[str, Any], name: str) -> str:
    if name not in values:
        return NOTHING
    value = values[name]
    if isinstance(value, str):
        return value
    if isinstance(value, list) and all(isinstance(item, str) for item in cast("list[Any]", value)):
        return "\n".join(cast("list[str]", value)) or NOTHING
    return json.dumps(value, ensure_ascii=False, default=str)
