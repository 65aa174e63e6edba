# pyright: basic
"""The map of a variant, in the colours that hold for all variants."""

from __future__ import annotations

import numpy as np

from quadftc_report.campaign.bins import BinAxis
from quadftc_report.campaign.draw import Spec, escaped, figure, finished
from quadftc_report.campaign.heat_map import Cells, Maps
from quadftc_report.campaign.scale import RATIO, Scale
from quadftc_report.wording import short

COLOURS = "Cividis"  # even steps, the same for colour-blind readers
MISSING = "#dcdcdc"  # of cells with too few flights
READABLE = 10  # columns of a map in which the numbers have room


def map_spec(key: str, maps: Maps, cells: Cells) -> Spec:
    """Draw the map of a variant, in the colours that hold for all variants."""
    low, high = maps.span or (0.0, 1.0)
    log = low > 0.0 and high > RATIO * low
    drawing = figure(0, (_title(maps.x), _title(maps.y)))
    drawing.update_layout(
        xaxis=_bin_ticks(maps.x),
        yaxis={**_bin_ticks(maps.y), "automargin": True},
        plot_bgcolor=MISSING,
        margin={"t": 16, "r": 8},
    )
    shown = np.log10(np.maximum(cells.medians, low)) if log else cells.medians
    edges = (np.log10(low), np.log10(high)) if log else (low, high)
    drawing.add_heatmap(
        z=[[None if np.isnan(value) else value for value in row] for row in shown.tolist()],
        x=list(range(len(maps.x.names))),
        y=list(range(len(maps.y.names))),
        zmin=edges[0],
        zmax=edges[1] if edges[1] > edges[0] else edges[0] + 1.0,
        colorscale=COLOURS,
        colorbar=_colour_bar(Scale(low, high, log), maps),
        xgap=1,
        ygap=1,
        customdata=_hover(maps, cells),
        hovertemplate="%{customdata}<extra></extra>",
        hoverongaps=False,
    )
    if len(maps.x.names) <= READABLE:
        texts = [[_in_cell(value) for value in row] for row in cells.medians.tolist()]
        drawing.update_traces(text=texts, texttemplate="%{text}", textfont={"size": 10})
    return finished(drawing, key)


def _title(axis: BinAxis) -> str:
    return f"{axis.path} [{axis.unit}]" if axis.unit else axis.path


def _bin_ticks(axis: BinAxis) -> Spec:
    values, texts = zip(*axis.ticks, strict=True)
    return {
        "tickvals": values,
        "ticktext": [escaped(text) for text in texts],
        "range": [-0.5, len(axis.names) - 0.5],
        "showgrid": False,
    }


def _colour_bar(scale: Scale, maps: Maps) -> Spec:
    unit = f" [{maps.kind.unit}]" if maps.kind.unit else ""
    bar: Spec = {"title": {"text": f"median{unit}", "side": "right"}, "thickness": 14, "outlinewidth": 0}
    if scale.log:
        bar |= {"tickvals": np.log10(scale.ticks).tolist(), "ticktext": scale.tick_texts}
    return bar


def _in_cell(value: float) -> str:
    """Two digits: a cell is narrow."""
    if not np.isfinite(value):
        return ""
    return np.format_float_positional(value, precision=2, fractional=False, trim="-")


def _hover(maps: Maps, cells: Cells) -> list[list[str]]:
    def words(axis: BinAxis, index: int) -> str:
        return f"{escaped(axis.path)}: {escaped(axis.names[index])} {axis.unit}".rstrip()

    return [
        [
            f"{words(maps.x, column)}<br>{words(maps.y, row)}<br>median {short(value)} {maps.kind.unit}"
            f"<br>{cells.flights[row, column]} flights"
            for column, value in enumerate(line)
        ]
        for row, line in enumerate(cells.medians.tolist())
    ]
