"""Tables and lines on the screen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from quadftc_bench.flight import AXES

# heading, metric (dotted path below "metrics"), decimals
COLUMNS = (
    ("tracking RMSE\n[deg]", "tracking_rmse_deg", 3),
    ("tracking max\n[deg]", "tracking_max_deg", 2),
    ("mean error in 1st\nfault window [deg]", "fault_windows.0.tracking_mean_deg", 3),
    ("fault estimate max,\nsettled [deg]", "fault_estimate_max_settled_deg", 3),
    ("torque variation\n[N m/s]", "torque_total_variation", 2),
)


def console(stderr: bool = False) -> Console:
    """Console that does not wrap in files and pipes, where the width is unknown."""
    found = Console(stderr=stderr, highlight=False, soft_wrap=False)
    return found if found.is_terminal else Console(stderr=stderr, highlight=False, width=160)


def run_table(summaries: Sequence[Mapping[str, Any]]) -> Table:
    """Table of runs: one row a run, roll / pitch / yaw in each cell."""
    table = Table(title="roll / pitch / yaw", title_justify="left", title_style="dim", show_lines=False)
    table.add_column("run", no_wrap=True)
    for heading, _, _ in COLUMNS:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("x real\ntime", justify="right")
    table.add_column("checks", no_wrap=True)
    for item in summaries:
        cells = [axes_cell(metric_at(item["metrics"], path), digits) for _, path, digits in COLUMNS]
        factor = item["real_time_factor"]
        table.add_row(
            f"{item['name']}\n  {item['scheme']}",
            *cells,
            "-" if factor is None else f"{factor:.1f}",
            _verdict(item["checks"]),
        )
    return table


def failed_checks(summaries: Iterable[Mapping[str, Any]]) -> list[str]:
    """One line for each failed check."""
    return [
        f"{item['name']}-{item['scheme']}: {check['metric']}{'' if check['axis'] is None else ' ' + check['axis']}"
        f" = {_number(check['value'], 4)}, required {check['bound']}"
        for item in summaries
        for check in item["checks"]
        if not check["passed"]
    ]


def metric_at(metrics: Any, path: str) -> Any:
    """Metric at a dotted path, or None."""
    place = metrics
    for word in path.split("."):
        if isinstance(place, list):
            place = place[int(word)] if int(word) < len(place) else None
        else:
            place = place.get(word) if isinstance(place, Mapping) else None
    return place


def axes_cell(values: Any, digits: int) -> str:
    """Text of a metric with axes."""
    if not isinstance(values, Mapping):
        return "-"
    return " / ".join(_number(values.get(axis), digits) for axis in AXES)


def _number(value: Any, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _verdict(checks: Sequence[Mapping[str, Any]]) -> str:
    if not checks:
        return "none"
    failed = sum(not check["passed"] for check in checks)
    return f"[red]{failed} of {len(checks)} failed[/]" if failed else f"[green]{len(checks)} passed[/]"
