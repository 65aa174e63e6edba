"""What a lock-step benchmark prints: how fast the graph is beside the closed loop without ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median_high
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table


def lockstep_table(results: Sequence[Mapping[str, Any]]) -> Table:
    """One row for each rate, number of vehicles and form; medians of the runs."""
    title = f"lock-step, {results[0]['observer']}"
    table = Table("rate [Hz]", "vehicles", "form", box=SIMPLE_HEAD, title=title)
    for heading in ("times real time", "one sample [us]", "of the closed loop"):
        table.add_column(heading, justify="right")
    for rate, count in dict.fromkeys((item["rate"], item["vehicles"]) for item in results):
        rows = [item for item in results if (item["rate"], item["vehicles"]) == (rate, count)]
        alone = median_high([row["sample_us"] for row in rows if "without ROS" in row["form"]])
        for form in dict.fromkeys(row["form"] for row in rows):
            of_form = [row for row in rows if row["form"] == form]
            sample = median_high([row["sample_us"] for row in of_form])
            factor = median_high([row["real_time_factor"] for row in of_form])
            table.add_row(
                f"{rate:g}", f"{count}", form, f"{factor:.2f}", f"{sample:.0f}", f"{sample / alone:.2f}"
            )
    return table
