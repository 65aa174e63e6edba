"""Tables and lines on the screen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from quadftc_flight.metrics import look_up
from quadftc_model.samples import AXES

# heading, metric (dotted path below "metrics"), factor, decimals; where there is no room, the last go first
COLUMNS = (
    ("tracking\nRMSE\n[deg]", "tracking_rmse_deg", 1.0, 3),
    ("mean error,\n1st fault\n[deg]", "fault_windows.0.tracking_mean_deg", 1.0, 3),
    ("estimate\nsettles in\n[ms]", "fault_windows.0.fault_estimate_settling_s", 1e3, 0),
    ("its error,\nsettled\n[deg]", "fault_estimate_max_settled_deg", 1.0, 3),
    ("tracking\nmax\n[deg]", "tracking_max_deg", 1.0, 3),
    ("torque\nvariation\n[N m/s]", "torque_total_variation", 1.0, 3),
)

WIDE = 1000  # characters; wider than any table


def console(stderr: bool = False) -> Console:
    """Console that does not wrap in files and pipes, where the width is unknown."""
    found = Console(stderr=stderr, highlight=False, soft_wrap=False)
    return found if found.is_terminal else Console(stderr=stderr, highlight=False, width=120)


def run_table(summaries: Sequence[Mapping[str, Any]], screen: Console) -> Table:
    """Table of runs: a row for each axis of each run, with as many columns as the screen has room for."""
    for count in range(len(COLUMNS), 1, -1):
        table = _run_table(summaries, count)
        if Measurement.get(screen, screen.options.update(max_width=WIDE), table).maximum <= screen.width:
            return table
    return _run_table(summaries, 1)


def _run_table(summaries: Sequence[Mapping[str, Any]], count: int) -> Table:
    columns = COLUMNS[:count]
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("run", "axis"):
        table.add_column(heading, no_wrap=True)
    for heading, *_ in columns:
        table.add_column(Text(heading), justify="right", no_wrap=True)
    table.add_column("checks\npassed", no_wrap=True)
    for item in summaries:
        factor = item["real_time_factor"]
        first = (item["name"], f"  {item['scheme']}", "" if factor is None else f"  {factor:.1f} x real time")
        for index, axis in enumerate(AXES):
            cells = [
                _number(_on_axis(metric_at(item["metrics"], path), axis), scale, digits)
                for _, path, scale, digits in columns
            ]
            table.add_row(first[index], axis, *cells, _verdict(item["checks"]) if index == 0 else "")
        table.add_section()
    return table


def failed_checks(summaries: Iterable[Mapping[str, Any]]) -> list[str]:
    """One line for each failed check."""
    return [
        f"{item['name']}-{item['scheme']}: {check['metric']} {check['axis'] or ''}".rstrip()
        + f" = {_number(check['value'], 1.0, 4)}, required {check['bound']}"
        for item in summaries
        for check in item["checks"]
        if not check["passed"]
    ]


def metric_at(metrics: Any, path: str) -> Any:
    """Metric at a dotted path, or None."""
    try:
        return look_up(metrics, path)
    except KeyError:
        return None


def _on_axis(values: Any, axis: str) -> Any:
    return cast("Mapping[str, Any]", values).get(axis) if isinstance(values, Mapping) else None


def _number(value: Any, scale: float, digits: int) -> str:
    return "-" if value is None else f"{scale * value:.{digits}f}"


def _verdict(checks: Sequence[Mapping[str, Any]]) -> str:
    """Checks passed, of all."""
    good = sum(check["passed"] for check in checks)
    colour = "green" if good == len(checks) else "red"
    return f"[{colour}]{good} of {len(checks)}[/]" if checks else "-"
