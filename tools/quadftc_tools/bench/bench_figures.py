"""The figures: latencies, and the speed of batches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from quadftc_tools.bench.batch import WHOLE


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


def batch_figure(results: Sequence[Mapping[str, Any]], out: Path) -> Path:
    """Draw steps per second and core over the number of flights, a colour for what is simulated.

    Returns
    -------
    Path
        Of the figure.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    figure = Figure(figsize=(10.0, 5.0), layout="constrained")
    axes: Any = figure.subplots()
    measured = [row for row in results if "steps_per_second" in row and not row["name"].endswith(WHOLE)]
    names = list(dict.fromkeys(row["name"] for row in measured))
    fewest = min((row["cores"] for row in measured), default=1)
    lines: dict[tuple[str, str, int], list[Mapping[str, Any]]] = {}
    for row in measured:
        lines.setdefault((row["name"], row["precision"], row["cores"]), []).append(row)
    for (name, precision, cores), rows in lines.items():
        axes.plot(
            [row["flights"] for row in rows],
            [row["steps_per_second"]["best"] / cores for row in rows],
            color=f"C{names.index(name)}",
            linestyle="-" if precision == "float32" else "--",
            marker="o" if cores == fewest else "x",
            label=f"{name}, {precision}" if cores == fewest else None,
        )
    axes.set(xscale="log", yscale="log", xlabel="flights in a process", ylabel="steps per second and core")
    axes.set_title("crosses: on more cores; dashed: double precision")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    path = out / "batch.png"
    figure.savefig(path, dpi=120)  # pyright: ignore[reportUnknownMemberType]
    return path
