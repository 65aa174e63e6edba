"""What a batch benchmark prints: the measurements, and what each side simulates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from quadftc_tools.bench.batch import PLAIN_VMAP, WHOLE, WHOLE_DURATION

MILLION = 1e6
TITLE = "steps per second; flights of each process, core time of a step"
HEADINGS = (
    "cores",
    "flights each",
    "M steps/s",
    "median",
    "ns a step, core",
    "compile [s]",
    "MiB",
    "drawing",
)


def batch_table(results: Sequence[Mapping[str, Any]]) -> Table:
    """One row for each measurement; a simulator that does not run says why."""
    table = Table("simulated", "precision", box=SIMPLE_HEAD, title=TITLE)
    for heading in HEADINGS:
        table.add_column(heading, justify="right")
    for row in results:
        first = (row["name"], row["precision"], str(row["cores"]), str(row["flights"]))
        reason = row.get("absent") or row.get("failed")
        if reason is not None:
            table.add_row(row["name"], reason)
            continue
        speed = row["steps_per_second"]
        share = row["drawing_share"]
        table.add_row(
            *first,
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
    """How many times as fast as plain ``vmap`` the rewritten step is, a line each: best, then by repeats."""
    measured = {(row["name"], row["precision"], row["flights"], row["cores"]): row for row in results}
    lines: list[str] = []
    for (name, *rest), plain in measured.items():
        scheme, _, form = name.partition(", ")
        if form != PLAIN_VMAP or (staged := measured.get((scheme, *rest))) is None:
            continue
        best = staged["steps_per_second"]["best"] / plain["steps_per_second"]["best"]
        low = min(staged["repeats"]) / max(plain["repeats"])
        high = max(staged["repeats"]) / min(plain["repeats"])
        lines.append(
            f"{scheme}, {plain['precision']}: the rewritten step is {best:.2f} times as fast as plain vmap "
            f"({low:.2f} to {high:.2f})"
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
