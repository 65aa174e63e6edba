"""The metrics of a comparison as files: CSV with every number, LaTeX (booktabs) with the ones of a paper."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import RecordedReplay
from quadftc_report.comparison import Comparison, metric
from quadftc_report.metric_kinds import describe, list_metrics
from quadftc_report.wording import NOTHING

HEAD = ("scenario", "run", "metric", "axis", "name", "value")
OF_FLIGHTS = (
    "tracking_rmse_deg",
    "tracking_max_deg",
    "fault_estimate_max_settled_deg",
    "torque_total_variation",
)  # columns of the LaTeX table
OF_REPLAYS = ("fault_estimate_rmse_deg", "fault_estimate_max_deg", "fault_estimate_max_settled_deg")
_SPECIAL = re.compile(r"[\\&%$#_{}~^]")


def write_tables(comparison: Comparison[Any], directory: Path) -> list[Path]:
    """Write ``<key>.csv`` and ``<key>.tex``; return their paths."""
    table, latex = (directory / f"{comparison.key}.{suffix}" for suffix in ("csv", "tex"))
    with table.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(HEAD)
        writer.writerows(_numbers(comparison))
    latex.write_text(latex_table(comparison), encoding="utf-8")
    return [table, latex]


def _numbers(comparison: Comparison[Any]) -> Iterator[tuple[Any, ...]]:
    """Every number under its path in summary.json, in the unit that its name ends with."""
    for run in comparison.runs:
        leaves = {leaf.path: leaf for leaf in list_metrics(run.summary["metrics"])}  # one for all axes
        for leaf in leaves.values():
            for axis in AXES if leaf.has_axes else ("",):
                value = metric(run, f"{leaf.path}.{axis}" if axis else leaf.path)
                if value is not None:
                    yield comparison.key, comparison.label(run), leaf.path, axis, leaf.kind.label, value


def latex_table(comparison: Comparison[Any]) -> str:
    """Return a table with a row for each axis of each run; it needs the package booktabs."""
    of_replays = isinstance(comparison.runs[0], RecordedReplay)
    kinds = {path: describe(path)[1] for path in (OF_REPLAYS if of_replays else OF_FLIGHTS)}
    rows = [["run", "axis", *(kind.heading for kind in kinds.values())]]
    for run in comparison.runs:
        for axis in AXES:
            found = {path: metric(run, f"{path}.{axis}") for path in kinds}
            cells = [NOTHING if value is None else kinds[path].text(value) for path, value in found.items()]
            rows.append([comparison.label(run) if axis == AXES[0] else "", axis, *cells])
    lines = [f"{' & '.join(map(_escaped, row))} \\\\" for row in rows]
    columns = "ll" + "r" * len(kinds)
    begin = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", lines[0], r"\midrule"]
    return "\n".join([*begin, *lines[1:], r"\bottomrule", r"\end{tabular}", ""])


def _escaped(text: str) -> str:
    special = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    shown = _SPECIAL.sub(lambda found: special.get(found[0], f"\\{found[0]}"), text)
    return shown.replace(NOTHING, "--").replace("²", "$^2$")
