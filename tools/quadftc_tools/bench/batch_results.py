# pyright: basic
"""What a batch benchmark shows: the measurements, what each side simulates, a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from quadftc_tools.bench.batch import IN_JAX, WHOLE, WHOLE_DURATION
from quadftc_tools.results_table import results_table

MILLION = 1e6
TITLE = "steps per second; flights of each process, core time of a step"
NUMBERS = ("cores", "flights each", "M steps/s", "median", "ns a step, core", "compile [s]", "MiB", "drawing")


def batch_table(results: Sequence[Mapping[str, Any]]) -> Table:
    """One row for each measurement; a simulator that does not run says why."""
    table = results_table(TITLE, ("simulated", "precision"), NUMBERS)
    for row in results:
        reason = row.get("absent") or row.get("failed")
        if reason is not None:
            table.add_row(row["name"], reason)
            continue
        speed, share = row["steps_per_second"], row["drawing_share"]
        table.add_row(
            *(row["name"], row["precision"], str(row["cores"]), str(row["flights"])),
            f"{speed['best'] / MILLION:.3g}",
            f"{speed['median'] / MILLION:.3g}",
            f"{row['ns_per_step_and_core']:,.0f}",
            f"{row['compile_s']:.1f}",
            f"{row['memory_mib']:.0f}",
            f"{100.0 * share:.0f} %" if share else "-",
        )
    return table


def flight_lines(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """How long one flight takes from its beginning to its end, random numbers included, a line each."""
    whole = [row for row in results if row["name"].endswith(WHOLE) and "seconds" in row]
    return [
        f"{row['name']} of {WHOLE_DURATION:g} s, {row['precision']}: "
        f"{row['seconds']['best']:.3f} s, median {row['seconds']['median']:.3f} s"
        for row in whole
    ]


def ratio_lines(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """How many times as fast as JAX with so many flights C is, a line each: best, then by repeats."""
    in_c = {(row["name"], row["cores"]): row for row in results}
    lines: list[str] = []
    for row in results:
        scheme, _, form = row["name"].partition(", ")
        if form != IN_JAX or (other := in_c.get((scheme, row["cores"]))) is None:
            continue
        best = other["steps_per_second"]["best"] / row["steps_per_second"]["best"]
        low = min(other["repeats"]) / max(row["repeats"])
        high = max(other["repeats"]) / min(row["repeats"])
        lines.append(
            f"{scheme}: C is {best:.2f} times as fast ({low:.2f} to {high:.2f}) as JAX, {row['precision']}, "
            f"with {row['flights']} flights at once; cores: {row['cores']}"
        )
    return lines


def what_lines(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """What is simulated under each name, a line each."""
    described = {row["name"]: row["what"] for row in results if "what" in row}
    return [
        f"{name}: {what['by']}; {what['states']}; {what['integrator']}; {what['control']}; "
        f"sensors: {what['sensors']}"
        for name, what in described.items()
    ]


def batch_figure(results: Sequence[Mapping[str, Any]], out: Path) -> Path:
    """Draw steps per second and core over the number of flights; return the path of the figure."""
    from matplotlib.figure import Figure

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
    if lines:
        axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    path = out / "batch.png"
    figure.savefig(path, dpi=120)
    return path
