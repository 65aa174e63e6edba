# pyright: basic
"""Curves of all variants in one figure: distributions, and receiver operating characteristics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from quadftc_report.campaign.detector import Detector
from quadftc_report.campaign.draw import Spec, escaped, figure, finished, look_of
from quadftc_report.campaign.ecdf import Ecdf
from quadftc_report.campaign.results import Side
from quadftc_report.campaign.scale import Scale
from quadftc_report.draw_plotly import look
from quadftc_report.wording import short

POINTS = 500  # of a curve
RATES = "finds %{y:.1%} at %{x:.1%} false alarms<extra></extra>"


def ecdf_spec(
    key: str, curves: Sequence[tuple[Side, Ecdf]], scale: Scale, words: tuple[str, str, str]
) -> Spec:
    """Draw distributions.

    Parameters
    ----------
    key : str
        Of the figure.
    curves : sequence of (Side, Ecdf)
    scale : Scale
        Of the values.
    words : tuple of str
        Titles of both axes, and the unit of the values.
    """
    *axes, unit = words
    drawing = figure(len(curves), (axes[0], axes[1]))
    drawing.update_layout(xaxis=_axis(scale), yaxis={"range": [-0.02, 1.03], "tickformat": ".0%"})
    for side, curve in curves:
        x, y = _steps(curve, scale)
        drawing.add_scatter(
            x=np.maximum(x, scale.low).astype(np.float32),
            y=y.astype(np.float32),
            name=escaped(side.name),
            line_shape="hv",
            customdata=[short(value) for value in x.tolist()],
            hovertemplate=f"{escaped(side.name)}: %{{y:.1%}} at most %{{customdata}} {unit}<extra></extra>",
            **look_of(side),
        )
    return finished(drawing, key)


def _steps(curve: Ecdf, scale: Scale) -> tuple[Any, Any]:
    """The points of a curve from below its first step; flat to the end of the scale where it ends below 1."""
    first = curve.values[:1] if len(curve.values) else [scale.low]
    last = [scale.high] if curve.final < 1.0 else []
    return (
        np.concatenate([first, curve.values, last]),
        np.concatenate([[0.0], curve.shares, [curve.final][: len(last)]]),
    )


def _axis(scale: Scale) -> Spec:
    if not scale.log:
        return {"range": [scale.low, scale.high]}
    return {
        "type": "log",
        "range": np.log10([scale.low, scale.high]).tolist(),
        "tickvals": scale.ticks,
        "ticktext": scale.tick_texts,
    }


def roc_spec(key: str, detectors: Sequence[tuple[Side, Detector]]) -> Spec:
    """Draw receiver operating characteristics, and the points of the variants' own detectors."""
    drawing = figure(len(detectors), ("share of healthy axes with a false alarm", "share of faults found"))
    shares: Spec = {"range": [-0.02, 1.02], "tickformat": ".0%"}
    drawing.update_layout(xaxis=shares, yaxis={**shares, "range": [-0.02, 1.03]})
    drawing.add_scatter(
        x=[0, 1], y=[0, 1], name="guessing", hoverinfo="skip", showlegend=False, **look("limit", 0)
    )
    for side, found in detectors:
        if found.curve is not None:
            chosen = _thinned(len(found.curve.threshold))
            drawing.add_scatter(
                x=found.curve.false_alarm_share[chosen].astype(np.float32),
                y=found.curve.detection_probability[chosen].astype(np.float32),
                customdata=[short(level) for level in found.curve.threshold[chosen].tolist()],
                name=f"{escaped(side.name)} (AUC {area_text(found.curve.area)})",
                legendgroup=escaped(side.name),
                hovertemplate=f"{escaped(side.name)}, from %{{customdata}} deg on: {RATES}",
                **look_of(side),
            )
        if found.point is not None:
            drawing.add_scatter(
                x=[found.point[0]],
                y=[found.point[1]],
                name=f"{escaped(side.name)}, its own detector",
                legendgroup=escaped(side.name),
                showlegend=False,
                mode="markers",
                cliponaxis=False,
                zorder=2000,
                marker={
                    "color": look_of(side)["line"]["color"],
                    "size": 10,
                    "line": {"width": 1.5, "color": "#fff"},
                },
                hovertemplate=f"{escaped(side.name)}, its own detector: {RATES}",
            )
    return finished(drawing, key)


def area_text(area: float) -> str:
    """Write the area under a curve: three decimals, and 1 only if it is."""
    return "1" if area == 1.0 else f"{min(area, 0.9999):.4f}" if area > 0.999 else f"{area:.3f}"


def _thinned(count: int) -> Any:
    """Which of so many points of a curve are drawn."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, POINTS))).astype(np.intp))
