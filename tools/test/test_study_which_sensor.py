"""Tables of which sensor is named, from rows that one can count by hand."""

import polars as pl

from quadftc_flight.diagnosis_metrics.which_sensor import SAID, TIME
from quadftc_flight.fault_schedule import SENSORS
from quadftc_tools.study.which_sensor import make, side_by_side


def row(flight, sensor, named, delay, error, lost=False, wrong=0.0):
    fault = {"component": sensor, "kind": "step", "named": named, "naming_delay_s": delay}
    fault |= {"misnamed_share": wrong, "ambiguous_share": 0.25}
    errors = {"attitude_error_max_deg": error, "attitude_error_rms_deg": 0.1 * error}
    errors |= {"attitude_error_max_deg_ratio": 0.5 * error}
    times = {f"sensors.confusion_s.none.{said}": 10.0 for said in SAID} | {
        "sensors.confusion_s.none.none": 9.0
    }
    times |= {
        f"sensors.confusion_s.{true}.{said}": 4.0 if said == TIME else 2.0
        for true in SENSORS
        for said in SAID
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
    tables = make({"which_sensor": FRAME})
    found = cells(tables["which-sensor"], "`isolating`")
    assert found[:6] == ["3", "1", "100 %", "50 %", "33.3 %", "12/15.6 ms"]
    kinds = cells(tables["which-sensor-kinds"], "step")
    assert kinds == ["100/25/3", "50/25/90", "-"]


def test_a_fault_may_cost_more_if_it_is_not_named():
    table = make({"which_sensor": FRAME})["which-sensor-costs"]  # by 2 deg without diagnosis
    assert cells(table, "`isolating`") == ["2", "0", "-", "1", "1", "90/2 deg"]
    without = FRAME.drop("attitude_error_max_deg_ratio")
    assert "which-sensor-costs" not in make({"which_sensor": without}), "nothing flew without diagnosis"


def test_two_faults_of_one_axis_are_listed_apart():
    first = [row(number, "attitude", True, 0.008, 1.0, lost=number == 0) for number in range(3)]
    second = [row(number, "gyro", number > 0, 0.008, 1.0, lost=number == 0) for number in range(3)]
    frame = pl.DataFrame([*first, *second])
    axes = pl.Series("fault.axis", ["roll"] * 3 + ["pitch", "roll", "yaw"])
    table = make({"two_faults": frame.with_columns(axes)})["two-faults"]
    assert cells(table, "`two_faults`")[:4] == ["`isolating`", "2", "1", "50 %"]
    assert cells(table, "`two_faults`, one axis")[:4] == ["`isolating`", "1", "0", "100 %"]


def test_other_observers_are_held_against_the_same_flights_without_diagnosis():
    plain = FRAME.with_columns(
        variant=pl.lit("plain"), observer=pl.lit("none"), attitude_error_max_deg=pl.lit(0.25)
    )
    parts = {"disturbance_observer": pl.lit("any"), "controller": pl.lit("any")}
    every = pl.concat([FRAME, plain]).with_columns(**parts)
    other = FRAME.head(1).with_columns(variant=pl.lit("other"), observer=pl.lit("supervised"), **parts)
    frame = side_by_side(every, other.drop("attitude_error_max_deg_ratio").drop("fault.misnamed_share"))
    assert sorted(frame["variant"]) == ["isolating", "other", "plain"]
    assert frame.filter(variant="other")["attitude_error_max_deg_ratio"].to_list() == [4.0]
    table = make({"which_sensor": every, "which_sensor_observers": frame})["which-sensor"]
    assert [cells(table, f"`{name}`")[0] for name in ("isolating", "plain", "other")] == ["3", "3", "1"]


def test_confusion_is_a_share_of_the_time_in_which_that_sensor_is_faulty():
    table = make({"which_sensor": FRAME})["which-sensor-confusion"]
    assert cells(table, "none")[1:] == ["100 %", "100 %", "100 %", "100 %", "90 %"]
    assert cells(table, "gyro")[3] == "50 %"


def test_share_of_time_in_which_a_healthy_sensor_is_declared():
    tables = make({"which_sensor_healthy": FRAME})
    assert cells(tables["which-sensor-healthy"], "`isolating`")[1] == "10 %"
