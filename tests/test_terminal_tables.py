"""Tables on the terminal: names and digits of the report's page; delays, misses and false alarms."""

from __future__ import annotations

import json
from functools import cache
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from quadftc_cli.commands.campaign import SHOWN
from quadftc_cli.commands.campaign import _table as campaign_table
from quadftc_cli.metric_table import DIAGNOSIS, axis_table, diagnosis_table, heading, text
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import parse_scenario
from quadftc_flight.summary import summary
from quadftc_model.samples import AXES
from quadftc_report.metric_kinds import describe
from quadftc_report.wording import NOTHING

TEXT = """
name: short
duration: 3 s
rate: 100 Hz
vehicle: qball_x4
faults: [{kind: bias, axes: roll, value: 2 deg, start: 2.2, stop: 2.8}]
schemes: {one: {observer: OBSERVER, disturbance_observer: exosystem, controller: ismc}}
"""


@cache
def metrics(observer: str = "supervised") -> dict[str, Any]:
    scenario = parse_scenario(TEXT.replace("OBSERVER", observer))
    scheme = scenario.scheme()
    return json.loads(json.dumps(summary(fly(scenario, "one"), scenario, scheme, None)["metrics"]))


def test_names_are_those_of_the_page():
    assert " ".join(heading("tracking_rmse_deg").split()) == describe("tracking_rmse_deg")[1].heading
    assert " ".join(heading("fault_windows.0.tracking_mean_deg").split()).startswith("1st fault window: mean")
    assert heading("diagnosis.delay_median_s.all").split() == ["detection", "delay,", "median", "[ms]"]


def test_digits_are_those_of_the_page():
    kind = describe("tracking_max_deg")[1]
    for axis in ("roll", "pitch"):
        value = metrics()["tracking_max_deg"][axis]
        expected = kind.text(value) if value >= 1e-4 or value < 1e-12 else "< 0.0001"
        assert text(metrics(), "tracking_max_deg", axis) == expected
    assert text(metrics(), "no.such.metric") == NOTHING


def test_misses_delays_and_false_alarms_are_shown():
    found = metrics()["diagnosis"]
    row = {path: text(metrics(), path) for path in DIAGNOSIS}
    assert row["diagnosis.missed"] == str(found["missed"])
    assert float(row["diagnosis.delay_max_s.all"]) == pytest.approx(
        1e3 * found["delay_max_s"]["all"], rel=1e-3
    )
    assert row["diagnosis.total_false_alarms"] == str(found["total_false_alarms"])


def test_columns_without_a_number_are_left_out_and_narrow_screens_get_fewer():
    wide, narrow = Console(width=200), Console(width=50)
    full = diagnosis_table({"a": metrics()}, wide)
    none = diagnosis_table({"a": metrics("sliding_mode")}, wide)
    assert len(none.columns) < len(full.columns)
    assert 1 < len(diagnosis_table({"a": metrics()}, narrow).columns) < len(full.columns)


def test_axis_table_has_a_row_for_each_axis():
    table = axis_table(metrics(), ["tracking_rmse_deg", "tracking_max_deg"])
    assert (table.row_count, len(table.columns)) == (3, 3)


def test_table_of_a_campaign_fits_the_screen_and_says_what_is_lost():
    each = {"flights": 20, "lost": 3, "faults": {}, "metrics": {}}
    each["metrics"] = {
        f"{name}.{axis}": {"count": 20, "q50": 0.1, "q95": 0.2} for name in SHOWN for axis in AXES
    }
    side = SimpleNamespace(name="mine", summary=each, has_observer=True, alarms_per_hour=lambda: 0.5)
    results: Any = SimpleNamespace(sides=[side])
    wide, narrow = (campaign_table(results, Console(width=width)) for width in (200, 45))
    cells = {str(column.header).replace("\n", " "): list(column.cells) for column in wide.columns}
    assert cells["lost"] == ["3"]
    assert "missed faults" not in cells
    assert [cells[name] for name in cells if "median" in name] == [["0.1 / 0.2"]] * 2
    assert 2 < len(narrow.columns) < len(wide.columns)
