# pyright: basic
"""The verdict on a flight log as one HTML page: a sentence and a picture, the timeline, the evidence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from quadftc_flight.junit import write_file
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.found import Curve
from quadftc_replay.inspection.inspect import Inspection
from quadftc_replay.inspection.verdict import Finding, show, unjudged
from quadftc_report.description import Figure, Panel, Shade, Trace
from quadftc_report.draw_plotly import axis, empty_figure, plotly_figure, spec_of
from quadftc_report.page import render_template
from quadftc_report.style import COMPARED, SHADES

PAGE = "report.html"
ROW = 34  # px; of a component in the timeline
JUDGED, NOT_JUDGED, FOUND, DOUBTFUL = "#c9dfd8", SHADES[3], COMPARED[0], COMPARED[3]
SURE = 0.7  # probability from which a finding is drawn as one that is sure
SHORTEST = 0.004  # 1; of the log: a finding is drawn so long at least
FINDING = "finding"
ROLES = ("proposed", "compared")
MAX_ROTORS = 8  # lines in a panel


def write_page(inspection: Inspection, directory: Path) -> Path:
    """Write ``report.html`` into a directory; return its path."""
    directory.mkdir(parents=True, exist_ok=True)
    return write_file(directory / PAGE, render_verdict(inspection))


def render_verdict(inspection: Inspection) -> str:
    """Return the page, HTML that needs no other file."""
    verdict = inspection.verdict
    evidence = [
        (
            number,
            each.finding,
            None if each.curve is None else _curve_figure(number, each.curve, each.finding),
        )
        for number, each in enumerate(inspection.found, 1)
    ]
    drawn = [figure for _, _, figure in evidence if figure is not None]
    signals = _signals_figure(inspection)
    return render_template(
        "verdict.html",
        verdict=verdict,
        first=drawn[0] if drawn else signals,
        timeline=spec_of(_timeline(inspection), "timeline"),
        signals=signals if drawn else None,
        evidence=evidence,
        unjudged=unjudged(verdict.judged, verdict.not_judged),
        show=show,
        spec=lambda figure: spec_of(plotly_figure(figure), figure.key),
    )


def _curve_figure(number: int, curve: Curve, finding: Finding) -> Figure | None:
    if len(curve.time) < 2:
        return None
    span = float(curve.time[0]), float(curve.time[-1])
    end = span[1] if finding.end_s is None else min(finding.end_s, span[1])
    shades = (Shade(max(finding.onset_s, span[0]), max(end, span[0]), FINDING, 1),)
    traces = tuple(_traces(curve.time, curve.lines))
    panel = Panel(
        title=curve.title,
        y_label=curve.title,
        unit=curve.unit.replace("^2", "²"),
        traces=traces,
        shades=shades,
    )
    caption = "; ".join(finding.evidence[:1])
    caption = f"{caption[:1].upper()}{caption[1:]}."
    return Figure(f"finding-{number}", f"{finding.name}, {finding.kind}", caption, (panel,), span)


def _traces(time: np.ndarray, lines: Any) -> Iterator[Trace]:
    for number, (name, values) in enumerate(lines.items()):
        yield Trace(name, ROLES[min(number, 1)], time, np.asarray(values, float), max(number - 1, 0))


def _signals_figure(inspection: Inspection) -> Figure:
    """What was logged, with the findings shaded."""
    log, verdict = inspection.flight.log, inspection.verdict
    end = max(log.end, 1e-3)
    shades = tuple(
        Shade(each.onset_s, end if each.end_s is None else each.end_s, FINDING, 1)
        for each in verdict.findings
    )
    panels = [
        Panel(title=title, y_label=title, unit=unit, traces=tuple(_traces(signal.time, lines)), shades=shades)
        for title, unit, signal, lines in _signals(log, inspection)
    ]
    panels = panels or [Panel(title="nothing", y_label="nothing logged", unit="", traces=())]
    caption = "The main sensors and the rotors over the whole log."
    return Figure("signals", "What was logged", caption, tuple(panels), (0.0, end))


def _signals(
    log: FlightLog, inspection: Inspection
) -> Iterator[tuple[str, str, Signal, dict[str, np.ndarray]]]:
    """Title, unit, samples and lines of each panel."""
    gyro = inspection.flight.gyro
    if gyro is not None:
        yield "body rate", "rad/s", gyro[1], {name: gyro[1].value[:, k] for k, name in enumerate("xyz")}
    force = next(iter(log.accelerometers.values()), None)
    if force is not None:
        yield "specific force", "m/s²", force, {name: force.value[:, k] for k, name in enumerate("xyz")}
    for title, unit, rotors in (
        ("rotor commands", "", log.rotor_commands),
        ("rotor speeds", "rad/s", log.rotor_speeds),
    ):
        if rotors is not None:
            count = min(rotors.value.shape[1], MAX_ROTORS)
            yield title, unit, rotors, {f"rotor {k + 1}": rotors.value[:, k] for k in range(count)}
    if log.battery is not None:
        yield "battery", "V", log.battery, {"voltage": log.battery.value[:, 0]}


def _timeline(inspection: Inspection) -> go.Figure:
    """Bars over time: what was judged of each component, and what was found."""
    verdict, end = inspection.verdict, max(inspection.flight.log.end, 1e-3)
    names = [*dict.fromkeys([*verdict.judged, *(each.component for each in verdict.findings)])]
    missing = unjudged(verdict.judged, verdict.not_judged)
    rows = [*names, *(name for name in missing if name not in names)]
    bars = list(_bars(verdict.findings, inspection, names, missing, end))
    drawing = empty_figure(
        ROW * len(rows) + 110,
        40,
        barmode="overlay",
        hovermode="closest",
        xaxis=axis("time [s]", range=[0.0, end]),
        yaxis=axis("", categoryorder="array", categoryarray=rows[::-1], type="category"),
        bargap=0.25,
    )
    drawing.update_layout(margin={"l": 130, "r": 16, "t": 40, "b": 48})
    for name, colour, parts in bars:
        drawing.add_trace(
            go.Bar(
                name=name,
                orientation="h",
                y=[row for row, _, _, _ in parts],
                base=[start for _, start, _, _ in parts],
                x=[length for _, _, length, _ in parts],
                text=[text for _, _, _, text in parts],
                textposition="none",
                hovertemplate="%{y}: %{text}<extra></extra>",
                marker={"color": colour, "line": {"width": 0}},
            )
        )
    return drawing


def _bars(
    findings: Sequence[Finding],
    inspection: Inspection,
    names: Sequence[str],
    missing: Sequence[str],
    end: float,
) -> Iterator[tuple[str, str, list[tuple[str, float, float, str]]]]:
    """Name, colour and bars (row, begin, length, text) of each kind."""
    flights = [(each.start, each.end - each.start) for each in inspection.flight.intervals]
    judged = [(name, start, length, "judged, in flight") for name in names for start, length in flights]
    if judged:
        yield "judged", JUDGED, judged
    if missing:
        reasons = {name: "; ".join(_reasons(inspection, name)) for name in missing}
        yield "not judged", NOT_JUDGED, [(name, 0.0, end, reasons[name]) for name in missing]
    for title, colour, is_sure in (("fault", FOUND, True), ("doubtful", DOUBTFUL, False)):
        parts = [
            (each.component, each.onset_s, _length(each, end), f"{each.element} {each.kind}".strip())
            for each in findings
            if (each.probability >= SURE) is is_sure
        ]
        if parts:
            yield title, colour, parts


def _length(finding: Finding, end: float) -> float:
    stop = end if finding.end_s is None else finding.end_s
    return max(stop - finding.onset_s, SHORTEST * end)


def _reasons(inspection: Inspection, component: str) -> list[str]:
    return [each.reason for each in inspection.verdict.not_judged if each.component == component]
