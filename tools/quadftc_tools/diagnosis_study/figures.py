# pyright: basic
"""The figures of docs/diagnosis.md, as PNG in the style of the report; always the same bytes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullFormatter, NullLocator

from quadftc_report.draw_matplotlib import STYLE
from quadftc_report.style import BLACK, PROPOSED, line_style
from quadftc_tools.diagnosis_study.results import BOUNDED
from quadftc_tools.diagnosis_study.settings import setting_of
from quadftc_tools.diagnosis_study.tables import WITHOUT_DETECTOR
from quadftc_tools.diagnosis_study.variants import OBSERVERS

Json = Mapping[str, Any]

DPI = 200
WIDTH = 7.0  # in; two columns of a journal
PANEL = 2.3  # in; height of a row of panels
LEGEND = 0.3  # in
LINE_WIDTH = 1.0  # pt
KINDS = ("step", "ramp", "sine")
TITLES = {"axes.titlesize": 8.5, "lines.markersize": 4.0}  # beside the style of the report
NONE_AT = 1e-6  # share drawn for no false alarm at all
SHARES = (NONE_AT, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
SOONEST = 2e-3  # s; half a sample of the simulation
LATEST = 20.0  # s; the length of a fault
FEW = 3  # faults; fewer make no median


def save_figures(results: Json, directory: Path) -> list[Path]:
    """Draw every figure; return the files.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    settings = {name: result for name, result in results["settings"].items() if not setting_of(name).one_axis}
    files: list[Path] = []
    drawers: dict[str, Callable[[dict[str, Any], Json], Figure]] = {
        "diagnosis_roc": _roc,
        "diagnosis_delay": _delays,
        "diagnosis_ramps": _ramps,
        "diagnosis_consistency": _consistency,
    }
    with mpl.rc_context(cast("Any", {**mpl.rcParamsDefault, **STYLE, **TITLES})):
        for key, drawer in drawers.items():
            files.append(directory / f"{key}.png")
            drawer(settings, results).savefig(files[-1], dpi=DPI, metadata={"Software": None})
    return files


def _canvas(rows: int, columns: int, sharey: bool = True) -> tuple[Figure, Any]:
    figure = Figure(figsize=(WIDTH, PANEL * rows + LEGEND), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, sharey=sharey)


def _look(observer: str) -> dict[str, Any]:
    """Line of an observer, the same in every figure."""
    others = [name for name in OBSERVERS if name != BOUNDED]
    style = line_style("proposed") if observer == BOUNDED else line_style("compared", others.index(observer))
    return {
        "color": style.colour,
        "dashes": style.dashes or (None, None),
        "linewidth": LINE_WIDTH * style.width,
        "zorder": 2.0 + style.layer * 1e-3,
    }


def _legend(figure: Figure, ax: Any, columns: int = 5) -> None:
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False)


def _roc(settings: dict[str, Any], results: Json) -> Figure:
    figure, axes = _canvas(1, len(settings))
    for ax, result in zip(axes[0], settings.values(), strict=True):
        for observer in result["observers"]:
            shares, found = _characteristic(result["roc"], observer)
            ax.plot(shares, found, label=observer, **_look(observer))
            if observer not in WITHOUT_DETECTOR:
                point = next(each for each in result["roc"]["points"][observer] if each["level"] is None)
                colour = _look(observer)["color"]
                ax.plot(*_at(point), "o", color=colour, markersize=4.5, zorder=4, clip_on=False)
        ax.set_title(result["title"])
        ax.set_xscale("log")
        ax.set_xlim(0.6 * NONE_AT, 1.4)
        ax.set_ylim(-0.03, 1.03)
        ax.xaxis.set_major_locator(FixedLocator(SHARES))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_major_formatter(FuncFormatter(_share))
        ax.set_xlabel("false alarms, share of healthy time")
    axes[0][0].set_ylabel(f"faults found within {results['within_s']:g} s")
    _legend(figure, axes[0][0])
    return figure


def _characteristic(roc: Json, observer: str) -> tuple[Any, Any]:
    """False alarms and detections over all levels, from the highest level on."""
    if observer in roc["curves"]:
        curve = roc["curves"][observer]
        order = np.argsort(curve["level"])[::-1]
        shares, found = (
            np.array(curve[name], float) for name in ("false_alarm_share", "detection_probability")
        )
        return np.maximum(shares[order], NONE_AT), found[order]
    shares, found = zip(*sorted(_at(point) for point in roc["points"][observer]), strict=True)
    return shares, found


def _at(point: Json) -> tuple[float, float]:
    share, found = point["false_alarm_share"], point["detection_probability"]
    return max(np.nan if share is None else share, NONE_AT), np.nan if found is None else found


def _share(value: float, _place: int) -> str:
    if value <= NONE_AT:
        return "none"
    return f"{100.0 * value:g} %"


def _delays(settings: dict[str, Any], _results: Json) -> Figure:
    figure, axes = _canvas(len(settings), len(KINDS))
    for row, result in zip(axes, settings.values(), strict=True):
        for ax, kind in zip(row, KINDS, strict=True):
            for observer, each in result["observers"].items():
                time, share = _arrivals(observer, [f for f in each["faults"] if f["kind"] == kind])
                ax.plot(time, share, drawstyle="steps-post", label=observer, **_look(observer))
            ax.set_xscale("log")
            ax.set_xlim(SOONEST, LATEST)
            ax.set_ylim(-0.03, 1.03)
            ax.set_title(f"{result['title']}, {kind}")
            ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            ax.xaxis.set_minor_formatter(NullFormatter())
        row[0].set_ylabel("share of the faults found")
    for ax in axes[-1]:
        ax.set_xlabel("delay [s]")
    _legend(figure, axes[0][0])
    return figure


def _arrivals(observer: str, faults: Sequence[Json]) -> tuple[Any, Any]:
    """Delays in order, and the share of the faults that were found by then."""
    name = "above_threshold_delay_s" if observer in WITHOUT_DETECTOR else "detection_delay_s"
    delays = np.sort([max(fault[name], SOONEST) for fault in faults if fault[name] is not None])
    shares = np.arange(1, len(delays) + 1) / max(len(faults), 1)
    last = shares[-1] if len(shares) else 0.0
    return np.concatenate([[SOONEST], delays, [LATEST]]), np.concatenate([[0.0], shares, [last]])


def _ramps(settings: dict[str, Any], _results: Json) -> Figure:
    figure, axes = _canvas(1, len(settings))
    for ax, (name, result) in zip(axes[0], settings.items(), strict=True):
        setting = setting_of(name)
        low, high = setting.ranges.ramp
        edges = np.linspace(low, high, 7)
        for observer, each in result["observers"].items():
            ramps = [f for f in each["faults"] if f["kind"] == "ramp" and f["estimate_rmse_deg"] is not None]
            rate = np.array([abs(fault["size"]) for fault in ramps])
            error = np.array([fault["estimate_rmse_deg"] for fault in ramps])
            ax.plot(*_medians(rate, error, edges), label=f"{observer}, median", marker=".", **_look(observer))
            if observer == BOUNDED:
                dots = {"color": PROPOSED, "markersize": 2.0, "alpha": 0.45}
                ax.plot(rate, error, "o", markeredgewidth=0.0, label=f"{observer}, each fault", **dots)
        ax.set_title(result["title"])
        ax.set_yscale("log")
        ax.set_xlim(low, high)
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.set_xlabel("slope of the ramp [deg/s]")
    axes[0][0].set_ylabel("RMSE of the estimate [deg]")
    _legend(figure, axes[0][0], columns=3)
    return figure


def _medians(x: Any, y: Any, edges: Any) -> tuple[Any, Any]:
    """Centres of the bins that hold a few, and the medians of y in them."""
    members = [(x >= low) & (x <= high) for low, high in itertools.pairwise(edges)]
    centres = 0.5 * (edges[:-1] + edges[1:])
    full = [place for place, each in enumerate(members) if np.sum(each) >= FEW]
    return centres[full], [np.median(y[members[place]]) for place in full]


def _consistency(settings: dict[str, Any], results: Json) -> Figure:
    shown = {name: result for name, result in settings.items() if BOUNDED in result["observers"]}
    figure, axes = _canvas(1, len(shown), sharey=False)
    ages = results["ages_s"]
    lines = {
        "rms_deg": ("error, RMS", {"color": PROPOSED, "linewidth": 1.2}),
        "central_deg": ("68 % of the errors are within", {"color": PROPOSED, "dashes": (3.6, 1.2)}),
        "std_dev_deg": (
            "reported standard deviation, median",
            {"color": "#D55E00", "dashes": (5, 1.2, 1.2, 1.2)},
        ),
        "bound_deg": ("bound", {"color": BLACK, "linewidth": 0.9}),
    }
    for ax, result in zip(axes[0], shown.values(), strict=True):
        consistency = result["consistency"][BOUNDED]
        for name, (label, look) in lines.items():
            if name in consistency:
                ax.plot(ages, np.array(consistency[name], float), label=label, marker=".", **look)
        ax.set_title(f"{result['title']}, {BOUNDED}")
        ax.set_xlim(0.0, LATEST)
        ax.xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[5, 10]))
        ax.set_ylim(bottom=0.0)
        ax.set_xlabel("time since the onset [s]")
    axes[0][0].set_ylabel("error, standard deviation [deg]")
    _legend(figure, axes[0][0], columns=4)
    return figure
