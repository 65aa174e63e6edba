"""The study of diagnosis: tables, figures and page from tables that one can work out by hand."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from quadftc_campaign.campaign_file import load_campaign
from quadftc_campaign.flights import flight_scenario
from quadftc_campaign.open_loop import flatten
from quadftc_campaign.table import table_of
from quadftc_flight.diagnosis_metrics import GRACE_TIME, diagnosis_metrics
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import unknown_flight
from quadftc_model.samples import FAULTY
from quadftc_model.samples import HEALTHY as TRUSTED
from quadftc_tools.study.diagnosis import make
from quadftc_tools.study.diagnosis_quiet import (
    GROUPS,
    QUIET,
    healthy_table,
    outlier_table,
    quiet_results,
    sum_up_healthy,
    sum_up_outliers,
)
from quadftc_tools.study.diagnosis_results import (
    TITLES,
    characteristics,
    operating_point,
    setting_results,
    sum_up,
)
from quadftc_tools.study.diagnosis_tables import CRITERIA, metric_table, tables
from quadftc_tools.study.page import publish, with_tables

ROOT = Path(__file__).resolve().parents[2]
MEMS = CRITERIA["mems"]
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
    "declared_after_s": 0.7,
    "above_threshold": True,
    "above_threshold_already": False,
    "above_threshold_delay_s": 0.004,
    "estimate_rmse_deg": 0.05,
    "estimate_bias_deg": 0.01,
    "estimate_max_deg": 0.2,
    "estimate_rmse_detected_deg": 0.05,
    "estimate_max_detected_deg": 0.2,
    "declared_share": 1.0,
    "nees": 1.1,
    "coverage_2_sigma": 0.95,
    "tracking_rmse_deg": None,
}
STEP = {
    "spec": f"bias channel=attitude axes=roll start=20.0 stop=40.0 value={math.radians(-2.0)!r}",
}


def flown(number: int, variant: str, event: dict[str, Any] | None = None, **kinds: Any) -> dict[str, Any]:
    """A flight with one fault."""
    diagnosis = {
        "healthy_time_s": HEALTHY,
        "false_alarms": {"roll": 2, "pitch": 0, "yaw": 0},
        "false_alarm_time_s": {"roll": 36.0, "pitch": 0.0, "yaw": 0.0},
        "late_recovery_time_s": PER_AXIS,
        "longest_false_alarm_s": {"roll": 20.0, "pitch": 0.0, "yaw": 0.0},
        "by_estimate": {"healthy_time_s": HEALTHY, "false_alarm_time_s": {**PER_AXIS, "yaw": 360.0}},
    }
    score = {"levels": [1.0, 2.0], "alarms": [10, 0], "healthy": 100, "found": [1, 0], "faults": 1}
    faults = {f"fault.{name}": value for name, value in {**EVENT, **STEP, **(event or {})}.items()}
    common = {"flight": number, "variant": variant, "observer": variant, "recording": "simulated"}
    scores = {f"roc.{name}": value for name, value in {**score, **kinds}.items()}
    return {**common, "finite": True, **flatten(diagnosis), **scores, "fault": 0, **faults}


RAMP = {"kind": "ramp", "axis": "yaw", "start": 50.0, "stop": 70.0}
RAMP |= {"spec": f"drift channel=attitude axes=yaw start=50.0 stop=70.0 rate={math.radians(0.07)!r}"}
MISSED = {
    **RAMP,
    "detected": False,
    "detection_delay_s": None,
    "recovered": None,
    "recovery_delay_s": None,
    "estimate_rmse_deg": 1.5,
    "nees": None,
    "coverage_2_sigma": None,
}


def frame_of(*events: dict[str, Any], variant: str = "supervised") -> pl.DataFrame:
    return table_of([flown(number, variant, event) for number, event in enumerate(events)])


def rows_of(table: str) -> dict[str, list[str]]:
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    return {row[0]: row[1:] for row in cells}


def test_metrics_are_those_of_the_records_and_bold_where_they_reach_the_target():
    rows = rows_of(
        metric_table(MEMS, {"supervised": sum_up(frame_of({})), "threshold": sum_up(frame_of({}, MISSED))})
    )
    assert rows[""] == ["target", "`supervised`", "`threshold`"]
    assert rows["missed (declared before the onset)"] == ["0 (0)", "**0 (0)**", "1 (0)"]
    assert rows["delay, step, max"] == ["20 ms", "**8 ms**", "8 ms"]  # one fault was missed
    assert rows["delay, ramp, median"] == ["500 ms", "-", "-"]
    assert rows["RMSE of the estimate, median / 95 %"][:2] == ["0.08 / 0.25 deg", "**0.05 / 0.05 deg**"]
    assert rows["RMSE of the estimate, median / 95 %"][2] == "0.775 / 1.43 deg"
    assert rows["false alarms, share of healthy time"] == ["0 %", "1 %", "1 %"]


def test_isolating_has_no_column_of_its_own():
    both = pl.concat([frame_of({}), frame_of(MISSED, variant="isolating")], how="diagonal_relaxed")
    made = tables({"mems": setting_results("mems", both, None, {"seed": 1})})
    assert rows_of(made["mems"])[""] == ["target", "`supervised`"]


def test_observer_without_detector_is_judged_by_the_size_of_its_estimate():
    never = {"detected": False, "detection_delay_s": None}
    rows = rows_of(metric_table(MEMS, {"sliding_mode": sum_up(frame_of(never))}))
    assert rows["missed (declared before the onset)"] == ["0 (0)", "**0 (0)**"]
    assert rows["delay, step, max"] == ["20 ms", "**4 ms**"]
    assert rows["false alarms, share of healthy time"] == ["0 %", "10 %"]


def test_alarms_of_healthy_flights_are_those_of_all_recordings():
    rows = [{**flown(number, "supervised"), "recording": name} for number, name in enumerate("ab")]
    rows[1] |= {"false_alarms.roll": 0, "false_alarm_time_s.roll": 0.0, "longest_false_alarm_s.roll": 0.0}
    found = sum_up_healthy(table_of(rows))
    assert found == {"share": pytest.approx(0.005), "alarms": 2.0, "longest_s": 20.0}
    lines = healthy_table({"supervised": found}).splitlines()
    assert lines[2:] == ["| all recordings | 0.5 % (2, longest 20 s) |"]


def test_outliers_are_counted_by_their_length_and_the_declaration_after_them_is_timed():
    silent = {"detected": False, "declared_after_s": 0.0, "stop": 20.004}
    late = {"detected": False, "declared_after_s": 0.3, "stop": 20.1}
    events = (silent, late, {**late, "declared_after_s": 0.1}, {**late, "already_declared": True})
    found = sum_up_outliers(frame_of(*events, {**silent, "kind": "noise", "stop": 20.8}))
    assert [found[name]["count"] for name in GROUPS] == [1, 2, 1]
    assert found[GROUPS[1]] == {"count": 2, "declared": 2, "after_median_s": 0.2, "after_max_s": 0.3}
    assert outlier_table({"supervised": found}).splitlines()[2:] == [
        f"| {GROUPS[0]} | 1 | 0 |",
        f"| {GROUPS[1]} | 2 | 2, after the end 200 / 300 ms |",
        f"| {GROUPS[2]} | 1 | 0 |",
    ]


def test_a_fault_and_its_axes_may_both_be_drawn():
    drawn = {"faults.0": "bias", "faults.0.axes": "roll"}
    assert sum_up(table_of([{**flown(0, "supervised"), **drawn}]))["pooled"]["fault_count"] == 1


def test_curves_add_up_and_points_have_their_level():
    rows = [flown(0, "sliding_mode"), flown(1, "sliding_mode", alarms=[30, 20], found=[1, 1])]
    levels = [flown(number, "supervised@4.5", event) for number, event in enumerate(({}, MISSED))]
    main = [flown(0, "supervised"), flown(1, "supervised"), flown(2, "supervised", MISSED)]
    found = characteristics(table_of([*rows, *main]), table_of(levels))
    assert set(found["curves"]) == {"sliding_mode"}  # the others have levels
    curve = found["curves"]["sliding_mode"]
    assert curve["false_alarm_share"] == [pytest.approx(0.2), pytest.approx(0.1)]
    assert curve["detection_probability"] == [1.0, 0.5]
    usual, swept = found["points"]["supervised"]
    assert swept == {"level": 4.5, "false_alarm_share": pytest.approx(0.01), "detection_probability": 0.5}
    assert usual["detection_probability"] == 1.0  # of the flights that the levels have


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
    both = pl.concat(
        [frame_of({}, MISSED), frame_of({}, MISSED, variant="threshold")], how="diagonal_relaxed"
    )
    manifest = {"seed": 1}
    return {
        "mems": setting_results("mems", both, None, manifest),
        **{name: quiet_results(name, both, manifest) for name in QUIET},
    }


def test_campaigns_become_tables_and_figures_the_same_each_time(tmp_path: Path):
    both = pl.concat(
        [frame_of({}, MISSED), frame_of({}, MISSED, variant="threshold")], how="diagonal_relaxed"
    )
    for name, frame in {"mems": both, "outliers": both}.items():
        directory = tmp_path / f"study_diagnosis_{name}"
        directory.mkdir()
        frame.write_parquet(directory / "flights.parquet")
        (directory / "campaign.json").write_text('{"seed": 1}')
    made, drawers = make(tmp_path)
    names = ("flown", "mems", "outliers")
    assert set(made) == set(names)
    page = tmp_path / "diagnosis.md"
    page.write_text("".join(f"<!-- table: {name} -->\n<!-- end -->\n" for name in names))
    files = publish(page, made, drawers)
    assert [file.suffix for file in files] == [".md", *[".png"] * 2]
    contents = [file.read_bytes() for file in files]
    assert all(content.startswith(b"\x89PNG") for content in contents[1:])
    assert b"| missed (declared before the onset) | 0 (0) | 1 (0) | 1 (0) |" in contents[0]
    publish(page, *make(tmp_path))
    assert [file.read_bytes() for file in files] == contents


def test_directory_without_campaigns_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="holds no campaign of this study"):
        make(tmp_path)


def test_document_of_the_repository_has_a_place_for_every_table():
    text = (ROOT / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    assert with_tables(text, {}, "docs/diagnosis.md") == text
    for name in {*TITLES, *tables(results())}:
        assert text.count(f"<!-- table: {name} -->") == 1


@pytest.mark.parametrize("name", [*TITLES, *QUIET, "mems_levels"])
def test_campaigns_of_the_study_load_with_every_observer(name: str, tmp_path: Path):
    (tmp_path / "still").mkdir()
    (tmp_path / "still" / "metadata.yaml").touch()
    campaign = load_campaign(ROOT / "campaigns" / f"study_diagnosis_{name}.yaml", recordings=tmp_path)
    names = {variant.name for variant in campaign.variants}
    if name in CRITERIA or name in QUIET:
        assert {"sliding_mode", "augmented_kalman", "edwards_spurgeon", "threshold", "supervised"} <= names
        assert "none" not in names
    for variant in campaign.variants:
        scenario = flight_scenario(campaign, 0, variant)
        assert variant.parameters == () or "@" in variant.name  # every observer has its defaults
        axes = [fault.axes for fault in scenario.faults[:3]]
        assert axes == ([] if "healthy" in name else [("roll",), ("pitch",), ("yaw",)])


def test_operating_point_counts_what_is_found_in_time_and_time_of_false_alarms():
    state = np.full((300, 3), TRUSTED, np.uint8)  # 30 s at 10 Hz
    fault = np.zeros((300, 3))
    fault[100:200, 0] = 0.02
    known = {"fault": fault, "fault_estimate": np.zeros((300, 3)), "fault_state": state}
    flight = dataclasses.replace(unknown_flight(np.arange(1, 301) * 100_000_000), **known)
    roll = FaultEvent("roll", "step", 10.0, 20.0)
    missed = [diagnosis_metrics(flight, [roll])]
    state[115:200, 0] = FAULTY  # 1.5 s after the onset
    state[0:30, 1] = FAULTY  # 3 s of healthy time
    late = [diagnosis_metrics(flight, [roll])]
    healthy = 90.0 - 10.0 - GRACE_TIME
    assert operating_point(late, within=1.5) == pytest.approx((3.0 / healthy, 1.0))
    assert operating_point(late, within=1.4) == pytest.approx((3.0 / healthy, 0.0))
    assert operating_point(late + missed, within=2.0) == pytest.approx((1.5 / healthy, 0.5))
    state[50:115, 0] = FAULTY  # before the onset already
    assert operating_point([diagnosis_metrics(flight, [roll])], within=2.0).detection_probability == 0.0
    assert operating_point([], within=1.0) == (None, None)
