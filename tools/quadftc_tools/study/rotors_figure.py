# pyright: basic
"""The figure of docs/rotors.md: how soon a weak rotor is named, and how often not, over size and slowness."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from quadftc_report.style import BLACK, PROPOSED
from quadftc_tools.study.page import canvas, no_minor, plain_ticks

# size or slowness, and when the rotor of each flight is named [s]; infinite: never
Curve = list[tuple[float, NDArray[np.float64]]]

PANEL = 2.3  # in
AXES = {
    "steps": ("share of thrust lost at once [%]", 100.0, (3, 5, 10, 20, 40, 60)),
    "slow": ("30 % lost over [s]", 1.0, (0.25, 0.5, 1, 2, 4, 8)),
}
DELAYS = (10, 20, 50, 100, 200, 500, 1000, 2000)  # ms


def draw_delays(curves: Mapping[str, Curve]) -> Figure:
    """Draw median and spread of the delays; of losses at once also the share that is not named."""
    figure, axes = canvas(1, len(AXES), PANEL, sharey=True)
    for ax, (name, (label, scale, ticks)) in zip(axes[0], AXES.items(), strict=True):
        points = sorted(curves[name], key=lambda point: point[0])
        places = np.array([scale * place for place, _ in points])
        spread = np.array([_spread(1e3 * delays) for _, delays in points])
        ax.fill_between(places, spread[:, 0], spread[:, 2], color=PROPOSED, alpha=0.2, linewidth=0.0)
        ax.plot(places, spread[:, 1], "o-", color=PROPOSED, markersize=3.0)
        ax.set(xscale="log", yscale="log", xlabel=label, ylim=(DELAYS[0], DELAYS[-1]))
        ax.set_xticks(ticks)
        ax.set_yticks(DELAYS)
        for axis in (ax.xaxis, ax.yaxis):
            plain_ticks(axis)
            no_minor(axis)
    axes[0][0].set_ylabel("named after [ms]\n(median; all that are named)")
    missed = axes[0][0].twinx()
    points = sorted(curves["steps"], key=lambda point: point[0])
    shares = [100.0 * float(np.mean(np.isinf(delays))) for _, delays in points]
    missed.plot([100.0 * size for size, _ in points], shares, "s--", color=BLACK, markersize=2.5)
    missed.set(ylim=(-3, 103), ylabel="not named within 2 s [%]")
    missed.grid(visible=False)
    return figure


def _spread(delays: NDArray[np.float64]) -> tuple[float, float, float]:
    """Least, median and largest of the delays of the flights in which the rotor is named."""
    named = delays[np.isfinite(delays)]
    return (named.min(), float(np.median(named)), named.max()) if len(named) else (np.nan, np.nan, np.nan)
