# pyright: basic
"""Figures for the screen, by Plotly: zoom, hover, a legend that switches runs off.

All panels of a figure share one time axis, ``xaxis``: to link the figures of a page, link that.
Samples are stored as 32-bit numbers, which Plotly writes as base64: half the size of the digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from quadftc_report.decimation import decimate, drawn
from quadftc_report.description import Band, Envelope, Figure, Panel, Trace
from quadftc_report.style import GREY, line_style, shade_colour

PANEL_HEIGHT = 165  # px; of a panel of height 1
FRAME = 100  # px; legend and time axis
GAP = 22  # px; between panels
LINE_WIDTH = 1.5  # px
SCREEN = 1.8  # dashes are longer on the screen than on paper, which is finer
FILL = 0.18  # opacity of areas
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"

CONFIG: dict[str, Any] = {
    "displaylogo": False,
    "responsive": True,
    "doubleClick": "reset",  # codespell:ignore
    "modeBarButtons": [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
}


def plotly_config(figure: Figure) -> dict[str, Any]:
    """Return the ``config`` to draw a figure with: it resets on a double click, and saves under its key."""
    return config_of(figure.key)


def config_of(key: str) -> dict[str, Any]:
    """Return the ``config`` of a figure that is saved under a key."""
    return {**CONFIG, "toImageButtonOptions": {"filename": key, "format": "svg"}}


def plotly_figure(figure: Figure) -> go.Figure:
    """Draw a figure, without its title and caption, which belong to the page around it.

    Its height is fixed, its width that of its place. The panels have ``yaxis``, ``yaxis2`` and so on.
    """
    heights = [PANEL_HEIGHT * panel.height for panel in figure.panels]
    total = sum(heights) + GAP * (len(heights) - 1)
    drawing = go.Figure(layout=_layout(figure, total))
    top = total
    shown: set[str] = set()
    for number, (panel, height) in enumerate(zip(figure.panels, heights, strict=True), 1):
        axis = f"y{number if number > 1 else ''}"
        drawing.update_layout(
            {f"yaxis{axis[1:]}": _y_axis(panel, ((top - height) / total, top / total))},
        )
        for item in _traces(panel, figure.span):
            name = item["name"]
            drawing.add_trace(go.Scatter(**item, yaxis=axis, legendgroup=name, showlegend=name not in shown))
            shown.add(name)
        for item in _shapes(panel):
            name = item["name"]
            drawing.add_shape(
                **item, yref=f"{axis} domain", y0=0, y1=1, legendgroup=name, showlegend=name not in shown
            )
            shown.add(name)
        top -= height + GAP
    drawing.update_layout(xaxis={"anchor": f"y{len(heights) if len(heights) > 1 else ''}"})
    return drawing


def _layout(figure: Figure, height: float) -> dict[str, Any]:
    return {
        "template": "plotly_white",
        "height": height + FRAME,
        "margin": {"l": 72, "r": 16, "t": 52, "b": 48},
        "font": {"family": FONT, "size": 13},
        "hovermode": "x unified",
        "hoversubplots": "axis",
        "hoverdistance": 40,
        "hoverlabel": {"namelength": -1},
        "dragmode": "zoom",
        "uirevision": figure.key,
        "legend": {
            "orientation": "h",
            "x": 0.0,
            "xanchor": "left",
            "y": 1.0 + 6.0 / height,
            "yanchor": "bottom",
            "bgcolor": "rgba(0,0,0,0)",
        },
        "xaxis": {
            "title": {"text": "time [s]", "standoff": 8},
            "range": list(figure.span),
            "unifiedhovertitle": {"text": "%{x:.3f} s"},
            **LINES,
        },
    }


LINES: dict[str, Any] = {
    "showline": True,
    "linecolor": "#9a9a9a",
    "mirror": "all",
    "zeroline": False,
}


def _y_axis(panel: Panel, domain: tuple[float, float]) -> dict[str, Any]:
    return {
        "title": {"text": panel.axis_label(), "standoff": 6},
        "domain": [max(domain[0], 0.0), min(domain[1], 1.0)],
        "anchor": "x",
        "nticks": 7,
        "minexponent": 5,
        **LINES,
        **_ticks(panel),
    }


def _ticks(panel: Panel) -> dict[str, Any]:
    """A scale of words in place of numbers, if the panel has one."""
    if not panel.ticks:
        return {}
    values, words = zip(*panel.ticks, strict=True)
    return {"tickvals": values, "ticktext": words, "range": list(panel.tick_span)}


def _traces(panel: Panel, span: tuple[float, float]) -> Iterator[dict[str, Any]]:
    """Everything of a panel that has samples or belongs to the range of its y axis."""
    for trace in panel.traces:
        yield _trace(trace, panel)
    for area in panel.envelopes:
        yield _area(area)
    for band in panel.bands:
        yield _band(band, span)


def _trace(trace: Trace, panel: Panel) -> dict[str, Any]:
    t, y = decimate(trace.t, trace.y)
    words = dict(panel.ticks)
    shown = "%{text}" if words else f"%{{y:.4~g}} {panel.unit}"
    return {
        "name": trace.name,
        "x": t.astype(np.float32),
        "y": y.astype(np.float32),
        **({"text": [words.get(value, "") for value in y.tolist()]} if words else {}),
        "hovertemplate": f"{panel.title}, {trace.name}: {shown}<extra></extra>",
        **look(trace.role, trace.rank),
    }


def _area(area: Envelope) -> dict[str, Any]:
    """An area as one closed line for each stretch without gap."""
    chosen = drawn(area.t, np.stack([area.low, area.high], axis=1))
    known = np.isfinite(area.low[chosen]) & np.isfinite(area.high[chosen])
    outline = [_outline(area, part) for part in _stretches(chosen, known)]
    x, y = (np.concatenate(side) for side in zip(*outline, strict=True)) if outline else ([], [])
    colour = line_style(area.role, area.rank).colour
    return {
        "name": area.name,
        "x": np.asarray(x, np.float32),
        "y": np.asarray(y, np.float32),
        "mode": "none",
        "fill": "toself",
        "fillcolor": _faded(colour),
        "hoverinfo": "skip",
        "zorder": 0,
    }


def _stretches(chosen: NDArray[np.intp], known: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """The known ones among the samples chosen, split at the gaps."""
    parts = np.split(chosen, np.flatnonzero(~known))
    return [part for part in (p[np.isin(p, chosen[known])] for p in parts) if len(part)]


def _outline(area: Envelope, part: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Forth along the upper edge, back along the lower, and a gap."""
    t, low, high = area.t[part], area.low[part], area.high[part]
    return np.concatenate([t, t[::-1], [np.nan]]), np.concatenate([high, low[::-1], [np.nan]])


def _band(band: Band, span: tuple[float, float]) -> dict[str, Any]:
    """Both edges of a range of values."""
    thin = look(band.role, band.rank)
    thin["line"]["width"] = 0.7 * LINE_WIDTH
    return {
        "name": band.label,
        "x": [*span, None, *span],
        "y": [band.high, band.high, None, band.low, band.low],
        "hoverinfo": "skip",
        **thin,
        "zorder": 0,
    }


def _shapes(panel: Panel) -> Iterator[dict[str, Any]]:
    """Windows and moments, as high as the panel."""
    for shade in panel.shades:
        yield {
            "type": "rect",
            "name": shade.label,
            "x0": shade.start,
            "x1": shade.stop,
            "fillcolor": shade_colour(shade.rank),
            "line": {"width": 0},
            "layer": "below",
        }
    for mark in panel.marks:
        yield {
            "type": "line",
            "name": mark.label,
            "x0": mark.time,
            "x1": mark.time,
            "line": {"color": GREY, "width": 1.2, "dash": "dot"},
        }


def look(role: str, rank: int) -> dict[str, Any]:
    """Return the attributes of Plotly for the look of a line; see `quadftc_report.style.line_style`."""
    style = line_style(role, rank)
    width = LINE_WIDTH * style.width
    dash = ",".join(f"{SCREEN * length * width:.1f}px" for length in style.dashes) or "solid"
    return {
        "mode": "lines",
        "line": {"color": style.colour, "width": width, "dash": dash, "simplify": False},
        "zorder": style.layer,
    }


def _faded(colour: str) -> str:
    red, green, blue = (int(colour[place : place + 2], 16) for place in (1, 3, 5))
    return f"rgba({red},{green},{blue},{FILL})"
