"""Runs side by side: grouped, tabled and told in a sentence, whatever they are called and lack."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from recorded_runs import recorded_run

from quadftc_flight.closed_loop import fly
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import VECTORS, Flight
from quadftc_flight.live_run import LiveRun
from quadftc_flight.metrics import look_up
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import Scenario, parse_scenario
from quadftc_model import samples
from quadftc_report.comparison import Comparison, compare, is_ideal, list_injections, metric, tell_run
from quadftc_report.headline import headline
from quadftc_report.scene import rotor_shades
from quadftc_report.tables import Cell, metric_tables
from quadftc_report.wording import each_axis, plain, short

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
    flown = dataclasses.replace(flight or fly(scenario, scheme), **changes)
    return recorded_run(scenario, scheme, flown)


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
    return {run.scheme.name: tell_run(comparison, run) for run in comparison.runs}


def tabled(comparison: Comparison) -> dict[tuple[str, str], dict[str, Cell]]:
    """Path and axis of each number to its cells by run; with the section and the label."""
    found = {}
    for table in metric_tables(comparison, "flight"):
        for title, rows in table.groups.items():
            for heading, *cells in rows:
                for cell in cells:
                    data = cell.data
                    row = found.setdefault((data["metric"], data["axis"]), {"": (title, heading.text)})
                    row[data["run"].removeprefix(f"{comparison.runs[0].scenario.name}-")] = cell
    return found


def texts(row: dict[str, Cell]) -> list[str]:
    return [cell.text for name, cell in row.items() if name]


def best(row: dict[str, Cell]) -> list[str]:
    return [name for name, cell in row.items() if name and "best" in cell.look]


def test_runs_are_compared_where_only_their_schemes_differ(runs, scenario):
    other = parse_scenario(TEXT.replace("duration: 1 s", "duration: 2 s"))
    first, second = compare([runs["plain"], made_run(other, "plain"), runs["my-fast_one"], runs["pid"]])
    assert [run.scheme.name for run in first.runs] == ["my-fast_one", "plain", "pid"]
    assert first.proposed is runs["my-fast_one"]
    assert (first.key, second.key) == ("side_by_side", "side_by_side-2")
    assert second.proposed is None
    assert is_ideal(first)
    assert not is_ideal(compare([made_run(parse_scenario(TEXT + "sensors: {delay: 1}\n"), "plain")])[0])


def test_runs_of_one_scheme_are_told_apart(runs):
    again = dataclasses.replace(runs["plain"], name="side_by_side-plain-again")
    both = Comparison((runs["plain"], again), "both")
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
    rows = tabled(three)
    shown = {f"{path}.{axis}" if axis else path for path, axis in rows}
    summaries = [run.summary["metrics"] for run in three.runs]
    known = {
        path for path in leaves(summaries[0]) if any(look_up(each, path) is not None for each in summaries)
    }
    elsewhere = {path for path in known if "confusion_s" in path or path.endswith(".component")}
    assert known - elsewhere <= shown <= leaves(summaries[0])
    optional = ("diagnosis.", "sensors.", "position_")  # left out where no run has a number
    flown = {path for path in leaves(summaries[0]) if not path.startswith(optional)}
    assert flown <= shown
    for (path, axis), row in rows.items():
        for run in three.runs:
            value = look_up(run.summary["metrics"], f"{path}.{axis}" if axis else path)
            exact = "" if value is None else repr(float(value))
            assert row[run.scheme.name].data["value"] == exact
        assert row[""][0] != "Other"


def test_table_marks_the_smallest_and_tells_changes_against_the_baseline(three):
    rows = tabled(three)
    row = rows["tracking_rmse_deg", "roll"]
    values = {name: float(cell.data["value"]) for name, cell in row.items() if name}
    assert best(row) == [min(values, key=values.get)] == ["my-fast_one"]
    change = 100.0 * (values["my-fast_one"] / values["plain"] - 1.0)
    assert (row["my-fast_one"].small, row["plain"].small) == (f"{plain(round(change, 1))} %", "")
    assert best(rows["torque_rms", "roll"]) == []  # less torque is not better
    settling = rows["fault_windows.0.fault_estimate_settling_s", "roll"]
    assert texts(settling)[1:] == ["never", "never"]
    first = settling["my-fast_one"]
    assert float(first.text) == pytest.approx(1e3 * float(first.data["value"]))


def faults_declared(run: RecordedRun, *rows: tuple[int, slice]) -> RecordedRun:
    """The run with axes declared faulty in some rows of its flight."""
    state = np.full((100, 3), samples.HEALTHY, np.uint8)
    for axis, part in rows:
        state[part, axis] = samples.FAULTY
    return made_run(run.scenario, run.scheme.name, run.flight, fault_state=state)


def test_table_says_of_each_fault_whether_and_when_it_was_detected(runs):
    found = faults_declared(runs["my-fast_one"], (0, slice(45, 90)))
    rows = tabled(Comparison((found, runs["plain"]), "two"))
    section = "Diagnosis of the step on roll, from 0.4 to 0.9 s"
    detected = rows["diagnosis.events.0.detected", ""]
    assert (detected[""][0], texts(detected)) == (section, ["yes", "no"])
    delay = rows["diagnosis.events.0.detection_delay_s", ""]
    assert (texts(delay), delay[""][1]) == (["50", "–"], "detection delay [ms]")
    assert best(delay) == ["my-fast_one"]
    missed = rows["diagnosis.missed_by_kind.step", ""]
    assert missed[""] == ("Diagnosis of faults by kind: step", "missed faults")
    assert texts(missed) == ["1", "2"]
    assert ("diagnosis.nees.all", "") not in rows  # nobody gives a standard deviation
    sections = list(dict.fromkeys(row[""][0] for row in rows.values()))
    assert sections.index("Healthy axes") < sections.index("Fault window 1, from 0.4 to 0.9 s")
    assert "Diagnosis of the step on yaw, from 0.4 to 0.9 s" in sections
    assert sections[-1] == "Naming of the sensor: gyro noise on yaw, from 0.8 to 1 s"


def test_best_is_one_run_and_one_that_estimates(runs):
    rows = tabled(Comparison((runs["my-fast_one"], runs["plain"]), "two"))
    assert best(rows["fault_estimate_rmse_inside_deg", "roll"]) == ["my-fast_one"]
    outside = rows["fault_estimate_rmse_outside_deg", "roll"]
    assert outside["plain"].data["value"] == "0.0"  # right by estimating nothing
    assert best(outside) == []
    tied = tabled(Comparison((runs["plain"], dataclasses.replace(runs["plain"], name="again")), "tied"))
    assert not any(best(row) for row in tied.values())


def test_table_survives_zeros_and_missing_values(scenario, runs):
    still = made_run(scenario, "plain", **{name: np.zeros((100, 3)) for name in VECTORS})
    unknown = made_run(scenario, "my-fast_one", **{name: np.full((100, 3), np.nan) for name in VECTORS})
    rows = tabled(Comparison((unknown, still, runs["pid"]), "three"))
    row = rows["tracking_rmse_deg", "roll"]
    assert texts(row)[:2] == ["–", "0"]
    assert {cell.small for name, cell in row.items() if name} == {""}
    assert best(row) == ["plain"]
    assert texts(rows["fault_windows.0.fault_estimate_settling_s", "roll"])[0] == "–"


def test_table_of_one_run_compares_nothing(runs):
    rows = tabled(Comparison((runs["plain"],), "one"))
    assert not any(best(row) or row["plain"].small for row in rows.values())


def test_metric_that_is_not_known_comes_last_under_its_own_name(scenario, runs):
    run = made_run(scenario, "plain", runs["plain"].flight)
    run.summary["metrics"]["arming_delay_s"] = {"roll": 0.5, "pitch": None, "yaw": None}
    title, rows = list(metric_tables(Comparison((run,), "one"), "flight")[0].groups.items())[-1]
    assert (title, [row[0].text for row in rows]) == ("Other", ["arming delay [s]"])


def test_injections_are_told_with_time_place_and_size(three, scenario, runs):
    lines = list_injections(three.longest)
    assert lines == [
        ("0.4 to 0.9 s", "attitude: roll and yaw", "bias: value 2 deg"),
        ("0.8 s on", "gyro: all axes", "noise: sigma 0.1 deg/s"),
        ("0.2 s on", "torque", "constant: amplitude (0.1, 0, 0) N m"),
    ]
    fault = runs["plain"].flight.fault.copy()
    fault[5] = np.radians(3.0)
    by_hand = list_injections(made_run(scenario, "plain", runs["plain"].flight, fault=fault))
    assert by_hand == [*lines, ("outside the schedule", "attitude", "up to 3 deg")]
    assert list_injections(made_run(parse_scenario(HEALTHY), "only")) == []


def test_faults_of_a_live_flight_are_those_that_were_recorded():
    run = made_run(parse_scenario(HEALTHY), "only")
    known = {each.name: getattr(run, each.name) for each in dataclasses.fields(run)}
    event = FaultEvent("2", "loss", 0.1, 0.3, "rotor")
    live = LiveRun(**known, events=(), rotor_events=(event,), setpoints=())
    assert list_injections(live) == [("0.1 to 0.3 s", "rotor: 2", "loss, in the recording")]
    assert [shade[:2] for shade in rotor_shades(live, 1, 0.5)] == [(0.1, 0.3)]
    assert rotor_shades(live, 0, 0.5) == ()


def test_sentence_tells_tracking_detection_and_checks(three, runs):
    text = told(three)
    for run in three.runs:
        rmse = run.summary["metrics"]["tracking_rmse_deg"]["roll"]
        assert f"tracks with an RMSE of roll {plain(rmse)}, pitch" in text[run.scheme.name]
    assert text["my-fast_one"].startswith("'my-fast_one' (sliding_mode, exosystem, ismc) tracks")
    assert text["my-fast_one"].endswith("; declares none of 2 faults; passes 3 of 3 checks.")
    assert text["plain"].endswith("; has no fault observer; passes 0 of 1 check.")
    assert "check" not in text["pid"]


def test_verdict_is_on_the_best_run_beside_the_one_without_diagnosis(three, runs):
    found = headline(three)
    error, bare = (metric(runs[name], "attitude_error_max_deg") for name in ("my-fast_one", "plain"))
    assert (
        f"holds the attitude within {short(error)} deg; without diagnosis {short(bare)} deg" in found.sentence
    )
    assert found.sentence.endswith("; plain: 1 of 1 check FAILED.")
    assert (found.is_good, found.contrast) == (False, pytest.approx(bare / error))
    assert [run.scheme.name for run in found.shown.runs] == ["my-fast_one", "plain"]
    alone = headline(Comparison((runs["pid"],), "one"))
    assert alone.sentence.startswith("pid holds the attitude within ")
    assert alone.sentence.endswith(" and has no diagnosis.")
    declared = faults_declared(
        runs["my-fast_one"], (0, slice(45, 93)), (2, slice(42, 100)), (1, slice(10, 20))
    )
    said = headline(Comparison((declared,), "one")).sentence
    assert " names 2 of 5 faults after 35 ms (median), gives 1 false alarm and " in said


def test_sentence_counts_faults_found_and_false_alarms(runs):
    run = faults_declared(runs["my-fast_one"], (0, slice(45, 93)), (2, slice(42, 100)), (1, slice(10, 20)))
    text = told(Comparison((run,), "one"))["my-fast_one"]
    assert "detects 2 of 2 faults with 1 false alarm" in text
    missed = faults_declared(runs["my-fast_one"], (0, slice(40, 90)))
    assert "detects 1 of 2 faults" in told(Comparison((missed,), "one"))["my-fast_one"]
    always = faults_declared(runs["my-fast_one"], (0, slice(0, 100)), (2, slice(0, 100)))
    assert "detects 0 of 2 faults" in told(Comparison((always,), "one"))["my-fast_one"]


def test_sentence_of_a_run_cut_short_says_how_much_there_is(scenario, runs):
    part = made_run(scenario, "my-fast_one", runs["my-fast_one"].flight.first(30))
    text = told(Comparison((part, runs["plain"]), "two"))["my-fast_one"]
    assert "was recorded for 300 ms only; tracks" in text
    assert "check" not in text


def test_numbers_have_three_digits_and_no_exponent():
    assert [plain(value) for value in (0.000366123, -1.23456, 0.0, -0.0, 1e-5, 12345.6, 2.0)] == [
        *("0.000366", "-1.23", "0", "0", "0.00001", "12300", "2"),
    ]
    assert short(1e-5) == "below 0.0001"
    assert each_axis([1.0, None, 2.0], "deg") == "roll 1, pitch –, yaw 2 deg"
