# pyright: basic
"""The report as one HTML page: a section for each scenario and for each recording that was replayed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import jinja2
from plotly.offline import get_plotlyjs

from quadftc_model.samples import AXES
from quadftc_report.comparison import Comparison, has_observer
from quadftc_report.drawing import Drawing, drawings
from quadftc_report.figures import figures
from quadftc_report.measures import axis_metric
from quadftc_report.metrics_table import MetricsTable, metrics_table
from quadftc_report.page_tables import Fact, Group, metric_groups, origins, parameters
from quadftc_report.paper import Judgement, Verdict, judge
from quadftc_report.real_sensors import TITLE, beyond_the_paper
from quadftc_report.replay_page import CONFUSION, DECLARED, OVERVIEW, TRUTHS, ReplaySection, overview, pooled
from quadftc_report.statements import Paragraph, statements
from quadftc_report.templating import environment
from quadftc_report.wording import counted, listing

KEY_METRICS = (
    ("tracking_rmse_deg", "tracking RMSE [deg]"),
    ("fault_estimate_max_settled_deg", "fault estimate: largest settled error [deg]"),
)  # of the table at the top: dotted path, heading
ELSEWHERE = ("paper", "checks", "recording")  # paragraphs that are not told under "What happened"


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Section:
    """All that the page says of one scenario."""

    comparison: Comparison
    drawings: tuple[Drawing, ...]
    paragraphs: Mapping[str, Paragraph]  # by key
    judgements: tuple[Judgement, ...]
    table: MetricsTable

    @property
    def story(self) -> list[Paragraph]:
        """What happened, in words."""
        return [paragraph for key, paragraph in self.paragraphs.items() if key not in ELSEWHERE]

    @property
    def groups(self) -> tuple[list[Group], list[Group]]:
        """Metrics of the flight, and of each fault window."""
        return metric_groups(self.table)

    @property
    def parameters(self) -> list[tuple[str, list[Fact]]]:
        """Parameters of every node."""
        return parameters(self.comparison.runs)

    @property
    def origins(self) -> list[Fact]:
        """Where the runs come from."""
        return origins(self.comparison.runs)

    @property
    def verdicts(self) -> list[tuple[Verdict, int]]:
        """How many of the paper's claims got each verdict, where any did."""
        found = [judgement.verdict for judgement in self.judgements]
        return [(verdict, found.count(verdict)) for verdict in Verdict if verdict in found]


def sections(comparisons: Sequence[Comparison], folder: str | None) -> list[Section]:
    """Gather what the page says.

    Parameters
    ----------
    comparisons : sequence of Comparison
    folder : str, optional
        Directory of the figures for print, beside the page; None: there are none.

    Returns
    -------
    list of Section
        Those with figures of the paper first, in its order; on sensors that are not ideal, last.
    """
    made = [_section(comparison, comparisons, folder) for comparison in comparisons]
    return sorted(made, key=lambda part: (not part.comparison.ideal, _first_figure(part)))


def _section(comparison: Comparison, among: Sequence[Comparison], folder: str | None) -> Section:
    return Section(
        comparison=comparison,
        drawings=drawings(figures(comparison), folder),
        paragraphs={paragraph.key: paragraph for paragraph in statements(comparison, among)},
        judgements=tuple(judge(comparison, among)),
        table=metrics_table(comparison),
    )


def _first_figure(part: Section) -> float:
    numbers = [number for drawing in part.drawings for number in drawing.figure.paper_figures]
    return min(numbers, default=float("inf"))


def render(parts: Sequence[Section], warnings: Iterable[str], replayed: Sequence[ReplaySection] = ()) -> str:
    """Return the page: HTML that needs no other file.

    Parameters
    ----------
    parts : sequence of Section
    warnings : iterable of str
        To be told at the top.
    replayed : sequence of ReplaySection
    """
    replays = [part.comparison for part in replayed]
    flown = [run for part in parts for run in part.comparison.runs]
    every = [*flown, *(run for comparison in replays for run in comparison.runs)]
    return (
        _environment()
        .get_template("report.html")
        .render(
            axes=AXES,
            ideal=[part for part in parts if part.comparison.ideal],
            real=[part for part in parts if not part.comparison.ideal],
            replayed=list(replayed),
            pooled=pooled(replays),
            heading=heading(parts, replayed),
            versions=listing(sorted({run.versions.get("quadftc", "unknown") for run in every})),
            beyond=beyond_the_paper([part.comparison for part in parts]),
            beyond_title=TITLE,
            warnings=list(warnings),
            key_metrics=KEY_METRICS,
            plotly_js=get_plotlyjs(),
        )
    )


def heading(parts: Sequence[Section], replayed: Sequence[ReplaySection]) -> str:
    """Say what the report is on: ``2 recorded runs of 1 scenario and 3 replays of 2 recordings``."""
    told: list[str] = []
    for of, one, among in ((parts, "recorded run", "scenario"), (replayed, "replay", "recording")):
        count = sum(len(part.comparison.runs) for part in of)
        if count:
            told.append(f"{counted(count, one)} of {counted(len(of), among)}")
    return listing(told)


def _environment() -> jinja2.Environment:
    made = environment("quadftc_report.report")
    made.globals.update(
        axis_metric=axis_metric,
        has_observer=has_observer,
        overview=overview,
        overview_columns=OVERVIEW,
        confusion_rows=TRUTHS,
        confusion_columns=DECLARED,
        confusion_path=CONFUSION,
    )
    return made
