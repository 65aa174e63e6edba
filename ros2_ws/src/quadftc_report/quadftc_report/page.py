# pyright: basic
"""The report as one HTML page: a section for each scenario and for each recording that was replayed."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from urllib.parse import quote

import jinja2
import numpy as np
from plotly.offline import get_plotlyjs

from quadftc_flight.diagnosis_metrics import pool
from quadftc_flight.diagnosis_metrics.fault_statistics import HEADINGS, show_row
from quadftc_flight.run_directory import RecordedRun
from quadftc_model.samples import AXES
from quadftc_model.stepper import MAX_GAP
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_report.comparison import Comparison, axis_metric, has_observer, is_ideal, metric
from quadftc_report.description import Figure
from quadftc_report.draw_plotly import figure_spec
from quadftc_report.figures import flight_figures, replay_figures
from quadftc_report.injected import list_injections
from quadftc_report.metric_table import metric_tables
from quadftc_report.paper import Judgement, Verdict, judge
from quadftc_report.run_sentences import SensorVerdict, judge_on_real_sensors, tell_run
from quadftc_report.tables import Cell, Group, Table, fact_table, metric_cell, two_heads
from quadftc_report.wording import NOTHING, counted, listing, plain, sentence

KEY_METRICS = {
    "tracking_rmse_deg": "tracking RMSE [deg]",
    "fault_estimate_max_settled_deg": "fault estimate: largest settled error [deg]",
}  # of the table at the top
VERDICT_LOOKS = {
    Verdict.AGREES: ("good", "✓"),
    Verdict.DISAGREES: ("bad", "✗"),
    Verdict.CANNOT_SAY: ("faint", "?"),
}


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Section:
    """Everything on the page about one scenario or recording."""

    comparison: Comparison[Any]
    title: str
    figures: list[Figure]
    sentences: list[str]  # one for each run
    metrics: list[Table]
    injected: Table
    setup: dict[str, Table]  # by heading
    lead: str = ""
    scenario_text: str = ""
    checks: Table | None = None  # of flights
    judgements: Sequence[Judgement] = ()  # of the paper's claims
    sensor_verdicts: Sequence[SensorVerdict] = ()  # where the sensors are not ideal
    ideal: bool = True

    @property
    def key(self) -> str:
        """Anchor of the section."""
        return self.comparison.key


def flight_sections(comparisons: Sequence[Comparison[RecordedRun]]) -> list[Section]:
    """Gather flights: in the order of the paper's figures; those on sensors that are not ideal last."""
    made = [_flight_section(comparison, comparisons) for comparison in comparisons]

    def order(part: Section) -> tuple[bool, float]:
        numbers = [number for figure in part.figures for number in figure.paper_figures]
        return not part.ideal, min(numbers, default=float("inf"))

    return sorted(made, key=order)


def _flight_section(comparison: Comparison[RecordedRun], among: Sequence[Comparison[RecordedRun]]) -> Section:
    scenario, ideal = comparison.runs[0].scenario, is_ideal(comparison)
    return Section(
        title=comparison.key,
        lead=sentence(scenario.description.strip().rstrip(".")),
        figures=flight_figures(comparison),
        judgements=judge(comparison, among),
        sensor_verdicts=[] if ideal else judge_on_real_sensors(comparison),
        ideal=ideal,
        checks=_checks(comparison),
        scenario_text=scenario.text,
        **_shared(comparison, "flight", _flight_origins(comparison.runs)),
    )


def replay_sections(comparisons: Sequence[Comparison[RecordedReplay]]) -> list[Section]:
    """Gather replays."""
    return [
        Section(
            title=comparison.runs[0].origin.recording,
            figures=replay_figures(comparison),
            **_shared(comparison, "replay", _replay_origins(comparison.runs)),
        )
        for comparison in comparisons
    ]


def _shared(comparison: Comparison[Any], what: str, origins: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """What flights and replays have in common."""
    runs = comparison.runs
    labels = [comparison.label(run) for run in runs]
    versions = dict.fromkeys(name for run in runs for name in run.versions)
    made_with = {
        "read from": [str(run.path) for run in runs],
        **{name: [run.versions.get(name, NOTHING) for run in runs] for name in versions},
    }
    return {
        "comparison": comparison,
        "sentences": [tell_run(comparison, run) for run in runs],
        "metrics": metric_tables(comparison, what),
        "injected": _injected(comparison.longest),
        "setup": {
            "Parameters of every node": fact_table(
                "In SI units; where the runs differ, in bold.", labels, _parameters(runs)
            ),
            "Origin, versions and seed": fact_table("", labels, {"": {**origins, **made_with}}),
        },
    }


def render(
    parts: Sequence[Section], warnings: Iterable[str], replayed: Sequence[Section], folder: str | None
) -> str:
    """Return the page: HTML that needs no other file.

    Parameters
    ----------
    parts, replayed : sequences of Section
        Of flights, of replays.
    warnings : iterable of str
        Shown at the top.
    folder : str, optional
        Directory of the figures for print, beside the page; None: there are none.
    """
    versions = {
        run.versions.get("quadftc", "unknown") for part in (*parts, *replayed) for run in part.comparison.runs
    }

    def files(figure: Figure) -> dict[str, str]:
        kinds = ("png", "pdf") if folder is not None else ()
        return {kind.upper(): quote(f"{folder}/{figure.key}.{kind}") for kind in kinds}

    return render_template(
        "report.html",
        ideal=[part for part in parts if part.ideal],
        real=[part for part in parts if not part.ideal],
        replayed=replayed,
        summary=_summary(parts),
        overview=_overview(replayed),
        heading=_heading(parts, replayed),
        versions=listing(sorted(versions)),
        warnings=list(warnings),
        verdict_looks=VERDICT_LOOKS,
        files=files,
        spec=figure_spec,
    )


def render_template(template: str, **values: Any) -> str:
    """Render a template: everything is escaped, and a missing value is an error."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("quadftc_report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(template).render(plotly_js=get_plotlyjs(), **values)


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


def _summary(parts: Sequence[Section]) -> Table:
    groups = [
        Group(
            part.title, tuple(_summary_row(part, run) for run in part.comparison.runs), part.key, _marks(part)
        )
        for part in parts
    ]
    heads = two_heads(("run", "checks passed"), [(title, AXES) for title in KEY_METRICS.values()])
    claims = "; and how many of the paper's claims hold" if any(part.judgements for part in parts) else ""
    caption = f"Each run with its fault observer, disturbance observer and controller{claims}."
    return Table(caption, heads, tuple(groups), "summary")


def _summary_row(part: Section, run: RecordedRun) -> tuple[Cell, ...]:
    checks = run.summary["checks"]
    passed = sum(check["passed"] for check in checks)
    look, sign = ("good", "✓") if passed == len(checks) else ("bad", "✗")
    cells = [Cell(f"{sign} {passed} of {len(checks)}", look) if checks else Cell("none", "faint")]
    for path in KEY_METRICS:
        if path.startswith("fault_estimate") and not has_observer(run):
            cells.append(Cell("no fault observer", "run faint", columns=len(AXES)))
        else:
            values = axis_metric(run, path).items()
            cells += [
                metric_cell(value, run.name, path, axis, None, "run" * (axis == AXES[0]))
                for axis, value in values
            ]
    parts = f"{run.observer}, {run.disturbance_observer}, {run.scheme.controller.kind}"
    return Cell(part.comparison.label(run), small=parts), *cells


def _marks(part: Section) -> tuple[Cell, ...]:
    """How many of the paper's claims got each verdict."""
    found = [judgement.verdict for judgement in part.judgements]
    words = {
        Verdict.AGREES: ("agrees", "agree"),
        Verdict.DISAGREES: ("disagrees", "disagree"),
        Verdict.CANNOT_SAY: ("not judged", "not judged"),
    }
    marks = []
    for verdict, (look, sign) in VERDICT_LOOKS.items():
        count = found.count(verdict)
        if count:
            marks.append(Cell(f"{sign} {counted(count, 'claim')} {words[verdict][count > 1]}", look))
    return tuple(marks)


def _overview(parts: Sequence[Section]) -> Table:
    """Every replay in a line, and each observer with several whole replays in another."""
    groups = [
        Group(
            part.title,
            tuple(_overview_row(part.comparison.label(run), [run]) for run in part.comparison.runs),
            part.key,
        )
        for part in parts
    ]
    several = pool_replays([part.comparison for part in parts])
    if several:
        rows = (_overview_row(f"{runs[0].observer}, {len(runs)} replays", runs) for runs in several)
        groups.append(Group("the same observer with the same parameters, all faults together", tuple(rows)))
    caption = "Faults missed, detection delays, errors of the estimate and false alarms of each replay."
    heads = tuple(Cell(heading) for heading in ("replay", *HEADINGS[1:]))
    return Table(caption, (heads,), tuple(groups), "summary")


def _overview_row(name: str, runs: Sequence[RecordedReplay]) -> tuple[Cell, ...]:
    observer = runs[0].observer
    cells = show_row(pool(metric(run, "diagnosis") for run in runs))
    return Cell(name, small="" if name.startswith(observer) else observer), *map(Cell, cells)


def pool_replays(comparisons: Sequence[Comparison[RecordedReplay]]) -> list[list[RecordedReplay]]:
    """Return the whole replays of each observer that has several; of each comparison, one counts."""
    groups: dict[str, list[RecordedReplay]] = {}
    for comparison in comparisons:
        whole = [run for run in comparison.runs if run.is_whole]
        first = {json.dumps(run.summary["parameters"], sort_keys=True): run for run in reversed(whole)}
        for key, run in first.items():
            groups.setdefault(key, []).append(run)
    return [runs for runs in groups.values() if len(runs) > 1]


def _injected(run: Recorded) -> Table:
    rows = tuple(tuple(map(Cell, each)) for each in list_injections(run))
    heads = (Cell("when"), Cell("where"), Cell("fault or disturbance"))
    caption = "Faults of the sensor, and disturbances." if rows else "No fault and no disturbance."
    return Table(caption, (heads,), (Group("", rows),))


def _checks(comparison: Comparison[RecordedRun]) -> Table:
    groups = [
        Group(
            comparison.label(run),
            tuple(
                (
                    Cell(check["metric"], "code"),
                    Cell(check["axis"] or ""),
                    metric_cell(check["value"], run.name, check["metric"], check["axis"]),
                    Cell(check["bound"]),
                    Cell("✓ passed", "good") if check["passed"] else Cell("✗ FAILED", "bad"),
                )
                for check in run.summary["checks"]
            ),
        )
        for run in comparison.runs
        if run.summary["checks"]
    ]
    heads = tuple(map(Cell, ("metric", "axis", "value", "required", "verdict")))
    caption = (
        "What the scenario requires of each scheme." if groups else "The scenario checked none of these runs."
    )
    return Table(caption, (heads,), tuple(groups))


def _parameters(runs: Sequence[Recorded]) -> dict[str, dict[str, list[str]]]:
    """Node to parameter to its value in each run, in SI units."""
    nodes = dict.fromkeys(node for run in runs for node in run.parameters)
    found: dict[str, dict[str, list[str]]] = {}
    for node in nodes:
        sets = [run.parameters.get(node, {}) for run in runs]
        names = dict.fromkeys(name for each in sets for name in each)
        found[node] = {name: [_value_text(each.get(name)) for each in sets] for name in names}
    return found


def _value_text(value: Any) -> str:
    if value is None:
        return NOTHING
    if isinstance(value, str):
        return value
    if isinstance(value, list) and all(isinstance(item, str) for item in value):
        return "\n".join(value) or NOTHING
    return json.dumps(value, ensure_ascii=False, default=str)


def _flight_origins(runs: Sequence[RecordedRun]) -> dict[str, list[str]]:
    summaries = [run.summary for run in runs]
    return {
        "seed": [str(item["seed"]) for item in summaries],
        "rate [Hz]": [plain(item["rate"]) for item in summaries],
        "recorded [s]": [f"{run.duration:g} of {run.scenario.duration:g}" for run in runs],
        "samples": [str(item["samples"]) for item in summaries],
        "of them withheld": [str(item["samples_withheld"]) for item in summaries],
        "mode": [str(item.get("mode", NOTHING)) for item in summaries],
        "graph": [str(item.get("graph", NOTHING)) for item in summaries],
    }


def _replay_origins(runs: Sequence[RecordedReplay]) -> dict[str, list[str]]:
    origins, summaries = [run.origin for run in runs], [run.summary for run in runs]
    left_out = [
        [f"{count} ({reason})" for reason, count in origin.left_out.items() if count] for origin in origins
    ]
    return {
        "recording": [origin.recording for origin in origins],
        "topic": [origin.topic for origin in origins],
        "torque": [origin.torque for origin in origins],
        "truth": [origin.truth for origin in origins],
        "rate [Hz]": [plain(item["rate"]) for item in summaries],
        "replayed [s]": [f"{run.duration:.6g} of {run.origin.duration:.6g}" for run in runs],
        "samples": [f"{len(run.flight)} of {run.origin.samples}" for run in runs],
        "of them withheld": [str(item["samples_withheld"]) for item in summaries],
        "without a usable attitude": [_unusable(run, run.measured.angles) for run in runs],
        "without a usable body rate": [_unusable(run, run.measured.body_rate) for run in runs],
        f"gaps of more than {MAX_GAP:g} s": [str(np.sum(np.diff(run.flight.time) > MAX_GAP)) for run in runs],
        "left out of the recording": [listing(each) or "0" for each in left_out],
    }


def _unusable(run: RecordedReplay, values: np.ndarray) -> str:
    return str(np.sum(run.flight.delivered & ~np.isfinite(values).all(axis=1)))
