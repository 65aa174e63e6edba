"""The figure of latencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure


def latency_figure(results: Sequence[Mapping[str, Any]], out: Path) -> Path:
    """Draw the latency from stamp to torque, a histogram for each rate with all its runs; return its path.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    rates = list(dict.fromkeys(item["rate"] for item in results))
    figure = Figure(figsize=(8.0, 1.2 + 1.6 * len(rates)), layout="constrained")
    axes: Any = figure.subplots(len(rates), 1, sharex=True, squeeze=False)
    for axis, rate in zip(axes[:, 0], rates, strict=True):
        histograms = [item["histogram"] for item in results if item["rate"] == rate]
        counts = np.sum([item["counts"] for item in histograms], axis=0)
        axis.stairs(counts, histograms[0]["edges_us"], fill=True)
        axis.axvline(1e6 / rate, linestyle="--", color="black", linewidth=1.0)
        axis.set(xscale="log", yscale="log", ylabel="samples", title=f"{rate:g} Hz; dashed: one period")
        axis.set_ylim(bottom=0.7)
        axis.grid(alpha=0.3)
    axes[-1, 0].set(xlabel="IMU stamp to torque [us]")
    path = out / "latency.png"
    figure.savefig(path, dpi=120)  # pyright: ignore[reportUnknownMemberType]
    return path
