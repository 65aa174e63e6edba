"""Tables, figures and document of the study, from results that one can work out by hand."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from quadftc_tools.diagnosis_study.document import with_tables
from quadftc_tools.diagnosis_study.publish import publish
from quadftc_tools.diagnosis_study.results import characteristics, consistency, observed
from quadftc_tools.diagnosis_study.runs import AGES
from quadftc_tools.diagnosis_study.settings import SIMULATION
from quadftc_tools.diagnosis_study.tables import (
    bound_table,
    fault_table,
    isolation_table,
    metric_table,
    tables,
    worst_table,
)

PER_AXIS = {"roll": 0.0, "pitch": 0.0, "yaw": 0.0}
HEALTHY = {"roll": 1200.0, "pitch": 1200.0, "yaw": 1200.0}  # s: an hour in all
EVENT: dict[str, Any] = {
    "axis": "roll",
    "kind": "step",
    "start": 20.0,
    "stop": 40.0,
    "fault_max_deg": 2.0,
    "detected": True,
    "already_declared": False,
    "detection_delay_s": 0.008,
    "onset_error_s": 0.0,
    "recovered": True,
    "recovery_delay_s": 0.7,
    "above_threshold": True,
    "above_threshold_already": False,
    "above_threshold_delay_s": 0.004,
    "estimate_rmse_deg": 0.05,
    "estimate_bias_deg": 0.01,
    "estimate_max_deg": 0.2,
    "estimate_rmse_detected_deg": 0.05,
    "estimate_max_detected_deg": 0.2,
    "nees": 1.1,
    "coverage_2_sigma": 0.95,
    "tracking_rmse_deg": None,
}
DRAWN: dict[str, Any] = {
    "axis": "roll",
    "kind": "step",
    "size": -2.0,
    "frequency": None,
    "start": 20.0,
    "stop": 40.0,
    "errors_deg": [0.1] * len(AGES),
    "std_devs_deg": [0.05] * len(AGES),
}


def record(
    changes: dict[str, Any] | None = None, drawn: dict[str, Any] | None = None, **kinds
) -> dict[str, Any]:
    """A flight with one fault."""
    event, draw = {**EVENT, **(changes or {})}, {**DRAWN, **(drawn or {})}
    line = {"roll": 19.0, "pitch": 1.0, "yaw": 0.0, "none": 1.0, "time": 20.0}
    diagnosis = {
        "events": [event],
        "healthy_time_s": HEALTHY,
        "false_alarms": {"roll": 2, "pitch": 0, "yaw": 0},
        "false_alarm_time_s": {"roll": 36.0, "pitch": 0.0, "yaw": 0.0},
        "late_recovery_time_s": PER_AXIS,
        "isolation_tested_s": 19.0,
        "isolation_correct_s": 18.0,
        "confusion_single_s": {"none": {**line, "time": 40.0}, "roll": line},
        "confusion_any_s": {"roll": line},
        "confusion_by_kind_s": {"step": {"own": 19.0, "other": 1.0, "none": 1.0, "time": 20.0}},
        "by_estimate": {"healthy_time_s": HEALTHY, "false_alarm_time_s": {**PER_AXIS, "yaw": 360.0}},
    }
    return {"flight": "0", "diagnosis": diagnosis, "faults": [draw], "score": None, **kinds}


RAMP = {"kind": "ramp", "axis": "yaw", "start": 50.0}
FOUND = record()
MISSED = record(
    {**RAMP, "detected": False, "detection_delay_s": None, "recovered": None, "recovery_delay_s": None}
    | {"estimate_rmse_deg": 1.5, "nees": None, "coverage_2_sigma": None},
    {**RAMP, "size": 0.07, "errors_deg": [None] * len(AGES), "std_devs_deg": [None] * len(AGES)},
)


def rows_of(table: str) -> dict[str, list[str]]:
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    return {row[0]: row[1:] for row in cells}


def test_metrics_are_those_of_the_records_and_bold_where_they_reach_the_target():
    rows = rows_of(
        metric_table(SIMULATION, {"supervised": observed([FOUND]), "threshold": observed([FOUND, MISSED])})
    )
    assert rows[""] == ["target", "`supervised`", "`threshold`"]
    assert rows["faults"] == ["-", "1", "2"]
    assert rows["missed (declared before the onset)"] == ["0 (0)", "**0 (0)**", "1 (0)"]
    assert rows["delay, step, max"] == ["20 ms", "**8 ms**", "8 ms"]  # one fault was missed
    assert rows["delay, ramp, median"] == ["500 ms", "-", "-"]
    assert rows["RMSE of the estimate, median / 95 %"][:2] == ["0.08 / 0.25 deg", "**0.05 / 0.05 deg**"]
    assert rows["RMSE of the estimate, median / 95 %"][2] == "0.775 / 1.43 deg"
    assert rows["false alarms, share of healthy time"] == ["0 %", "1 %", "1 %"]
    assert rows["false alarms per hour"] == ["-", "2", "2"]
    assert rows["recovery delay, median / 95 %"] == ["-", "700 / 700 ms", "700 / 700 ms"]
    assert rows["errors within 2 standard deviations"] == ["-", "95 %", "95 %"]


def test_observer_without_detector_is_judged_by_the_size_of_its_estimate():
    never = {"detected": False, "detection_delay_s": None}
    rows = rows_of(metric_table(SIMULATION, {"sliding_mode": observed([record(never)])}))
    assert rows["missed (declared before the onset)"] == ["0 (0)", "**0 (0)**"]
    assert rows["delay, step, max"] == ["20 ms", "**4 ms**"]
    assert rows["false alarms, share of healthy time"] == ["0 %", "10 %"]
    assert rows["false alarms per hour"] == ["-", "-"]


def test_faults_are_counted_by_kind_and_size():
    biggest = record(drawn={"size": 5.0}, changes={"already_declared": True})
    lines = fault_table(SIMULATION, {"supervised": observed([FOUND, MISSED, biggest])}).splitlines()
    assert "| step | 1 to 2 deg | 0 | 0, 0 |" in lines
    assert "| step | 2 to 5 deg | 2 | 1, 0 |" in lines  # 2 belongs to it, and 5; one was declared before
    assert "| ramp | 0.05 to 0.1 deg/s | 1 | 1, 1 |" in lines
    assert len(lines) == 2 + 9


def test_worst_faults_come_first():
    lines = worst_table(observed([FOUND, MISSED])["faults"]).splitlines()
    assert lines[2] == "| 0 | yaw, 50 s | ramp of 0.07 deg/s | missed | 1.5 deg | 0.2 deg |"
    assert lines[3] == "| 0 | roll, 20 s | step of -2 deg | 8 ms | 0.05 deg | 0.2 deg |"


def test_isolation_is_in_shares_of_the_time():
    lines = isolation_table({"observers": {"supervised": observed([FOUND, FOUND])}}).splitlines()
    assert "| roll faulty | 95 % | 5 % | 0 % | 5 % | 40 s |" in lines
    assert "| step | 95 % | 5 % | 5 % | 40 s |" in lines
    assert lines[-1] == "Isolation accuracy of `supervised`: 94.7 % of 38 s."


def test_error_and_standard_deviation_are_held_against_the_bound_of_their_window():
    of_second = record({**RAMP}, {**RAMP, "size": 0.4})
    faults = observed([FOUND, of_second, MISSED])["faults"]
    found = consistency(faults, ((20.0, 40.0), (50.0, 70.0)))
    assert found["declared"] == [pytest.approx(2.0 / 3.0)] * len(AGES)
    assert found["rms_deg"] == [pytest.approx(0.1)] * len(AGES)
    ratios, errors = found["std_dev_over_bound"], found["rms_over_bound"]
    assert ratios[-1] < ratios[0]  # the bound grows
    assert all(
        error == pytest.approx(2.0 * ratio, rel=0.02) for error, ratio in zip(errors, ratios, strict=True)
    )
    lines = bound_table(AGES, found).splitlines()
    assert [line.split("|")[1].strip() for line in lines[2:]] == ["1 s", "5 s", "10 s", "20 s"]
    assert "bound_deg" not in consistency(faults, None)


def test_curves_add_up_and_points_have_their_level():
    score = {"levels": [1.0, 2.0], "alarms": [10, 0], "healthy": 100, "found": [1, 0], "faults": 1}
    other = {**score, "alarms": [30, 20], "found": [1, 1]}
    found = characteristics(
        {"sliding_mode": [record(score=score), record(score=other)], "supervised@4.5": [FOUND, MISSED]}
    )
    curve = found["curves"]["sliding_mode"]
    assert curve["false_alarm_share"] == [pytest.approx(0.2), pytest.approx(0.1)]
    assert curve["detection_probability"] == [1.0, 0.5]
    (point,) = found["points"]["supervised"]
    assert point == {"level": 4.5, "false_alarm_share": pytest.approx(0.01), "detection_probability": 0.5}


# --- document


TEXT = "a\n<!-- table: one -->\nold\n<!-- end -->\nb\n<!-- table: two -->\n<!-- end -->\n"


def test_tables_are_replaced_between_their_marks_and_nothing_else():
    text = with_tables(TEXT, {"two": "| x |"}, "page.md")
    assert text == TEXT.replace("two -->\n", "two -->\n| x |\n")
    assert with_tables(text, {"two": "| x |"}, "page.md") == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TEXT.replace("two", "three"), "page.md: no place for table 'two'"),
        (
            TEXT.replace("old\n<!-- end -->\n", ""),
            "page.md: table 'two' has no end|page.md: table 'one' has no end",
        ),
    ],
)
def test_document_without_a_place_is_refused(text: str, words: str):
    with pytest.raises(ValueError, match=words):
        with_tables(text, {"two": "| x |"}, "page.md")


def results() -> dict[str, Any]:
    both = {name: observed([FOUND, MISSED]) for name in ("supervised", "threshold")}
    windows = ((20.0, 40.0), (50.0, 70.0))
    simulation = {
        "title": "simulation",
        "bags": [],
        "observers": both,
        "roc": characteristics(
            {"supervised": [FOUND], "threshold": [FOUND], "supervised@3": [FOUND, MISSED]}
        ),
        "consistency": {name: consistency(each["faults"], windows) for name, each in both.items()},
    }
    isolation = {"title": "one axis", "bags": [], "observers": {"supervised": observed([FOUND])}}
    settings = {"simulation": simulation, "simulation_one_axis": isolation}
    return {"seed": 0, "within_s": 5.0, "ages_s": list(AGES), "settings": settings}


def test_results_become_tables_and_figures_the_same_each_time(tmp_path: Path):
    found, names = results(), tables(results())
    assert set(names) == {
        *("flown", "simulation", "faults-simulation", "worst-simulation", "isolation-simulation", "bound")
    }
    (tmp_path / "diagnosis.md").write_text(
        "".join(f"<!-- table: {name} -->\n<!-- end -->\n" for name in names)
    )
    before = copy.deepcopy(found)
    files = publish(found, tmp_path, tmp_path)
    assert found == before
    assert [file.suffix for file in files] == [".json", ".md", *[".png"] * 4]
    contents = [file.read_bytes() for file in files]
    assert all(content.startswith(b"\x89PNG") for content in contents[2:])
    assert b"| missed (declared before the onset) | 0 (0) | 1 (0) | 1 (0) |" in contents[1]
    publish(found, tmp_path, tmp_path)
    assert [file.read_bytes() for file in files] == contents


def test_document_of_the_repository_has_a_place_for_every_table():
    page = Path(__file__).resolve().parents[4] / "docs" / "diagnosis.md"
    text = page.read_text(encoding="utf-8")
    assert with_tables(text, {}, "docs/diagnosis.md") == text
    for of_simulation in tables(results()):
        for name in (of_simulation, of_simulation.replace("simulation", "recordings")):
            assert text.count(f"<!-- table: {name} -->") == 1
