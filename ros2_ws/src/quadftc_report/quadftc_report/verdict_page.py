# pyright: basic
"""The verdict on a flight log as one HTML page: the cause and its picture, what happened, what was judged."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadftc_flight.junit import write_file
from quadftc_model.rotations import euler_from_quaternion
from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.found import Curve
from quadftc_replay.inspection.gyro import component_name
from quadftc_replay.inspection.inspect import Inspection
from quadftc_replay.inspection.verdict import Finding, Verdict, doubted, show, unsaid
from quadftc_report.description import Figure, Mark, Panel, Shade, Trace
from quadftc_report.draw_plotly import plotly_figure, spec_of
from quadftc_report.page import render_template

PAGE = "report.html"
HIGH = 1.6  # height of the panel that shows a finding, relative to the usual
WIDEST = 34  # letters in a line beside such a panel
MAX_ROTORS = 8  # lines in a panel
EMPTY = Panel(title="nothing", y_label="nothing logged", unit="", traces=())
NOTHING = Figure("nothing", "None of the main signals was logged", "", (EMPTY,), (0.0, 1.0))
MARKS = {"fault": "✗", "in doubt": "?", "not judged": "?", "no fault found": "✓"}


class Component(NamedTuple):
    """What is said of a component, and bars (look, begin, length) over the log [%]."""

    name: str
    outcome: str  # a key of `MARKS`
    text: str
    bars: tuple[tuple[str, float, float], ...]


def write_page(inspection: Inspection, directory: Path, name: str = PAGE) -> Path:
    """Write the page of an inspection into a directory; return its path."""
    directory.mkdir(parents=True, exist_ok=True)
    return write_file(directory / name, render_verdict(inspection))


def render_verdict(inspection: Inspection) -> str:
    """Return the page, HTML that needs no other file."""
    verdict, (first, *findings), signals = inspection.verdict, *figures_of(inspection)
    cause = min((each.onset_s for each in verdict.findings), default=np.inf)
    early = [each for each in verdict.timeline if each.source != "diagnose" and each.time_s < cause]
    return render_template(
        "verdict.html",
        verdict=verdict,
        first=first,
        findings=findings,
        signals=signals,
        early=early,
        moments=[each for each in verdict.timeline if each not in early],
        components=sorted(_components(inspection), key=lambda each: [*MARKS].index(each.outcome)),
        marks=MARKS,
        spec=lambda figure: spec_of(plotly_figure(figure), figure.key),
    )


def figures_of(inspection: Inspection) -> tuple[list[Figure], list[Figure]]:
    """Draw the findings, the first cause first, else what tells most; and all else that was logged."""
    signals, ending = list(_signals(inspection)) or [NOTHING], inspection.verdict.ending
    drawn = [
        _finding_figure(number, each.finding, each.curve, inspection, signals)
        for number, each in enumerate(inspection.found, 1)
    ]
    if drawn:
        return drawn, signals
    upset = ending.kind == "out of control"
    first = next((each for each in signals if upset and each.key == "attitude"), signals[0])
    return [first], [each for each in signals if each is not first]


def describe(finding: Finding) -> str:
    """Say the figures of a finding: when, how much, how sure."""
    until = "" if finding.end_s is None else f" to {finding.end_s:.2f} s"
    size = "" if finding.size is None else f"; size {show(finding.size, finding.unit)}"
    if size and finding.sigma is not None:
        size += f" ± {show(finding.sigma, finding.unit)} (1 σ)"
    others = [each.replace("/", " ") for each in finding.ambiguous_with]
    doubt = f"; or {' or '.join(others)}" if others else ""
    sure = f"; probability {100.0 * finding.probability:.3g} %"
    return f"from {finding.onset_s:.2f} s{until}{size}{sure}{doubt}"


def _finding_figure(
    number: int, finding: Finding, curve: Curve | None, inspection: Inspection, signals: list[Figure]
) -> Figure:
    """Draw the curve that shows a finding, its onset marked; without one, its component's signal."""
    said = [describe(finding), *finding.evidence]
    caption = " ".join(f"{_capital(line)}." for line in said)
    key, title = f"finding-{number}", f"{finding.name}: {finding.kind}"
    if curve is not None and len(curve.time) > 1:
        span = float(curve.time[0]), float(curve.time[-1])
        unit = f" [{curve.unit.replace('^2', '²')}]" if curve.unit else ""
        label = textwrap.fill(f"{curve.title}{unit}", WIDEST)
        traces = _traces(curve.time, curve.lines)
        panel = Panel(title=curve.title, y_label=label, unit="", traces=traces)
    else:
        like = _signal_of(finding.component, signals)
        panel, span = like.panels[0], like.span
    end = span[1] if finding.end_s is None else min(finding.end_s, span[1])
    shades = (Shade(max(finding.onset_s, span[0]), max(end, span[0]), "fault"),)
    marks = (Mark(finding.onset_s, f"onset, {finding.onset_s:.2f} s"),)
    shown = dataclasses.replace(panel, shades=shades, marks=marks, height=HIGH)
    return Figure(key, _capital(title), caption, (shown,), span)


def _key(component: str) -> str:
    """Return the key of the figure of a component."""
    return component.lower().replace(" ", "-")


def _signal_of(component: str, signals: list[Figure]) -> Figure:
    """Return the figure of a component, else one of its kind, else the first."""
    key = _key(component)
    kind = key.partition("-")[0]
    return min(signals, key=lambda each: (each.key != key, not each.key.startswith(kind)))


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def _traces(time: np.ndarray, lines: Mapping[str, np.ndarray]) -> tuple[Trace, ...]:
    """Draw the first line solid, the others in colours and dashes of their own."""
    return tuple(
        Trace(name, "compared" if number else "truth", time, np.asarray(values, float), max(number - 1, 0))
        for number, (name, values) in enumerate(lines.items())
    )


def _signals(inspection: Inspection) -> Iterator[Figure]:
    """Draw the main sensors and the rotors over the whole log; each with the onset of the first cause."""
    end = max(inspection.flight.log.end, 1e-3)
    marks = tuple(Mark(each.onset_s, f"{each.name}: {each.kind}") for each in inspection.verdict.findings[:1])
    for component, title, unit, signal, names in _logged(inspection):
        traces = _traces(signal.time, dict(zip(names, signal.value.T, strict=False)))
        panel = Panel(title=title, y_label=title, unit=unit, traces=traces, marks=marks)
        yield Figure(_key(component), _capital(title), "", (panel,), (0.0, end))


def _logged(inspection: Inspection) -> Iterator[tuple[str, str, str, Signal, list[str]]]:
    """Component, title, unit, samples, their names; of several sensors the first one and the faulty ones."""
    log, gyro = inspection.flight.log, inspection.flight.gyro
    faulty = {each.component.lower() for each in inspection.verdict.findings}
    several = (
        ("gyro", "body rate", "rad/s", {} if gyro is None else {gyro[0]: gyro[1], **log.gyros}, [*"xyz"]),
        ("accelerometer", "specific force", "m/s²", log.accelerometers, [*"xyz"]),
        ("magnetometer", "magnetic field", log.field_unit, log.magnetometers, [*"xyz"]),
        ("barometer", "barometer height", "m", log.barometers, ["height"]),
        ("gps", "satellite position", "m", log.gps_positions, ["east", "north", "up"]),
    )
    for kind, title, unit, sensors, names in several:
        for number, (name, signal) in enumerate(sensors.items()):
            if number == 0 or component_name(kind, name) in faulty:
                which = name if number else ""
                yield component_name(kind, which), f"{title} {which}".strip(), unit, signal, names
    if log.attitude is not None:
        angles = np.degrees(euler_from_quaternion(log.attitude.value))
        yield "attitude", "attitude", "deg", Signal(log.attitude.time, angles), ["roll", "pitch"]
    rotors = [f"rotor {number}" for number in range(1, MAX_ROTORS + 1)]
    if log.rotor_speeds is not None:
        yield "rotor speeds", "rotor speeds", "rad/s", log.rotor_speeds, rotors
    if log.rotor_commands is not None:
        yield "rotor commands", "rotor commands", "1", log.rotor_commands, rotors
    if log.battery is not None:
        yield "battery", "battery", "V", log.battery, ["voltage"]


def _components(inspection: Inspection) -> Iterator[Component]:
    """Say of each component what was found, or why it was not judged."""
    verdict, end = inspection.verdict, max(inspection.flight.log.end, 1e-3)
    flights = [("judged", each.start, each.end) for each in inspection.flight.intervals]
    for name in _names(verdict):
        found = [each for each in verdict.findings if each.component == name]
        reasons = [f"not judged: {each.reason}" for each in unsaid(verdict) if each.component == name]
        texts = [f"{each.name}: {each.kind} {describe(each).partition(';')[0]}" for each in found]
        faults = [("fault", each.onset_s, end if each.end_s is None else each.end_s) for each in found]
        bars = [*(flights if name in verdict.judged else [("open", 0.0, end)]), *faults]
        doubt = doubted(verdict, name)
        usual = "no fault found" if name in verdict.judged else "not judged"
        outcome = "fault" if found else "in doubt" if doubt else usual
        texts += [doubt] if doubt else []
        texts += [outcome] if outcome == "no fault found" or not (texts or reasons) else []
        shares = tuple(
            (look, 100.0 * start / end, 100.0 * (stop - start) / end) for look, start, stop in bars
        )
        yield Component(name, outcome, "; ".join([*texts, *reasons]), shares)


def _names(verdict: Verdict) -> list[str]:
    found = [each.component for each in verdict.findings]
    return [*dict.fromkeys([*found, *verdict.judged, *(each.component for each in verdict.not_judged)])]
