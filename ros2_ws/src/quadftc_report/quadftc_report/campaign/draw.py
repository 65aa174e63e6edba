# pyright: basic
"""What the figures of a campaign have in common: drawn by Plotly, in the look of the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import plotly.graph_objects as go

from quadftc_report.campaign.results import Side
from quadftc_report.draw_plotly import FONT, LINES, config_of, look

Spec = dict[str, Any]  # what Plotly draws from: data, layout, config

HEIGHT = 380  # px
TOP = 52  # px; of it, with one row of the legend
LEGEND_ROW = 23  # px
IN_A_ROW = 3  # entries of a legend, about


def look_of(side: Side) -> Mapping[str, Any]:
    """Return the look of the line of a variant, the same in every figure."""
    return look(side.role, side.rank)


def figure(entries: int, titles: tuple[str, str]) -> go.Figure:
    """Return an empty figure with room for the entries of its legend."""
    x_title, y_title = (escaped(title) for title in titles)
    top = TOP + LEGEND_ROW * max(-(-entries // IN_A_ROW) - 1, 0)
    return go.Figure(
        layout={
            "template": "plotly_white",
            "height": HEIGHT + top - TOP,
            "margin": {"l": 72, "r": 16, "t": top, "b": 48},
            "font": {"family": FONT, "size": 13},
            "showlegend": entries > 0,
            "hovermode": "closest",
            "hoverlabel": {"namelength": -1},
            "dragmode": "zoom",
            "legend": {
                "orientation": "h",
                "x": 0.0,
                "xanchor": "left",
                "y": 1.02,
                "yanchor": "bottom",
                "bgcolor": "rgba(0,0,0,0)",
            },
            "xaxis": {"title": {"text": x_title, "standoff": 8}, **LINES},
            "yaxis": {"title": {"text": y_title, "standoff": 6}, **LINES},
        }
    )


def escaped(text: str) -> str:
    """Return a text in which Plotly finds no markup."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def finished(drawing: go.Figure, key: str) -> Spec:
    """Return what a figure is drawn from; it is saved under its key."""
    return {**drawing.to_dict(), "config": config_of(key)}
