# pyright: basic
"""The figures of docs/robustness.md, as PNG in the style of the report; always the same bytes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
import polars as pl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

from quadftc_report.draw_matplotlib import STYLE
from quadftc_report.style import GREY, line_style
from quadftc_tools.robustness_study.cells import Pair, faults_of, typical, typical_fault
from quadftc_tools.robustness_study.studies import GRADES, SIZED, SIZES, STUDIES, VARIANTS, Study
from quadftc_tools.robustness_study.tables import bins, cells, grades_of

DPI = 200
WIDTH = 7.0  # in; two columns of a journal
PANEL = 2.1  # in; height of a row of panels
LEGEND = 0.45  # in
LINE_WIDTH = 1.0  # pt
TITLES = {"axes.titlesize": 8.5, "lines.markersize": 3.5}  # beside the style of the report
SHOWN = 50.0  # deg; what is larger is drawn at the edge
FINE = 10  # bins of the sizes of faults
ORDER = ("conventional", "supervised", "augmented_kalman", "edwards_spurgeon", "threshold")  # of the looks
MARKERS = dict(zip(VARIANTS, ("o", "s", "D", "^", "v", "p"), strict=True))
NAMES = {"conventional": "conventional (no observer)"}


def save_figures(frames: Mapping[str, pl.DataFrame], directory: Path) -> list[Path]:
    """Draw a figure of each study; return the files.

    Parameters
    ----------
    frames : mapping
        Name of a study to the table of its campaign.
    directory : Path

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    with mpl.rc_context(cast("Any", {**mpl.rcParamsDefault, **STYLE, **TITLES})):
        for study in STUDIES:
            if study.name in frames:
                figure = _of_study(study, frames[study.name])
                files.append(_saved(figure, directory / f"robustness_{study.name}.png"))
        if SIZES in frames:
            files.append(_saved(_of_sizes(frames[SIZES]), directory / f"robustness_{SIZES}.png"))
    return files


def _saved(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
    return path


def _canvas(rows: int, columns: int, sharey: bool = True) -> tuple[Figure, Any]:
    figure = Figure(figsize=(WIDTH, PANEL * rows + LEGEND), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(
        rows, columns, squeeze=False, sharex="col", sharey="row" if sharey else False
    )


def _look(variant: str) -> dict[str, Any]:
    """Line of a variant, the same in every figure."""
    style = line_style("proposed") if variant == "proposed" else line_style("compared", ORDER.index(variant))
    return {
        "color": style.colour,
        "dashes": style.dashes or (None, None),
        "linewidth": LINE_WIDTH * style.width,
        "marker": MARKERS[variant],
        "markerfacecolor": "white",
        "markeredgewidth": 0.8,
        "zorder": 2.0 + style.layer * 1e-3,
    }


def _of_study(study: Study, frame: pl.DataFrame) -> Figure:
    """One column for each grade, one row for each metric; metrics side by side if there is one grade."""
    grades = grades_of(frame)
    drawn = [shown for shown in study.shown if shown.drawn]
    across = len(grades) == 1
    figure, axes = _canvas(*(1, len(drawn)) if across else (len(drawn), len(grades)), sharey=not across)
    found = list(cells(study, frame))
    for column, grade in enumerate(grades):
        own = [(value, cell) for other, value, cell in found if other == grade]
        for row, shown in enumerate(drawn):
            ax = axes[0][row] if across else axes[row][column]
            _values(ax, own, shown.metric)
            ax.set_title(shown.title if across else GRADES[grade] if row == 0 else "")
            ax.set_ylabel("" if across or column > 0 else shown.title)
            ax.set_xlabel(study.title if across or row == len(drawn) - 1 else "")
    _legend(figure, axes[0][0])
    return figure


def _values(ax: Any, found: Sequence[tuple[float, pl.DataFrame]], metric: str) -> None:
    """A metric over the values of a grid, which are drawn at equal distances."""
    for variant in VARIANTS:
        pairs = [typical(cell.filter(pl.col("variant") == variant), metric) for _, cell in found]
        _plot(ax, np.arange(len(found)), pairs, variant)
    _scaled(ax)
    ax.set_xticks(range(len(found)), [f"{value:g}" for value, _ in found])
    ax.set_xlim(-0.3, len(found) - 0.7)


def _of_sizes(frame: pl.DataFrame) -> Figure:
    """One column for each kind of fault: error of its estimate, tracking, and the share that is missed."""
    figure, axes = _canvas(3, len(SIZED))
    for column, sized in enumerate(SIZED):
        edges = np.geomspace(sized.edges[0], sized.edges[-1], FINE + 1).tolist()
        found = list(bins(sized, frame, edges))
        centres = np.array([math.sqrt(low * high) for low, high, _ in found])
        for variant in VARIANTS:
            own = [cell.filter(pl.col("variant") == variant) for _, _, cell in found]
            faults = [faults_of(cell) for cell in own]
            estimates = [
                None if judged is None else typical_fault(cell, "estimate_rmse_deg")
                for cell, judged in zip(own, faults, strict=True)
            ]
            tracking = [typical_fault(cell, "tracking_rmse_deg") for cell in own]
            _plot(axes[0][column], centres, tracking, variant)
            _plot(axes[1][column], centres, estimates, variant)
            there = [place for place, judged in enumerate(faults) if judged is not None]
            missed = [100.0 * judged.missed for judged in faults if judged is not None]
            if there:
                axes[2][column].plot(centres[there], missed, clip_on=False, **_look(variant))
        for row in range(2):
            _scaled(axes[row][column])
        axes[2][column].set_ylim(-4.0, 104.0)
        axes[2][column].set_xscale("log")
        axes[2][column].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes[2][column].xaxis.set_minor_formatter(NullFormatter())
        axes[2][column].set_xlim(sized.edges[0], sized.edges[-1])
        axes[0][column].set_title(sized.kind)
        axes[2][column].set_xlabel(sized.title)
    titles = ("tracking RMSE [deg]", "fault estimate RMSE [deg]", "faults missed [%]")
    for row, title in enumerate(titles):
        axes[row][0].set_ylabel(title)
    _legend(figure, axes[0][0])
    return figure


def _plot(ax: Any, x: Any, pairs: list[Pair | None], variant: str) -> None:
    """Medians, and a thin line for the 95 % quantiles; what is lost at the upper edge."""
    there = [place for place, pair in enumerate(pairs) if pair is not None]
    if not there:
        return
    known = np.array([pairs[place] for place in there], np.float64)
    medians, high = np.minimum(known, SHOWN).T
    look = _look(variant)
    ax.plot(x[there], medians, label=NAMES.get(variant, variant), **look)
    ax.plot(x[there], high, **{**look, "linewidth": 0.5, "alpha": 0.6, "marker": ""})


def _scaled(ax: Any) -> None:
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.xaxis.set_minor_locator(NullLocator())


def _legend(figure: Figure, ax: Any) -> None:
    handles, labels = ax.get_legend_handles_labels()
    handles.append(Line2D([], [], color=GREY, linewidth=0.5))
    labels.append("thin: 95 % quantile, else median")
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
