# pyright: basic
"""Figures for print: PNG and PDF, one column wide, the same bytes from the same data."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator

from quadftc_report import DATA
from quadftc_report.decimation import choose_samples
from quadftc_report.description import Figure, Panel
from quadftc_report.style import GREY, line_style, shade_colour

WIDTH = 3.5  # in; one column of a journal
PANEL_HEIGHT = 0.95  # in; of a panel of height 1
FRAME = 0.5  # in; time axis and margins
ROW = 0.125  # in; of the legend
LETTER = 0.06  # in; width of a letter of a label
DPI = 300
LINE_WIDTH = 0.9  # pt
FILL = 0.18  # opacity of areas
HANDLE = 2.2  # times the font size; sample of a line in the legend
LEGEND = {"handlelength": HANDLE, "handletextpad": 0.4, "columnspacing": 1.0, "labelspacing": 0.25}
NO_FRAME = {"frameon": False, "borderpad": 0.0, "borderaxespad": 0.4}
STYLE: Any = dict(mpl.rc_params_from_file(DATA / "print.mplstyle", use_default_template=False))


def save_figure(figure: Figure, directory: Path) -> list[Path]:
    """Draw a figure; write it as ``<key>.png`` (300 dpi) and ``<key>.pdf``; return the paths of both."""
    directory.mkdir(parents=True, exist_ok=True)
    png, pdf = directory / f"{figure.key}.png", directory / f"{figure.key}.pdf"
    with mpl.rc_context(cast("Any", {**mpl.rcParamsDefault, **STYLE})):
        canvas = draw(figure)
        about = {"Title": figure.title}
        canvas.savefig(png, dpi=DPI, metadata={**about, "Description": figure.caption, "Software": None})
        canvas.set_layout_engine("none")  # it is laid out: both files alike
        dates = {"CreationDate": None, "ModDate": None}
        canvas.savefig(pdf, metadata={**about, "Subject": figure.caption, **dates})
    return [png, pdf]


def save_picture(figure: Figure, path: Path) -> None:
    """Draw a figure into a file of any format that Matplotlib knows by its name."""
    with mpl.rc_context(cast("Any", {**mpl.rcParamsDefault, **STYLE})):
        draw(figure).savefig(path)


def draw(figure: Figure) -> Canvas:
    """Draw a figure, in the style in force."""
    heights = [panel.height for panel in figure.panels]
    canvas = Canvas(layout=ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.03, hspace=0.02))
    FigureCanvasAgg(canvas)
    axes = canvas.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    entries: dict[str, Artist] = {}
    for ax, panel in zip(axes, figure.panels, strict=True):
        ax.set_ylabel(panel.axis_label("\n"))
        for label, handle in _panel(ax, panel):
            entries.setdefault(label, handle)
    if not figure.is_map:  # which has one scale for both axes, and a span that follows from it
        axes[0].set_xlim(*figure.span)
    axes[-1].set_xlabel(figure.x_label)
    if figure.is_map:
        axes[0].set_aspect("equal", adjustable="datalim")
    axes[-1].xaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10]))
    canvas.align_ylabels(axes)
    rows = _legend(canvas, entries)
    canvas.set_size_inches(WIDTH, FRAME + ROW * rows + PANEL_HEIGHT * sum(heights))
    return canvas


def _panel(ax: Axes, panel: Panel) -> Iterator[tuple[str, Artist]]:
    """Draw a panel; yield its entries in the legend."""
    if panel.ticks:
        ax.set_yticks(*zip(*panel.ticks, strict=True))
        ax.set_ylim(panel.tick_span)
    else:
        ax.yaxis.set_major_locator(MaxNLocator(nbins=round(5 * panel.height), steps=[1, 2, 5, 10]))
    for trace in panel.traces:
        chosen = trace.chosen()
        yield trace.name, ax.plot(trace.t[chosen], trace.y[chosen], **_line(trace.role, trace.rank))[0]
    for area in panel.envelopes:
        chosen = choose_samples(area.t, area.low, area.high)
        sides = area.t[chosen], area.low[chosen], area.high[chosen]
        look = {"color": line_style(area.role, area.rank).colour, "alpha": FILL, "linewidth": 0.0}
        yield area.name, ax.fill_between(*sides, **look, zorder=1.5)
    for band in panel.bands:
        look = {**_line(band.role, band.rank), "linewidth": 0.6 * LINE_WIDTH, "zorder": 1.9}
        ax.axhline(band.low, **look)
        yield band.label, ax.axhline(band.high, **look)
    for shade in panel.shades:
        fill = {"color": shade_colour(shade.rank), "linewidth": 0.0, "zorder": 0.5}
        yield shade.label, ax.axvspan(shade.start, shade.stop, **fill)
    for mark in panel.marks:
        dots = {"color": GREY, "linewidth": 0.8, "dashes": (1.0, 1.5), "zorder": 1.8}
        yield mark.label, ax.axvline(mark.time, **dots)


def _line(role: str, rank: int) -> dict[str, Any]:
    """Arguments of Matplotlib for the look of a line."""
    style = line_style(role, rank)
    dashes = {"dashes": style.dashes} if style.dashes else {}
    width, order = LINE_WIDTH * style.width, 2.0 + style.layer * 1e-3
    return {"color": style.colour, "linewidth": width, "zorder": order, **dashes}


def _legend(canvas: Canvas, entries: dict[str, Artist]) -> int:
    """Put the legend above the panels, row by row, in as many columns as fit; return the number of rows."""
    labels = list(entries)
    width = LETTER * max(map(len, labels)) + (HANDLE + 0.4 + 1.0) * STYLE["legend.fontsize"] / 72.0
    columns = max(int(WIDTH / width), 1)
    order = [label for column in range(columns) for label in labels[column::columns]]
    handles = [entries[label] for label in order]
    canvas.legend(handles, order, loc="outside upper center", ncols=columns, **LEGEND, **NO_FRAME)
    return -(-len(labels) // columns)
