# pyright: basic
"""The report as one HTML page: a section for each scenario and for each recording that was replayed."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

import jinja2
import numpy as np
from plotly.offline import get_plotlyjs

from quadftc_flight.diagnosis_metrics import pool
from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import Scenario
from quadftc_model.samples import AXES
from quadftc_model.stepper import MAX_GAP
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_report import comparison as about
from quadftc_report.claims import PAPER_SCENARIOS, Judgement, judge
from quadftc_report.comparison import Comparison, is_ideal, metric
from quadftc_report.confusion import ConfusionTable, confusion_tables
from quadftc_report.description import Figure
from quadftc_report.draw_plotly import plotly_figure, spec_of
from quadftc_report.figures import flight_figures, replay_figures
from quadftc_report.headline import headline
from quadftc_report.overview import HEADINGS, overview_row
from quadftc_report.tables import metric_tables
from quadftc_report.wording import NOTHING, counted, listing, plain, short, unbroken

KEY_METRICS = {
    "tracking_rmse_deg": "tracking RMSE [deg]",
    "fault_estimate_max_settled_deg": "fault estimate: largest settled error [deg]",
}  # of the summary
VERDICTS = {
    True: ("good", "✓", "agrees"),
    False: ("bad", "✗", "disagrees"),
    None: ("faint", "?", "cannot say"),
}  # whether a claim holds -> look, sign, word

Facts = dict[str, dict[str, list[str]]]  # group to name to the text of each run


CHAPTERS = ("ideal", "real", "own")  # of flights
ON_REAL_SENSORS = tuple(f"mems{name.removeprefix('paper')}" for name in PAPER_SCENARIOS)


@dataclasses.dataclass(frozen=True, eq=False)
class Section:
    """What the page says about one scenario or recording, besides its tables."""

    comparison: Comparison[Any]
    title: str
    figures: list[Figure]
    judgements: Sequence[Judgement] = ()  # of the paper's claims
    ideal: bool = True

    key = property(attrgetter("comparison.key"))  # anchor of the section

    @property
    def scenario(self) -> Scenario | None:
        """What was flown; of replays None."""
        return getattr(self.comparison.runs[0], "scenario", None)

    @property
    def chapter(self) -> str:
        """Where on the page it stands: the paper's scenarios, these on real sensors, all others."""
        name = self.scenario.name if self.scenario is not None else ""
        if self.ideal and name in PAPER_SCENARIOS:
            return "ideal"
        return "real" if name in (*PAPER_SCENARIOS, *ON_REAL_SENSORS) else "own"

    @property
    def checks(self) -> dict[str, list[Metrics]]:
        """What became of the checks of each run or replay that has any."""
        found = ((self.comparison.label(run), run.summary.get("checks")) for run in self.comparison.runs)
        return {label: checks for label, checks in found if checks}

    @property
    def undecided(self) -> dict[str, int]:
        """Why claims cannot be judged, and how many each reason is for."""
        return Counter(each.reason for each in self.judgements if each.holds is None)


def flight_sections(comparisons: Sequence[Comparison[RecordedRun]]) -> list[Section]:
    """Gather flights: in the order of the paper's figures, then on real sensors, then other scenarios."""

    def order(part: Section) -> tuple[int, float]:
        numbers = [number for figure in part.figures for number in figure.paper_figures]
        return CHAPTERS.index(part.chapter), min(numbers, default=float("inf"))

    parts = ((each, each.key, flight_figures(each), judge(each, comparisons)) for each in comparisons)
    return sorted((Section(*part, is_ideal(part[0])) for part in parts), key=order)


def replay_sections(comparisons: Sequence[Comparison[RecordedReplay]]) -> list[Section]:
    """Gather replays."""
    return [Section(each, each.runs[0].origin.recording, replay_figures(each)) for each in comparisons]


def render(
    parts: Sequence[Section], warnings: Sequence[str], replayed: Sequence[Section], folder: str | None
) -> str:
    """Return the page of flights and replays, HTML that needs no other file.

    ``folder`` holds the figures for print, beside the page; None: there are none.
    """
    runs = [run for part in (*parts, *replayed) for run in part.comparison.runs]
    # the page begins with the comparison that shows most
    headlines = [(part, headline(part.comparison)) for part in (*parts, *replayed)]
    shown, clearest = max(headlines, key=lambda pair: pair[1].contrast)
    picture = clearest.picture()
    if picture is not None and len(headlines) > 1:
        picture = dataclasses.replace(picture, title=f"{shown.title}: {picture.title.lower()}")

    return render_template(
        "report.html",
        flown={chapter: [part for part in parts if part.chapter == chapter] for chapter in CHAPTERS},
        replayed=replayed,
        about=about,
        axes=AXES,
        key_metrics=KEY_METRICS,
        overview_heads=HEADINGS,
        overview_row=lambda runs: overview_row(pool(metric(run, "diagnosis") for run in runs)),
        several=pool_replays([part.comparison for part in replayed]),
        heading=_heading(parts, replayed),
        headlines=headlines,
        picture=picture,
        versions=listing(sorted({run.versions.get("quadftc", "unknown") for run in runs})),
        warnings=warnings,
        verdicts=VERDICTS,
        metric_tables=metric_tables,
        confusion_tables=_confusion_tables,
        setup=_setup,
        folder=folder,
        spec=lambda figure: spec_of(plotly_figure(figure), figure.key),
    )


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("quadftc_report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"short": short, "unbroken": unbroken}
    environment.globals["plotly_js"] = get_plotlyjs
    return environment


def render_template(template: str, **values: object) -> str:
    """Render a template: everything is escaped, and a missing value is an error."""
    return _environment().get_template(template).render(values)


def _heading(parts: Sequence[Section], replayed: Sequence[Section]) -> str:
    """Title of the page: ``2 recorded runs of 1 scenario and 3 replays of 2 recordings``."""
    kinds = ((parts, "recorded run", "scenario"), (replayed, "replay", "recording"))
    return listing(
        [
            f"{counted(sum(len(part.comparison.runs) for part in of), one)} of {counted(len(of), among)}"
            for of, one, among in kinds
            if of
        ]
    )


def pool_replays(comparisons: Sequence[Comparison[RecordedReplay]]) -> list[list[RecordedReplay]]:
    """Return the whole replays of each observer that has several; of each comparison, one counts."""
    groups: dict[str, list[RecordedReplay]] = {}
    for comparison in comparisons:
        whole = [run for run in comparison.runs if run.is_whole]
        first = {json.dumps(run.summary["parameters"], sort_keys=True): run for run in reversed(whole)}
        for key, run in first.items():
            groups.setdefault(key, []).append(run)
    return [runs for runs in groups.values() if len(runs) > 1]


def _confusion_tables(comparison: Comparison[Recorded]) -> list[ConfusionTable]:
    """Which sensors and rotors each run names."""
    labels = map(comparison.label, comparison.runs)
    sensors, rotors = (
        [metric(run, f"{of}.confusion_s") or {} for run in comparison.runs] for of in ("sensors", "rotors")
    )
    return confusion_tables(zip(labels, sensors, rotors, strict=True))


def _setup(comparison: Comparison[Recorded]) -> dict[str, Facts]:
    """Parameters and origin of the runs side by side, by heading."""
    runs = comparison.runs
    return {
        "Parameters of every node": _side_by_side([run.parameters for run in runs]),
        "Origin, versions and seed": _side_by_side([{"": _origin(run)} for run in runs]),
    }


def _side_by_side(facts: Sequence[Mapping[str, Mapping[str, object]]]) -> Facts:
    found: Facts = {}
    for index, each in enumerate(facts):
        for title, part in each.items():
            group = found.setdefault(title, {})
            for name, value in part.items():
                group.setdefault(name, [NOTHING] * len(facts))[index] = _fact_text(value)
    return found


def _fact_text(value: object) -> str:
    items = value if isinstance(value, list) else [value]
    if all(isinstance(item, str) for item in items):
        return "\n".join(map(str, items)) or NOTHING
    return NOTHING if value is None else json.dumps(value, ensure_ascii=False, default=str)


def _origin(run: Recorded) -> Mapping[str, object]:
    """Where a recording comes from, how much of it is there, and what it was made with."""
    summary = run.summary
    common = {"rate [Hz]": plain(summary["rate"]), "of them withheld": summary["samples_withheld"]}
    made_with = {"read from": str(run.path), **run.versions}
    if isinstance(run, RecordedRun):
        recorded = f"{run.duration:g} of {run.scenario.duration:g}"
        own = {"seed": summary["seed"], "recorded [s]": recorded, "samples": summary["samples"]}
        return {**own, **common, "mode": summary.get("mode"), "graph": summary.get("graph"), **made_with}
    origin, delivered = run.origin, run.flight.delivered
    readings = {"attitude": run.measured.angles, "body rate": run.measured.body_rate}
    left_out = [f"{count} ({reason})" for reason, count in origin.samples_left_out.items() if count]
    return {
        **{name: getattr(origin, name) for name in ("recording", "topic", "torque", "truth")},
        "replayed [s]": f"{run.duration:.6g} of {origin.duration:.6g}",
        "samples": f"{len(run.flight)} of {origin.samples}",
        **common,
        **{
            f"without a usable {name}": int(np.sum(delivered & ~np.isfinite(values).all(axis=1)))
            for name, values in readings.items()
        },
        f"gaps of more than {MAX_GAP:g} s": int(np.sum(np.diff(run.flight.time) > MAX_GAP)),
        "left out of the recording": listing(left_out) or "0",
        **made_with,
    }
