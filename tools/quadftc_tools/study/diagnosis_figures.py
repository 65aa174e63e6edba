# pyright: basic
"""The figures of docs/diagnosis.md, as PNG in the style of the report; always the same bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter

from quadftc_campaign.open_loop import WITHIN
from quadftc_tools.study.page import canvas, has_detector, legend, look, no_minor, plain_ticks

Json = Mapping[str, Any]

OURS = "supervised"  # drawn as the proposed one

PANEL = 2.3  # in
KINDS = ("step", "ramp", "sine")
NONE_AT = 1e-6  # share drawn for no false alarm at all
SHARES = (NONE_AT, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
SOONEST = 2e-3  # s; half a sample of the simulation
LATEST = 20.0  # s; the length of a fault


def _draw_roc(settings: Json) -> Figure:
    figure, axes = canvas(1, len(settings), PANEL, sharey=True)
    for ax, result in zip(axes[0], settings.values(), strict=True):
        for observer in result["observers"]:
            line = look(observer, list(result["observers"]), OURS)
            ax.plot(*_characteristic(result["roc"], observer), label=observer, **line)
            if has_detector(observer):
                point = next(each for each in result["roc"]["points"][observer] if each["level"] is None)
                ax.plot(*_at(point), "o", color=line["color"], markersize=4.5, zorder=4, clip_on=False)
        ax.set(title=result["title"], xscale="log", xlim=(0.6 * NONE_AT, 1.4), ylim=(-0.03, 1.03))
        ax.set_xlabel("false alarms, share of healthy time")
        ax.xaxis.set_major_locator(FixedLocator(SHARES))
        no_minor(ax.xaxis)
        ax.xaxis.set_major_formatter(FuncFormatter(_share))
    axes[0][0].set_ylabel(f"faults found within {WITHIN:g} s")
    legend(figure, axes[0][0])
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
    return "none" if value <= NONE_AT else f"{100.0 * value:g} %"


def _draw_delays(settings: Json) -> Figure:
    figure, axes = canvas(len(settings), len(KINDS), PANEL, sharey=True)
    for row, result in zip(axes, settings.values(), strict=True):
        for ax, kind in zip(row, KINDS, strict=True):
            for observer, each in result["observers"].items():
                time, share = _arrivals(observer, [f for f in each["faults"] if f["kind"] == kind])
                line = look(observer, list(result["observers"]), OURS)
                ax.plot(time, share, drawstyle="steps-post", label=observer, **line)
            ax.set(title=f"{result['title']}, {kind}", ylim=(-0.03, 1.03))
            ax.set(xscale="log", xlim=(SOONEST, LATEST))
            plain_ticks(ax.xaxis)
        row[0].set_ylabel("share of the faults found")
    for ax in axes[-1]:
        ax.set_xlabel("delay [s]")
    legend(figure, axes[0][0])
    return figure


def _arrivals(observer: str, faults: Sequence[Json]) -> tuple[Any, Any]:
    """Delays in order, and the share of the faults that were found by then."""
    name = "detection_delay_s" if has_detector(observer) else "above_threshold_delay_s"
    delays = np.sort([max(fault[name], SOONEST) for fault in faults if fault[name] is not None])
    shares = np.arange(1, len(delays) + 1) / max(len(faults), 1)
    last = shares[-1] if len(shares) else 0.0
    return np.concatenate([[SOONEST], delays, [LATEST]]), np.concatenate([[0.0], shares, [last]])


FIGURES = {
    "diagnosis_roc": _draw_roc,
    "diagnosis_delay": _draw_delays,
}
