# pyright: basic
"""Figures for the screen, by Plotly: zoom, hover, a legend that switches runs off.

All panels of a figure over time share one time axis, ``xaxis``: to link the figures of a page, link that.
Samples are stored as 32-bit numbers, which Plotly writes as base64: half the size of the digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import numpy as np
import plotly.graph_objects as go

from quadftc_report.decimation import choose_samples
from quadftc_report.description import Envelope, Figure, Panel
from quadftc_report.style import GREY, line_style, shade_colour

PANEL_HEIGHT = 165  # px; of a panel of height 1
FRAME = 100  # px; legend and time axis
GAP = 22  # px; between panels
LINE_WIDTH = 1.5  # px
SCREEN = 1.8  # dashes are longer on the screen than on paper, which is finer
FILL = 0.18  # opacity of areas
TOP = 52  # px; of it, with one row of the legend
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
Look = dict[str, Any]  # attributes as Plotly names them
LINES: Look = {"showline": True, "linecolor": "#9a9a9a", "mirror": "all", "zeroline": False}
CONFIG: Look = {
    "displaylogo": False,
    "responsive": True,
    "doubleClick": "reset",  # codespell:ignore
    "modeBarButtons": [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
}


def spec_of(drawing: go.Figure, key: str) -> Look:
    """Return data, layout and config of a drawing that is saved under a key."""
    image = {"filename": key, "format": "svg"}
    return {**drawing.to_dict(), "config": {**CONFIG, "toImageButtonOptions": image}}


def empty_figure(height: float, top: float, **layout: object) -> go.Figure:
    """Return a figure without lines; its width is that of its place."""
    place = {"orientation": "h", "x": 0.0, "xanchor": "left", "y": 1.02, "yanchor": "bottom"}
    look = {
        "template": "plotly_white",
        "margin": {"l": 72, "r": 16, "t": top, "b": 48},
        "font": {"family": FONT, "size": 13},
        "hoverlabel": {"namelength": -1},
        "legend": {**place, "bgcolor": "rgba(0,0,0,0)"},
    }
    return go.Figure(layout={**look, "height": height, "dragmode": "zoom"}).update_layout(layout)


def axis(title: str, **others: object) -> Look:
    """Return the look of an axis."""
    return {"title": {"text": title, "standoff": 7}, **LINES, **others}


def plotly_figure(figure: Figure) -> go.Figure:
    """Draw a figure without its title and caption; the panels have ``yaxis``, ``yaxis2`` and so on."""
    heights = [PANEL_HEIGHT * panel.height for panel in figure.panels]
    total = sum(heights) + GAP * (len(heights) - 1)
    last = f"y{len(heights) if len(heights) > 1 else ''}"
    hover = {} if figure.is_map else {"unifiedhovertitle": {"text": "%{x:.3f} s"}}
    drawing = empty_figure(
        total + FRAME,
        TOP,
        hovermode="closest" if figure.is_map else "x unified",
        hoversubplots="axis",
        hoverdistance=40,
        uirevision=figure.key,
        legend_y=1.0 + 6.0 / total,
        xaxis=axis(figure.x_label, range=list(figure.span), anchor=last, **hover),
    )
    top = total
    for number, (panel, height) in enumerate(zip(figure.panels, heights, strict=True), 1):
        suffix = str(number) if number > 1 else ""
        look: Look = {"domain": [max((top - height) / total, 0.0), min(top / total, 1.0)]}
        if panel.ticks:
            values, texts = zip(*panel.ticks, strict=True)
            look |= {"tickvals": values, "ticktext": texts, "range": list(panel.tick_span)}
        if figure.is_map:
            look |= {"scaleanchor": "x", "scaleratio": 1.0}
        y_axis = axis(panel.axis_label().replace("\n", "<br>"), anchor="x", nticks=7, minexponent=5, **look)
        drawing.update_layout({f"yaxis{suffix}": y_axis})
        for item in _traces(panel, figure.span):
            drawing.add_trace(go.Scatter(**item, yaxis=f"y{suffix}"))
        for item in _shapes(panel):
            drawing.add_shape(**item, yref=f"y{suffix} domain", y0=0, y1=1)
        top -= height + GAP
    # every name is in the legend once, and switches all that bear it
    shown: set[str] = set()
    items: Any = (*drawing.data, *cast("Any", drawing.layout).shapes)
    for item in items:
        item.update(legendgroup=item.name, showlegend=item.name not in shown)
        shown.add(item.name)
    return drawing


def _traces(panel: Panel, span: tuple[float, float]) -> Iterator[Look]:
    """Everything of a panel that has samples or belongs to the range of its y axis."""
    words = dict(panel.ticks)
    for trace in panel.traces:
        chosen = trace.chosen()
        y = trace.y[chosen]
        value = "%{text}" if words else f"%{{y:.4~g}} {panel.unit}"
        yield {
            "name": trace.name,
            "x": trace.t[chosen].astype(np.float32),
            "y": y.astype(np.float32),
            "text": [words.get(value, "") for value in y.tolist()] if words else None,
            "hovertemplate": f"{panel.title}, {trace.name}: {value}<extra></extra>",
            **line_look(trace.role, trace.rank),
        }
    for area in panel.envelopes:
        yield _area(area)
    for band in panel.bands:
        thin = line_look(band.role, band.rank)
        thin["line"]["width"] = 0.7 * LINE_WIDTH
        edges = {"x": [*span, None, *span], "y": [band.high, band.high, None, band.low, band.low]}
        yield {"name": band.label, **edges, "hoverinfo": "skip", **thin, "zorder": 0}


def _area(area: Envelope) -> Look:
    """An area as one closed outline for each stretch without gap: forth above, back below, and a NaN."""
    chosen = choose_samples(area.t, area.low, area.high)
    t, low, high = area.t[chosen], area.low[chosen], area.high[chosen]
    stretches = np.ma.clump_unmasked(np.ma.masked_invalid(low + high))
    x = [np.r_[t[part], t[part][::-1], np.nan] for part in stretches]
    y = [np.r_[high[part], low[part][::-1], np.nan] for part in stretches]
    red, green, blue = bytes.fromhex(line_style(area.role, area.rank).colour[1:])
    return {
        "name": area.name,
        "x": np.concatenate([*x, []]).astype(np.float32),
        "y": np.concatenate([*y, []]).astype(np.float32),
        "mode": "none",
        "fill": "toself",
        "fillcolor": f"rgba({red},{green},{blue},{FILL})",
        "hoverinfo": "skip",
        "zorder": 0,
    }


def _shapes(panel: Panel) -> Iterator[Look]:
    """Windows and moments, as high as the panel."""
    for shade in panel.shades:
        fill = {"fillcolor": shade_colour(shade.rank), "line": {"width": 0}, "layer": "below"}
        yield {"type": "rect", "name": shade.label, "x0": shade.start, "x1": shade.stop, **fill}
    for mark in panel.marks:
        dots = {"color": GREY, "width": 1.2, "dash": "dot"}
        yield {"type": "line", "name": mark.label, "x0": mark.time, "x1": mark.time, "line": dots}


def line_look(role: str, rank: int) -> Look:
    """Return the attributes of Plotly for the look of a line; see `quadftc_report.style.line_style`."""
    style = line_style(role, rank)
    width = LINE_WIDTH * style.width
    dash = ",".join(f"{SCREEN * length * width:.1f}px" for length in style.dashes) or "solid"
    line = {"color": style.colour, "width": width, "dash": dash, "simplify": False}
    return {"mode": "lines", "line": line, "zorder": style.layer}
