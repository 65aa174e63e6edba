"""Tables of which sensor is named, from rows that one can count by hand."""

import polars as pl
import pytest

from quadftc_flight.diagnosis_metrics.which_sensor import SAID
from quadftc_tools.study.which_sensor import make


def row(flight, sensor, named, delay, error, lost=False, wrong=0.0):
    fault = {"component": sensor, "kind": "step", "named": named, "naming_delay_s": delay}
    fault |= {"misnamed_share": wrong, "ambiguous_share": 0.25}
    errors = {"attitude_error_max_deg": error, "attitude_error_max_deg_ratio": 0.5 * error}
    times = {f"sensors.confusion_s.none.{said}": 10.0 for said in SAID} | {
        "sensors.confusion_s.none.none": 9.0
    }
    flown = {"flight": flight, "variant": "isolating", "observer": "isolating", "lost": lost, "fault": 0}
    return {**flown, **{f"fault.{name}": value for name, value in fault.items()}, **errors, **times}


FRAME = pl.DataFrame(
    [
        row(0, "gyro", True, 0.008, 1.0),
        row(1, "gyro", False, None, 90.0, lost=True, wrong=0.5),
        row(2, "attitude", True, 0.016, 3.0),
    ]
)


def cells(table, first):
    (line,) = [line for line in table.splitlines() if line.startswith(f"| {first} |")]
    return [cell.strip() for cell in line.strip("|").split("|")][1:]


def test_overview_and_kinds_count_what_was_named_and_lost():
    tables, figures = make({"which_sensor": FRAME})
    found = cells(tables["which-sensor"], "`isolating`")
    assert found[:6] == ["3", "1", "100 %", "50 %", "33.3 %", "12 / 15.6 ms"]
    assert cells(tables["which-sensor-kinds"], "gyro: step")[:3] == ["2", "50 %", "50 %"]
    assert cells(tables["which-sensor-kinds"], "gyro: step")[-1] == "0.5 / 45"
    assert not figures


@pytest.mark.parametrize(
    ("name", "column", "expected"), [("which_sensor_healthy", 1, "10 %"), ("which_sensor_steps", 0, "66.7 %")]
)
def test_other_campaigns_have_a_table_each(name, column, expected):
    tables, _ = make({name: FRAME})
    assert cells(tables[name.replace("_", "-")], "`isolating`")[column] == expected
