# pyright: basic
"""Tables of metrics on the terminal: the names and the digits of the report's page."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from quadftc_cli.screen import plain_table
from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_flight.metrics import look_up
from quadftc_model.samples import AXES
from quadftc_report.metric_kinds import TINY, describe
from quadftc_report.wording import NOTHING, SMALLEST

WIDE = 1000  # characters; wider than any table
HEADING = 12  # characters of a line of a heading

# of faults and alarms, over the whole flight (dotted paths below "metrics"); where there is no room, the last
# go first
DIAGNOSIS = (
    "diagnosis.fault_count",
    "diagnosis.missed",
    "diagnosis.delay_median_s.all",
    "diagnosis.delay_max_s.all",
    "diagnosis.total_false_alarms",
    "diagnosis.total_false_alarms_per_hour",
    "sensors.unnamed.all",
    "sensors.naming_delay_median_s.all",
)


def heading(path: str) -> str:
    """Return the name of a metric on the page, with its unit, in short lines."""
    where = "1st fault window: " if path.startswith("fault_windows.0.") else ""
    return in_short_lines(where + describe(path)[1].heading)


def in_short_lines(words: str) -> str:
    """Break the heading of a column into lines."""
    return textwrap.fill(words, HEADING, break_long_words=False)


def text(metrics: Metrics, path: str, axis: str = "") -> str:
    """Write a metric as the page does, a tiny one as in its summary; a dash where there is none."""
    try:
        found = look_up(metrics, f"{path}.{axis}" if axis else path)
    except KeyError:
        return NOTHING
    if not isinstance(found, (int, float)):
        return NOTHING
    kind = describe(path)[1]
    return kind.text(found) if abs(found) >= SMALLEST or abs(found) < TINY else f"< {SMALLEST}"


def fitting(tables: Iterator[Table], screen: Console) -> Table:
    """Return the first table that the screen has room for, else the last."""
    wide = screen.options.update(max_width=WIDE)
    table = next(tables)
    for other in tables:
        if Measurement.get(screen, wide, table).maximum <= screen.width:
            break
        table = other
    return table


def diagnosis_table(metrics: Mapping[str, Metrics], screen: Console) -> Table:
    """Tabulate faults, misses, delays and false alarms, by name of a run, as wide as the screen.

    Columns without any number are left out: of an observer that names no sensor, of a flight without faults.
    """
    paths = [path for path in DIAGNOSIS if any(text(each, path) != NOTHING for each in metrics.values())]

    def table(count: int) -> Table:
        made = plain_table(["diagnosis"], map(heading, paths[:count]))
        for name, each in metrics.items():
            made.add_row(name, *(text(each, path) for path in paths[:count]))
        return made

    return fitting(map(table, range(len(paths), 0, -1) or [0]), screen)


def axis_table(metrics: Metrics, paths: Sequence[str]) -> Table:
    """Tabulate metrics of one run, a row for each axis."""
    table = plain_table(["axis"], map(heading, paths))
    for axis in AXES:
        table.add_row(axis, *(text(metrics, path, axis) for path in paths))
    return table
