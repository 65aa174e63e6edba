# pyright: basic
"""Curves of all variants of a campaign in one figure: distributions."""

from __future__ import annotations

import functools
import html
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from quadftc_report.campaign_results import Floats, Results, Side
from quadftc_report.draw_plotly import TOP, Look, axis, empty_figure, line_look, spec_of
from quadftc_report.wording import plain, short

HEIGHT = 380  # px
LEGEND_ROW = 23  # px
IN_A_ROW = 3  # entries of a legend, about
POINTS = 500  # of a curve
RATIO = 8.0  # between the largest and the smallest value, from which on a scale is logarithmic
DECADES = 3.5  # longest logarithmic scale with ticks at 2 and 5
escape = functools.partial(html.escape, quote=False)  # so that Plotly finds no markup
SHARES = {"range": [-0.02, 1.03], "tickformat": ".0%"}  # axis


class Picture(NamedTuple):
    """A figure on the page."""

    key: str
    title: str
    caption: str
    spec: Look  # data, layout and config


def log_ticks(low: float, high: float) -> Look:
    """Return the ticks of a logarithmic scale, for Plotly."""
    steps = (1.0, 2.0, 5.0) if math.log10(high / low) <= DECADES else (1.0,)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = [step * 10.0**power for power in powers for step in steps]
    values = [value for value in values if low <= value <= high]
    return {"tickvals": values, "ticktext": [plain(value) for value in values]}


class Ecdf(NamedTuple):
    """An empirical distribution: rising arrays (m,), and the count of all values, infinite ones included."""

    values: Floats
    shares: Floats  # of all, that are at most the value
    total: int


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


def distributions(results: Results) -> Iterator[Picture]:
    """Yield the distributions of tracking, fault estimate and detection delay."""
    sides, note = results.sides, "A flight that did not stay finite is worse than all others."
    tracking = [(side, side.worst_tracking) for side in sides]
    yield from _distribution("tracking", "tracking RMSE of the worst axis", "deg", "flight", tracking, note)
    note = "Without a fault observer the error is the fault itself."
    estimates = [(side, side.estimate_errors) for side in sides]
    yield from _distribution("estimate", "RMSE of the estimate", "deg", "fault", estimates, note)
    note = "Where faults were missed, the curve ends below 100 %."
    delays = [(side, side.detection_delays) for side in sides if side.has_observer]
    yield from _distribution("delay", "detection delay", "s", "fault", delays, note)


def _distribution(
    key: str, value: str, unit: str, thing: str, parts: Sequence[tuple[Side, Floats]], note: str
) -> Iterator[Picture]:
    """A figure of distributions; none if there is not a value."""
    curves = [(side, curve) for side, values in parts if (curve := ecdf(values)).total]
    finite = np.concatenate([np.zeros(0), *(curve.values for _, curve in curves)])
    if not len(finite):
        return
    positive = finite[finite > 0.0] if np.any(finite > 0.0) else np.ones(1)
    low, high = float(positive.min()), float(positive.max())
    start, end, x_axis = 0.0, 1.05 * high, {"range": [0.0, 1.05 * high]}
    if high > RATIO * low:
        start, end = low / 2.0, 1.1 * high
        note += " Zeros stand at the left end." if np.any(finite <= 0.0) else ""
        x_axis = {"type": "log", "range": [math.log10(start), math.log10(end)], **log_ticks(start, end)}
    drawing = variant_figure(len(curves), (f"{value} [{unit}]", f"share of the {thing}s"))
    drawing.update_layout(xaxis=x_axis, yaxis=SHARES)
    for side, curve in curves:
        # from below the first step to the end of the axis
        x = np.concatenate([[start], curve.values, [end]])
        final = curve.shares[-1] if len(curve.shares) else 0.0
        drawing.add_scatter(
            x=np.maximum(x, start).astype(np.float32),
            y=np.concatenate([[0.0], curve.shares, [final]]).astype(np.float32),
            name=escape(side.name),
            line_shape="hv",
            customdata=[short(each) for each in x.tolist()],
            hovertemplate=f"{escape(side.name)}: %{{y:.1%}} at most %{{customdata}} {unit}<extra></extra>",
            **line_look(side.role, side.rank),
        )
    caption, key = f"Share of the {thing}s whose {value} is at most so much. {note}", f"ecdf-{key}"
    yield Picture(key, f"{value[0].upper()}{value[1:]}", caption, spec_of(drawing, key))


def variant_figure(entries: int, titles: tuple[str, str]) -> go.Figure:
    """Return an empty figure with room for the entries of its legend."""
    more = LEGEND_ROW * max(-(-entries // IN_A_ROW) - 1, 0)
    x, y = (axis(escape(title)) for title in titles)
    others = {"showlegend": entries > 0, "hovermode": "closest", "xaxis": x, "yaxis": y}
    return empty_figure(HEIGHT + more, TOP + more, **others)
