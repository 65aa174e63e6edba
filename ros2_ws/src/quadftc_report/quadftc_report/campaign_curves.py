# pyright: basic
"""Curves of all variants of a campaign in one figure: distributions, receiver operating characteristics."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from quadftc_flight.diagnosis_metrics.roc import Roc, roc
from quadftc_model.samples import AXES
from quadftc_report.campaign_results import Floats, Results, Side, known, numbers
from quadftc_report.draw_plotly import TOP, axis, empty_figure, line_look, spec_of
from quadftc_report.wording import counted, listing, plain, short

HEIGHT = 380  # px
LEGEND_ROW = 23  # px
IN_A_ROW = 3  # entries of a legend, about
POINTS = 500  # of a curve
RATIO = 8.0  # between the largest and the smallest value, from which on a scale is logarithmic
BEYOND_ZERO = 2.0  # ratio of the smallest positive value to the lower end, where zero is drawn
MARGIN = 0.04  # of the length of a scale, on both ends
DECADES = 3.5  # longest logarithmic scale with ticks at 2 and 5
RATES = "finds %{y:.1%} at %{x:.1%} false alarms<extra></extra>"


class Picture(NamedTuple):
    """A figure on the page; ``plots``: title to data, layout and config; none: the caption says why."""

    key: str
    title: str
    caption: str
    plots: dict[str, dict[str, Any]]


class Scale(NamedTuple):
    """A scale of values; ``zeros``: it is logarithmic, and zero is drawn at its lower end."""

    low: float
    high: float
    log: bool = False
    zeros: bool = False


def scale_of(values: Floats) -> Scale:
    """Return a scale for values (n,), which are finite and not negative."""
    positive = values[values > 0.0]
    if not len(positive):
        return Scale(0.0, 1.0)
    low, high = float(positive.min()), float(positive.max())
    zeros = len(positive) < len(values)
    if high < RATIO * low:
        room = MARGIN * (high - low) or 0.5 * high
        return Scale(0.0 if zeros else max(low - room, 0.0), high + room)
    room = (high / low) ** MARGIN
    return Scale(low / (BEYOND_ZERO if zeros else room), high * room, True, zeros)


def log_ticks(scale: Scale) -> dict[str, Any]:
    """Return the ticks of a logarithmic scale, for Plotly."""
    first, last = math.log10(scale.low), math.log10(scale.high)
    steps = (1.0, 2.0, 5.0) if last - first <= DECADES else (1.0,)
    powers = range(math.floor(first), math.floor(last) + 1)
    values = [step * 10.0**power for power in powers for step in steps]
    values = [value for value in values if first <= math.log10(value) <= last] or [scale.low, scale.high]
    if scale.zeros:
        far = [value for value in values if value > BEYOND_ZERO * scale.low]
        return {"tickvals": [scale.low, *far], "ticktext": ["0", *map(plain, far)]}
    return {"tickvals": values, "ticktext": list(map(plain, values))}


class Ecdf(NamedTuple):
    """An empirical distribution: rising arrays (m,), and the count of all values, infinite ones included."""

    values: Floats
    shares: Floats  # of all, that are at most the value
    total: int

    @property
    def final(self) -> float:
        """The share that has a finite value."""
        return float(self.shares[-1]) if len(self.shares) else 0.0


def ecdf(values: Floats) -> Ecdf:
    """Return the distribution of values (n,), thinned to ``POINTS``.

    NaN is left out. Infinite values, such as the delay of a fault that was never found, keep the curve
    below 1.
    """
    given = values[~np.isnan(values)]
    ordered = np.sort(given[np.isfinite(given)])
    ranks = _thin(len(ordered))
    return Ecdf(ordered[ranks], (ranks + 1) / max(len(given), 1), len(given))


def _thin(count: int) -> NDArray[np.intp]:
    """Which of so many points of a curve are drawn."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, POINTS))).astype(np.intp))


class Detector(NamedTuple):
    """How well a variant tells faulty axes from healthy ones.

    One score for each fault, the largest estimate while it lasts; one for each axis of each flight, the
    largest estimate while that axis is healthy. A level finds a fault, or gives an axis a false alarm, if the
    score reaches it. Such shares count faults and axes, not samples.
    """

    curve: Roc | None  # None: there is nothing to compare, or it never estimates anything
    faults: int  # scores of the curve
    healthy: int
    point: tuple[float, float] | None  # its own detector: share of healthy axes alarmed, of faults found


def detector_of(side: Side) -> Detector:
    """Judge a variant."""
    peaks = known(numbers(side.faults, "fault.estimate_peak_deg"))
    calm = known(np.concatenate([numbers(side.flights, f"healthy_estimate_max_deg.{axis}") for axis in AXES]))
    scores = np.concatenate([peaks, calm])
    useful = len(peaks) > 0 and len(calm) > 0 and bool(np.any(scores > 0.0))
    curve = roc(scores, np.arange(len(scores)) < len(peaks)) if useful else None
    found = known(numbers(side.faults, "fault.detected"))
    healthy = [(numbers(side.flights, f"healthy_time_s.{axis}") > 0.0, axis) for axis in AXES]
    counts = [numbers(side.flights, f"false_alarms.{axis}")[there] for there, axis in healthy]
    alarms = known(np.concatenate(counts))
    says = len(found) and len(alarms) and (np.any(found) or np.any(alarms))
    point = (float(np.mean(alarms > 0.0)), float(np.mean(found))) if says else None
    return Detector(curve, len(peaks), len(calm), point)


def distributions(results: Results) -> Iterator[Picture]:
    """Yield the distributions of tracking, fault estimate and detection delay."""
    sides = results.sides
    without = [side.title for side in sides if not side.has_observer]
    lost = {side: np.sum(np.isinf(side.worst_tracking)) for side in sides}
    told = listing([f"{count} of {side.title}" for side, count in lost.items() if count])
    note = f" Flights that did not stay finite count as worse than all others: {told}." if told else ""
    tracking = [(side, side.worst_tracking) for side in sides]
    yield from _distribution("tracking", ("tracking RMSE of the worst axis", "deg", "flight"), tracking, note)
    if not results.kinds:
        return
    note = f" Without a fault observer ({listing(without)}) the error is the fault itself." if without else ""
    estimates = [(side, side.estimate_errors) for side in sides]
    yield from _distribution("estimate", ("RMSE of the estimate", "deg", "fault"), estimates, note)
    delays = [(side, side.detection_delays) for side in sides if side.has_observer]
    missed = {side: int(np.sum(np.isinf(values))) for side, values in delays}
    told = listing([f"{counted(count, 'fault')} of {side.title}" for side, count in missed.items() if count])
    note = f" Without a delay, so that the curve ends below 100 %: {told}." if told else ""
    yield from _distribution("delay", ("detection delay", "s", "fault"), delays, note)


def _distribution(
    key: str, words: tuple[str, str, str], parts: Sequence[tuple[Side, Floats]], note: str
) -> Iterator[Picture]:
    """A figure of distributions; none if there is not a value."""
    value, unit, thing = words
    curves = [
        (side, curve) for side, curve in ((side, ecdf(values)) for side, values in parts) if curve.total
    ]
    if not any(len(curve.values) for _, curve in curves):
        return
    scale = scale_of(np.concatenate([curve.values for _, curve in curves]))
    span = {"range": [scale.low, scale.high]}
    if scale.log:
        span = {"type": "log", "range": np.log10([scale.low, scale.high]).tolist(), **log_ticks(scale)}
    drawing = variant_figure(len(curves), (f"{value} [{unit}]", f"share of the {thing}s"))
    drawing.update_layout(xaxis=span, yaxis={"range": [-0.02, 1.03], "tickformat": ".0%"})
    for side, curve in curves:
        x, y = _steps(curve, scale)
        drawing.add_scatter(
            x=np.maximum(x, scale.low).astype(np.float32),
            y=y.astype(np.float32),
            name=escaped(side.name),
            line_shape="hv",
            customdata=[short(value) for value in x.tolist()],
            hovertemplate=f"{escaped(side.name)}: %{{y:.1%}} at most %{{customdata}} {unit}<extra></extra>",
            **line_look(side.role, side.rank),
        )
    zeros = " Values of zero stand at the left end." if scale.zeros else ""
    counts = counts_text({side.name: curve.total for side, curve in curves}, thing)
    caption = f"Share of the {thing}s whose {value} is at most so much; {counts}.{zeros}{note}"
    yield Picture(
        f"ecdf-{key}", f"{value[0].upper()}{value[1:]}", caption, {"": spec_of(drawing, f"ecdf-{key}")}
    )


def _steps(curve: Ecdf, scale: Scale) -> tuple[Floats, Floats]:
    """The points of a curve from below its first step; flat to the end of the scale where it ends below 1."""
    first = curve.values[:1] if len(curve.values) else [scale.low]
    last = [scale.high] if curve.final < 1.0 else []
    x = np.concatenate([first, curve.values, last])
    return x, np.concatenate([[0.0], curve.shares, [curve.final][: len(last)]])


def characteristics(results: Results) -> Iterator[Picture]:
    """Yield the receiver operating characteristics, with the points of the variants' own detectors."""
    shown = [(side, found) for side in results.sides if (found := detector_of(side)).curve is not None]
    if not shown:
        return
    drawing = variant_figure(
        len(shown), ("share of healthy axes with a false alarm", "share of faults found")
    )
    shares = {"range": [-0.02, 1.02], "tickformat": ".0%"}
    drawing.update_layout(xaxis=shares, yaxis={**shares, "range": [-0.02, 1.03]})
    diagonal = {"name": "guessing", "hoverinfo": "skip", "showlegend": False}
    drawing.add_scatter(x=[0, 1], y=[0, 1], **diagonal, **line_look("limit", 0))
    for side, found in shown:
        _add_characteristic(drawing, side, found)
    faults = counts_text({side.name: found.faults for side, found in shown}, "fault")
    caption = (
        "If an estimate of some size were an alarm: the share of the faults found over the share of the"
        f" healthy axes alarmed, for every size ({faults}). AUC: area under the curve; dotted: guessing."
        " Dots: the observers' own detectors."
    )
    yield Picture("roc", "Detection by the size of the estimate", caption, {"": spec_of(drawing, "roc")})


def _add_characteristic(drawing: go.Figure, side: Side, found: Detector) -> None:
    name, look = escaped(side.name), line_look(side.role, side.rank)
    curve = found.curve
    if curve is not None:
        chosen = _thin(len(curve.threshold))
        drawing.add_scatter(
            x=curve.false_alarm_share[chosen].astype(np.float32),
            y=curve.detection_probability[chosen].astype(np.float32),
            customdata=[short(level) for level in curve.threshold[chosen].tolist()],
            name=f"{name} (AUC {_area_text(curve.area)})",
            legendgroup=name,
            hovertemplate=f"{name}, from %{{customdata}} deg on: {RATES}",
            **look,
        )
    if found.point is not None:
        drawing.add_scatter(
            x=[found.point[0]],
            y=[found.point[1]],
            name=f"{name}, its own detector",
            legendgroup=name,
            showlegend=False,
            mode="markers",
            cliponaxis=False,
            zorder=2000,
            marker={"color": look["line"]["color"], "size": 10, "line": {"width": 1.5, "color": "#fff"}},
            hovertemplate=f"{name}, its own detector: {RATES}",
        )


def _area_text(area: float) -> str:
    """Three decimals, and 1 only if it is."""
    return "1" if area == 1.0 else f"{min(area, 0.9999):.4f}" if area > 0.999 else f"{area:.3f}"


def variant_figure(entries: int, titles: tuple[str, str]) -> go.Figure:
    """Return an empty figure with room for the entries of its legend."""
    more = LEGEND_ROW * max(-(-entries // IN_A_ROW) - 1, 0)
    x, y = (axis(escaped(title)) for title in titles)
    others = {"showlegend": entries > 0, "hovermode": "closest", "xaxis": x, "yaxis": y}
    return empty_figure(HEIGHT + more, TOP + more, **others)


def escaped(text: str) -> str:
    """Return a text in which Plotly finds no markup."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def counts_text(counts: dict[str, int], thing: str) -> str:
    """Write how many of a thing each variant has: ``600 flights of each variant``."""
    texts = {name: counted(count, thing) for name, count in counts.items()}
    if len(set(texts.values())) == 1:
        return next(iter(texts.values())) + (" of each variant" if len(texts) > 1 else "")
    return listing([f"{text} of '{name}'" for name, text in texts.items()])
