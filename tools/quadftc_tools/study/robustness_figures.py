# pyright: basic
"""The figures of docs/robustness.md, as PNG in the style of the report; always the same bytes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from quadftc_report.style import GREY
from quadftc_tools.study.page import canvas, legend, look, no_minor, plain_ticks
from quadftc_tools.study.robustness_statistics import (
    GRADES,
    SIZED,
    Pair,
    Study,
    bins,
    cells,
    grades_of,
    share_missed,
    typical,
    typical_fault,
    variants_of,
)

PANEL = 2.1  # in
SHOWN = 50.0  # deg; what is larger is drawn at the edge
FINE = 10  # bins of the sizes of faults
PROPOSED, CONVENTIONAL = "proposed", "conventional"
MARKERS = "osD^vp"
NAMES = {CONVENTIONAL: "conventional (no observer)"}
THIN = Line2D([], [], color=GREY, linewidth=0.5, label="thin: 95 % quantile, else median")


def draw_study(study: Study, frame: pl.DataFrame) -> Figure:
    """One column for each grade, one row for each metric; metrics side by side if there is one grade."""
    grades, variants = grades_of(frame), variants_of(frame)
    drawn = study.shown
    across = len(grades) == 1
    shape = (1, len(drawn)) if across else (len(drawn), len(grades))
    figure, axes = canvas(*shape, PANEL, sharex="col", sharey="none" if across else "row")
    found = list(cells(study, frame))
    for column, grade in enumerate(grades):
        of_grade = [(value, cell) for other, value, cell in found if other == grade]
        for row, shown in enumerate(drawn):
            ax = axes[0][row] if across else axes[row][column]
            _draw_values(ax, of_grade, shown.metric, variants)
            ax.set_title(shown.title if across else GRADES[grade] if row == 0 else "")
            ax.set_ylabel("" if across or column > 0 else shown.title)
            ax.set_xlabel(study.title if across or row == len(drawn) - 1 else "")
    legend(figure, axes[0][0], 4, [THIN])
    return figure


def _draw_values(
    ax: Any, found: Sequence[tuple[float, pl.DataFrame]], metric: str, variants: Sequence[str]
) -> None:
    """A metric over the values of a grid, which are drawn at equal distances."""
    for variant in variants:
        pairs = [typical(cell.filter(pl.col("variant") == variant), metric) for _, cell in found]
        _plot(ax, np.arange(len(found)), pairs, variant, variants)
    _scale(ax)
    ax.set_xticks(range(len(found)), [f"{value:g}" for value, _ in found])
    ax.set_xlim(-0.3, len(found) - 0.7)


def draw_sizes(frame: pl.DataFrame) -> Figure:
    """One column for each kind of fault: tracking, error of its estimate, and the share that is missed."""
    figure, axes = canvas(3, len(SIZED), PANEL, sharex="col", sharey="row")
    variants = variants_of(frame)
    for column, sized in enumerate(SIZED):
        tracking, estimate, missed = axes[:, column]
        found = list(bins(sized, frame, np.geomspace(sized.edges[0], sized.edges[-1], FINE + 1).tolist()))
        centres = np.array([math.sqrt(low * high) for low, high, _ in found])
        for variant in variants:
            of_variant = [cell.filter(pl.col("variant") == variant) for _, _, cell in found]
            shares = [share_missed(cell) for cell in of_variant]
            estimates = [
                None if share is None else typical_fault(cell, "estimate_rmse_deg")
                for cell, share in zip(of_variant, shares, strict=True)
            ]
            pairs = [typical_fault(cell, "tracking_rmse_deg") for cell in of_variant]
            _plot(tracking, centres, pairs, variant, variants)
            _plot(estimate, centres, estimates, variant, variants)
            there = [place for place, share in enumerate(shares) if share is not None]
            known = [100.0 * share for share in shares if share is not None]
            if there:
                missed.plot(centres[there], known, clip_on=False, **_look(variant, variants))
        _scale(tracking)
        _scale(estimate)
        missed.set(ylim=(-4.0, 104.0), xscale="log", xlim=(sized.edges[0], sized.edges[-1]))
        plain_ticks(missed.xaxis)
        tracking.set_title(sized.kind)
        missed.set_xlabel(sized.title)
    titles = ("tracking RMSE [deg]", "fault estimate RMSE [deg]", "faults missed [%]")
    for row, title in enumerate(titles):
        axes[row][0].set_ylabel(title)
    legend(figure, axes[0][0], 4, [THIN])
    return figure


def _look(variant: str, variants: Sequence[str]) -> dict[str, Any]:
    """Line of a variant, the same in every figure; the conventional scheme looks as in the report."""
    names = sorted(variants, key=lambda name: name != CONVENTIONAL)
    marker = MARKERS[list(variants).index(variant) % len(MARKERS)]
    line = look(variant, names, PROPOSED)
    return {**line, "marker": marker, "markersize": 3.5, "markerfacecolor": "white", "markeredgewidth": 0.8}


def _plot(ax: Any, x: Any, pairs: list[Pair | None], variant: str, variants: Sequence[str]) -> None:
    """Medians, and a thin line for the 95 % quantiles; what is lost at the upper edge."""
    there = [place for place, pair in enumerate(pairs) if pair is not None]
    if not there:
        return
    known = np.array([pairs[place] for place in there], np.float64)
    medians, high = np.minimum(known, SHOWN).T
    line = _look(variant, variants)
    ax.plot(x[there], medians, label=NAMES.get(variant, variant), **line)
    ax.plot(x[there], high, **{**line, "linewidth": 0.5, "alpha": 0.6, "marker": ""})


def _scale(ax: Any) -> None:
    ax.set_yscale("log")
    plain_ticks(ax.yaxis)
    no_minor(ax.xaxis)
