"""What the page says of replays: a section for each recording, and all of them in one table."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence

from quadftc_flight.diagnosis_metrics import pool
from quadftc_flight.diagnosis_metrics.fault_statistics import HEADINGS, show_row
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import RecordedReplay
from quadftc_report.comparison import ReplayComparison, has_observer
from quadftc_report.drawing import Drawing, drawings
from quadftc_report.measures import metric
from quadftc_report.metrics_table import MetricsTable, metrics_table
from quadftc_report.page_tables import Fact, Group, metric_groups, parameters, replay_origins
from quadftc_report.replay_figures import replay_figures
from quadftc_report.replay_statements import replay_statements
from quadftc_report.statements import Paragraph

OVERVIEW = tuple(HEADINGS[1:])  # columns of the table of all replays, behind the name
CONFUSION = "diagnosis.confusion_single_s"
TRUTHS = {"none": "no axis faulty", **{axis: f"only {axis} faulty" for axis in AXES}}  # rows
DECLARED = {**{axis: axis for axis in AXES}, "none": "nothing", "time": "all the time"}  # columns


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ReplaySection:
    """All that the page says of the replays of one recording."""

    comparison: ReplayComparison
    drawings: tuple[Drawing, ...]
    paragraphs: tuple[Paragraph, ...]
    table: MetricsTable

    @property
    def groups(self) -> tuple[list[Group], list[Group]]:
        """Metrics of the whole replay, and of each fault window."""
        return metric_groups(self.table)

    @property
    def confusions(self) -> list[tuple[RecordedReplay, Mapping[str, Mapping[str, float | None]]]]:
        """Who is blamed for what [s], of each replay that has an observer."""
        return [(run, metric(run, CONFUSION)) for run in self.comparison.runs if has_observer(run)]

    @property
    def parameters(self) -> list[tuple[str, list[Fact]]]:
        """Parameters of the fault injector and the fault observer."""
        return parameters(self.comparison.runs)

    @property
    def origins(self) -> list[Fact]:
        """What was replayed, and where it comes from."""
        return replay_origins(self.comparison.runs)


@dataclasses.dataclass(frozen=True)
class Overview:
    """A line of the table of all replays."""

    name: str
    observer: str
    cells: tuple[str, ...]  # in the order of ``OVERVIEW``


def replay_sections(comparisons: Sequence[ReplayComparison], folder: str | None) -> list[ReplaySection]:
    """Gather what the page says of replays.

    Parameters
    ----------
    comparisons : sequence of ReplayComparison
    folder : str, optional
        Directory of the figures for print, beside the page; None: there are none.
    """
    return [
        ReplaySection(
            comparison=comparison,
            drawings=drawings(replay_figures(comparison), folder),
            paragraphs=tuple(replay_statements(comparison)),
            table=metrics_table(comparison),
        )
        for comparison in comparisons
    ]


def overview(comparison: ReplayComparison) -> list[Overview]:
    """Return the lines of the replays of one recording."""
    return [_overview(comparison.label(run), [run]) for run in comparison.runs]


def pooled(comparisons: Sequence[ReplayComparison]) -> list[Overview]:
    """Return a line for each observer with whole replays in several comparisons; of each, one counts."""
    groups: dict[str, list[RecordedReplay]] = {}
    for comparison in comparisons:
        whole = [run for run in comparison.runs if run.is_whole]
        first = {json.dumps(run.summary["parameters"], sort_keys=True): run for run in reversed(whole)}
        for key, run in first.items():
            groups.setdefault(key, []).append(run)
    several = [runs for runs in groups.values() if len(runs) > 1]
    return [_overview(f"{runs[0].observer}, {len(runs)} replays", runs) for runs in several]


def _overview(name: str, runs: Sequence[RecordedReplay]) -> Overview:
    return Overview(name, runs[0].observer, show_row(pool(metric(run, "diagnosis") for run in runs)))
