"""Runs side by side: grouped, tabled and told from their numbers, whatever they are called and lack."""

from __future__ import annotations

import dataclasses
import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from quadftc_bags.bag import Bag
from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import VECTORS, Flight
from quadftc_flight.metrics import look_up
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import Scenario, node_parameters, parse_scenario
from quadftc_flight.summary import summary
from quadftc_model import samples
from quadftc_report.comparison import Comparison, compare
from quadftc_report.metrics_table import metrics_table
from quadftc_report.statements import statements
from quadftc_report.wording import each_axis, plain, quantity, short, spread

TEXT = """
name: side_by_side
duration: 1 s
rate: 100 Hz
vehicle: qball_x4
disturbances: [{kind: constant, amplitude: [0.1 N m, 0, 0], start: 0.2}]
faults:
  - {kind: bias, axes: [roll, yaw], value: 2 deg, start: 0.4, stop: 0.9}
  - {kind: noise, channel: gyro, sigma: 0.1 deg/s, start: 0.8}
schemes:
  plain: {controller: smc, checks: [{metric: tracking_rmse_deg, axis: roll, below: 0.001}]}
  my-fast_one:
    {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc,
     checks: [{metric: tracking_rmse_deg, below: 9}]}
  pid: {controller: pid}
"""
HEALTHY = "name: calm\nduration: 0.5 s\nrate: 100 Hz\nvehicle: qball_x4\nschemes: {only: {controller: smc}}\n"


def made_run(scenario: Scenario, scheme: str, flight: Flight | None = None, **changes) -> RecordedRun:
    chosen = scenario.scheme(scheme)
    flown = flight or fly(node_parameters(scenario, scheme))
    flown = dataclasses.replace(flown, **changes)
    return RecordedRun(
        name=f"{scenario.name}-{scheme}",
        path=Path(scheme),
        bag=Bag(Path(scheme)),
        scenario=scenario,
        scheme=chosen,
        parameters={},
        flight=flown,
        summary=summary(flown, scenario, chosen, None),
        versions={},
    )


def rows_until(flight: Flight, count: int) -> Flight:
    return Flight(**{field.name: getattr(flight, field.name)[:count] for field in dataclasses.fields(Flight)})


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_scenario(TEXT)


@pytest.fixture(scope="module")
def runs(scenario) -> dict[str, RecordedRun]:
    return {scheme: made_run(scenario, scheme) for scheme in scenario.schemes}


@pytest.fixture(scope="module")
def three(runs) -> Comparison:
    return compare(runs.values())[0]


def told(comparison: Comparison) -> dict[str, str]:
    return {item.key: item.text for item in statements(comparison)}


def test_runs_are_compared_where_only_their_schemes_differ(runs, scenario):
    other = parse_scenario(TEXT.replace("duration: 1 s", "duration: 2 s"))
    first, second = compare([runs["plain"], made_run(other, "plain"), runs["my-fast_one"], runs["pid"]])
    assert [run.scheme.name for run in first.runs] == ["my-fast_one", "plain", "pid"]
    assert first.proposed is runs["my-fast_one"]
    assert first.compared == (runs["plain"], runs["pid"])
    assert (first.key, second.key) == ("side_by_side", "side_by_side-2")
    assert second.proposed is None
    assert first.ideal
    assert not compare([made_run(parse_scenario(TEXT + "sensors: {delay: 1}\n"), "plain")])[0].ideal


def test_runs_of_one_scheme_are_told_apart(runs, scenario):
    again = dataclasses.replace(runs["plain"], name="side_by_side-plain-again")
    both = Comparison(scenario, (runs["plain"], again))
    assert [both.label(run) for run in both.runs] == ["side_by_side-plain", "side_by_side-plain-again"]


def leaves(metrics, prefix="") -> set[str]:
    """The paths of all numbers of a summary but the times, axes and kinds of its windows and faults."""
    entries = metrics.items() if isinstance(metrics, dict) else enumerate(metrics)
    found = set()
    for name, value in entries:
        path = f"{prefix}{name}"
        if isinstance(value, (dict, list)) and name != "axes":
            found |= leaves(value, f"{path}.")
        elif name not in ("start", "stop", "axes", "axis", "kind"):
            found.add(path)
    return found


def test_table_has_every_metric_of_every_run_by_its_path(three):
    table = metrics_table(three)
    summaries = [run.summary["metrics"] for run in three.runs]
    known = {
        path
        for path in leaves(summaries[0])
        if not path.startswith("diagnosis.") or any(look_up(each, path) is not None for each in summaries)
    }
    assert sorted(row.path for row in table.rows) == sorted(known)
    assert (table.columns, table.baseline) == (("my-fast_one", "plain", "pid"), 1)
    for row in table.rows:
        values = [look_up(run.summary["metrics"], row.path) for run in three.runs]
        assert [cell.value for cell in row.cells] == values
        assert row.section != "Other"


def test_table_marks_the_smallest_and_tells_changes_against_the_baseline(three):
    rows = {row.path: row for row in metrics_table(three).rows}
    row = rows["tracking_rmse_deg.roll"]
    values = [cell.value for cell in row.cells]
    assert row.best == values.index(min(values)) == 0
    assert row.cells[0].change == pytest.approx(values[0] / values[1] - 1.0)
    assert (row.cells[1].change, row.cells[1].change_text) == (None, "")
    assert row.cells[0].change_text == f"{plain(round(100 * row.cells[0].change, 1))} %"
    assert rows["torque_rms.roll"].best is None  # less torque is not better
    settling = rows["fault_windows.0.fault_estimate_settling_s.roll"]
    assert [cell.text for cell in settling.cells][1:] == ["never", "never"]
    assert float(settling.cells[0].text) == pytest.approx(1e3 * settling.cells[0].value)


def faults_declared(run: RecordedRun, *rows: tuple[int, slice]) -> RecordedRun:
    """The run with axes declared faulty in some rows of its flight."""
    state = np.full((100, 3), samples.HEALTHY, np.uint8)
    for axis, part in rows:
        state[part, axis] = samples.FAULTY
    return made_run(run.scenario, run.scheme.name, run.flight, fault_state=state)


def test_table_says_of_each_fault_whether_and_when_it_was_detected(scenario, runs):
    found = faults_declared(runs["my-fast_one"], (0, slice(45, 90)))
    table = metrics_table(Comparison(scenario, (found, runs["plain"])))
    rows = {row.path: row for row in table.rows}
    section = "Diagnosis of the step on roll, from 0.4 to 0.9 s"
    detected = rows["diagnosis.events.0.detected"]
    assert (detected.section, [cell.text for cell in detected.cells]) == (section, ["yes", "no"])
    delay = rows["diagnosis.events.0.detection_delay_s"]
    assert ([cell.text for cell in delay.cells], delay.unit, delay.best) == (["50", "-"], "ms", 0)
    missed = rows["diagnosis.missed_by_kind.step"]
    assert (missed.section, missed.label) == ("Diagnosis of faults by kind: step", "missed faults")
    assert [cell.text for cell in missed.cells] == ["1", "2"]
    assert "diagnosis.nees.all" not in rows  # nobody gives a standard deviation
    sections = list(dict.fromkeys(row.section for row in table.rows))
    assert sections.index("Healthy axes") < sections.index("Fault window 1, from 0.4 to 0.9 s")
    assert sections[-1] == "Diagnosis of the step on yaw, from 0.4 to 0.9 s"
    assert [section for section, _ in itertools.groupby(table.rows, key=lambda row: row.section)] == sections


def test_best_is_one_run_and_one_that_estimates(runs, scenario):
    two = Comparison(scenario, (runs["my-fast_one"], runs["plain"]))
    rows = {row.path: row for row in metrics_table(two).rows}
    assert rows["fault_estimate_rmse_inside_deg.roll"].best == 0
    outside = rows["fault_estimate_rmse_outside_deg.roll"]
    assert outside.cells[1].value == 0.0  # right by estimating nothing
    assert outside.best is None
    tied = metrics_table(Comparison(scenario, (runs["plain"], runs["plain"])))
    assert {row.best for row in tied.rows} == {None}


def test_table_survives_zeros_and_missing_values(scenario, runs):
    still = made_run(scenario, "plain", **{name: np.zeros((100, 3)) for name in VECTORS})
    unknown = made_run(scenario, "my-fast_one", **{name: np.full((100, 3), np.nan) for name in VECTORS})
    rows = {row.path: row for row in metrics_table(Comparison(scenario, (unknown, still, runs["pid"]))).rows}
    cells = rows["tracking_rmse_deg.roll"].cells
    assert [cell.text for cell in cells[:2]] == ["-", "0"]
    assert [cell.change for cell in cells] == [None, None, None]
    assert rows["tracking_rmse_deg.roll"].best == 1
    assert rows["fault_windows.0.fault_estimate_settling_s.roll"].cells[0].text == "-"


def test_table_of_one_run_compares_nothing(scenario, runs):
    table = metrics_table(Comparison(scenario, (runs["plain"],)))
    assert table.baseline is None
    assert {(row.best, row.cells[0].change) for row in table.rows} == {(None, None)}


def test_metric_that_is_not_known_comes_last_under_its_own_name(scenario, runs):
    run = made_run(scenario, "plain", runs["plain"].flight)
    run.summary["metrics"]["detection_delay_s"] = {"roll": 0.5, "pitch": None, "yaw": None}
    last = metrics_table(Comparison(scenario, (run,))).rows[-3:]
    assert [(row.section, row.label, row.unit) for row in last] == [("Other", "detection delay", "s")] * 3


def test_statements_tell_what_was_injected_and_how_large_it_was(three):
    text = told(three)["injected"]
    assert "From 0.4 to 0.9 s the attitude reading is faulty: bias of 2 deg on roll and yaw." in text
    assert "From 0.8 s on the gyro is faulty: noise of 0.1 deg/s." in text
    assert "The recorded fault of the attitude is 2 (roll), 0 (pitch), 2 deg (yaw) at its largest." in text
    assert "A disturbance acts from 0.2 s on: constant torque of 0.1 (roll), 0 (pitch), 0 N m (yaw)." in text
    assert "The recorded disturbance is 0.1 (roll)" in text


def test_statements_tell_who_tracks_better_and_by_what_factor(three, runs, scenario):
    text = told(three)["tracking"]
    rmse = [run.summary["metrics"]["tracking_rmse_deg"]["roll"] for run in three.runs]
    for value in rmse:
        assert f"{plain(value)} (roll)" in text
    worse = Comparison(
        scenario, (made_run(scenario, "my-fast_one", angles=np.full((100, 3), 0.5)), runs["plain"])
    )
    assert re.search("The RMSE of 'my-fast_one' is .* times that of 'plain'", told(worse)["tracking"])
    same = Comparison(scenario, (runs["plain"], runs["plain"]))
    assert "differ by less than 10 %" in told(same)["tracking"]


def test_estimate_that_fails_is_told_to_fail(three, scenario, runs):
    good = runs["my-fast_one"]
    assert "within the 0.05 deg that count as settled" in told(three)["estimate"]
    wrong = made_run(scenario, "my-fast_one", good.flight, fault_estimate=good.flight.fault + np.radians(1.0))
    text = told(Comparison(scenario, (wrong,)))["estimate"]
    assert "it FAILS, being 20 times the 0.05 deg that count as settled" in text
    assert "It does not settle within 0.05 deg on roll and yaw from 0.4 to 0.9 s." in text


def test_observer_that_declares_nothing_is_told_to_miss_every_fault(three):
    text = told(three)["detection"]
    assert "'my-fast_one' (sliding_mode) declares no fault at any time: by its fault states it misses" in text
    assert (
        "misses both faults. Were an estimate above 0.3 deg taken for a fault, it would show 2 of 2" in text
    )
    assert "'plain'" not in text


def test_detection_isolation_and_recovery_are_told(scenario, runs):
    run = faults_declared(runs["my-fast_one"], (0, slice(45, 93)), (2, slice(42, 100)), (1, slice(10, 20)))
    text = told(Comparison(scenario, (run,)))["detection"]
    assert "'my-fast_one' (sliding_mode) detects both faults. The detection delay is at most 50 ms" in text
    assert "It trusts a sensor again at most 30 ms after the end of its fault." in text
    assert "It does NOT trust the sensor again after the step on yaw from 0.4 to 0.9 s." in text
    assert "It raises 1 false alarm, 2000 an hour" in text
    assert "declared faulty for 5.56 % of the time." in text
    assert "No healthy axis is blamed for the fault of another." in text


def test_declaration_left_over_from_a_fault_is_no_false_alarm():
    scenario = parse_scenario(TEXT.replace("duration: 1 s", "duration: 8 s").replace("rate: 100", "rate: 20"))
    run = made_run(scenario, "my-fast_one")
    state = np.where(run.flight.time[:, None] >= 0.4, samples.FAULTY, samples.HEALTHY) * np.ones((1, 3))
    state[:, 1] = samples.HEALTHY
    held = made_run(scenario, "my-fast_one", run.flight, fault_state=state.astype(np.uint8))
    text = told(Comparison(scenario, (held,)))["detection"]
    assert re.search(
        r"raises no false alarm; healthy axes are declared faulty for [\d.]+ % of the time, all of it", text
    )


def test_missed_fault_and_wrong_axis_are_told(scenario, runs):
    run = faults_declared(runs["my-fast_one"], (0, slice(40, 90)), (1, slice(40, 65)))
    text = told(Comparison(scenario, (run,)))["detection"]
    assert "detects 1 of 2 faults. It MISSES the step on yaw from 0.4 to 0.9 s." in text
    assert "A healthy axis is blamed for 50 % of the time in which others are faulty." in text


def test_axis_that_is_always_declared_faulty_is_not_told_to_detect(scenario, runs):
    run = faults_declared(runs["my-fast_one"], (0, slice(0, 100)), (2, slice(0, 100)))
    text = told(Comparison(scenario, (run,)))["detection"]
    assert "detects 0 of 2 faults. 2 times an axis was declared faulty before the onset already" in text


@pytest.mark.parametrize(
    ("std_dev_deg", "verdict"), [(1.0, "consistent"), (0.1, "too SMALL"), (1e4, "too large")]
)
def test_standard_deviations_are_judged(scenario, runs, std_dev_deg, verdict):
    run = faults_declared(runs["my-fast_one"], (0, slice(40, 90)), (2, slice(40, 90)))
    off = run.flight.fault + np.radians(1.0)
    std_dev = np.full((100, 3), np.radians(std_dev_deg))
    judged = made_run(scenario, "my-fast_one", run.flight, fault_estimate=off, fault_std_dev=std_dev)
    assert verdict in told(Comparison(scenario, (judged,)))["detection"]


def test_checks_are_counted_and_what_fails_is_told(three):
    text = told(three)["checks"]
    assert "'my-fast_one' passes all its 3 checks." in text
    assert re.search(
        r"'plain' FAILS 1 of 1 checks: tracking_rmse_deg \(roll\) is [\d.]+, required below 0.001", text
    )
    assert "The scenario checks nothing of 'pid'." in text


def test_fault_that_was_not_scheduled_is_told():
    more = "faults:\n  - {kind: bias, axes: pitch, value: 1 deg, start: 0.1, stop: 0.2}"
    scenario = parse_scenario(TEXT.replace("faults:", more))
    flight = made_run(scenario, "plain").flight
    scheduled = told(Comparison(scenario, (made_run(scenario, "plain", flight),)))["injected"]
    assert "Outside the schedule" not in scheduled
    fault = flight.fault.copy()
    fault[5] = np.radians(3.0)
    text = told(Comparison(scenario, (made_run(scenario, "plain", flight, fault=fault),)))["injected"]
    assert "Outside the schedule, too, the attitude was faulty, by up to 3 deg." in text


def test_flight_without_faults_and_disturbances_reads_well():
    text = told(Comparison(parse_scenario(HEALTHY), (made_run(parse_scenario(HEALTHY), "only"),)))
    assert text["injected"] == "No sensor fault is scheduled. No disturbance acts."
    assert text["estimate"].startswith("'only' has no fault observer")
    assert "paper" not in text
    watched = parse_scenario(HEALTHY.replace("{controller", "{observer: sliding_mode, controller"))
    text = told(Comparison(watched, (made_run(watched, "only"),)))
    assert "takes the healthy attitude for faulty by at most 0 deg" in text["estimate"]


def test_run_that_was_cut_short_is_told_up_to_its_end(scenario, runs):
    whole, part = runs["plain"], made_run(scenario, "my-fast_one", rows_until(runs["my-fast_one"].flight, 30))
    text = told(Comparison(scenario, (part, whole)))
    assert "none counts for 'my-fast_one', of which 300 ms of 1 s were recorded" in text["checks"]
    assert "300 ms of 'my-fast_one' and 1 s of 'plain'" in text["recording"]
    assert "times that of" not in text["tracking"]
    alone = told(Comparison(scenario, (part,)))
    assert "takes the healthy attitude for faulty" in alone["estimate"]
    assert alone["injected"].startswith("No sensor fault is scheduled")
    assert "no value" not in " ".join(alone.values())


def test_numbers_have_three_digits_and_no_exponent():
    assert [plain(value) for value in (0.000366123, -1.23456, 0.0, -0.0, 1e-5, 12345.6, 2.0)] == [
        *("0.000366", "-1.23", "0", "0", "0.00001", "12300", "2"),
    ]
    assert short(1e-5) == "below 0.0001"
    assert quantity(None, "deg") == "no value"
    assert each_axis({"roll": 1.0, "pitch": None, "yaw": 2.0}, "deg") == "1 (roll), 2 deg (yaw)"
    assert spread({"roll": 1.4, "pitch": 1.1, "yaw": 1.2}, "deg") == "1.1 (pitch) to 1.4 deg (roll)"
    assert spread({"roll": 1.0, "pitch": 9.0, "yaw": 1.0}, "deg") == "1 (roll), 9 (pitch), 1 deg (yaw)"
