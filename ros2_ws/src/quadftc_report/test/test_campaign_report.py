"""The report of a campaign: numbers as worked out by hand, a page that is whole, whatever is missing."""

import json
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from quadftc_campaign.campaign_file import load_campaign
from quadftc_campaign.table import summary_of, table_of
from quadftc_model.samples import AXES
from quadftc_report.campaign_page import POINTS, ecdf
from quadftc_report.report import ReportError, write_campaign_report

SCENARIO = """
name: small
duration: 2 s
rate: 100 Hz
vehicle: qball_x4
references: [{kind: step, angles: [5 deg, 0, 10 deg], rise: 1}]
faults: [{kind: bias, axes: roll, value: 1 deg, start: 1, stop: 1.5}]
schemes:
  watched: {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc}
  plain: {observer: none, controller: smc}
"""
VALUE, RATE = "faults.0.value", "rate"
VARY = f"vary: {{{VALUE}: {{uniform: [1 deg, 5 deg]}}, {RATE}: {{grid: [100 Hz, 50 Hz]}}}}"
BOTH = "schemes: [watched, plain]"
PER_AXIS = ("tracking_rmse_deg", "fault_estimate_rmse_deg", "torque_total_variation", "saturation_share")
VOID = {"meta", "link", "wbr"}


@pytest.fixture
def load(tmp_path):
    """Load a campaign whose file holds some lines."""

    def made(*lines, flights=12):
        (tmp_path / "small.yaml").write_text(SCENARIO)
        file = tmp_path / "camp.yaml"
        file.write_text("\n".join(["scenario: small.yaml", f"flights: {flights}", *lines]))
        return load_campaign(file)

    return made


def row(flight, variant, observer, **values):
    """A row as the campaign writes it; all numbers of a kind are alike where a test does not say more."""
    found = {"flight": flight, "variant": variant, "observer": observer, "controller": "any", "seed": flight}
    found |= {f"{name}.{axis}": 0.5 for name in PER_AXIS for axis in AXES}
    found |= {f"healthy_time_s.{axis}": 3600.0 for axis in AXES}
    found |= {f"false_alarms.{axis}": 0.0 for axis in AXES}
    return found | {"finite": True, "fault": None} | values


def fault(kind="step", **values):
    """The columns of a fault."""
    found = {"axis": "roll", "kind": kind, "start": 1.0, "stop": 1.5, "detected": True}
    found |= {"detection_delay_s": 0.1, "estimate_rmse_deg": 0.2}
    found |= {"already_declared": False, "tracking_rmse_deg": 0.3}
    return {"fault": 0, **{f"fault.{name}": value for name, value in (found | values).items()}}


def flown(count=12):
    """Flights of two variants: one that finds every fault, one without an observer."""
    rows = []
    for flight in range(count):
        drawn = {VALUE: 1.0 + 4.0 * flight / count, RATE: (100.0, 50.0)[flight % 2]}
        error = 0.1 * (flight + 1)
        rows.append(row(flight, "watched", "sliding_mode", **drawn, **fault(estimate_rmse_deg=error)))
        missed = fault(detected=False, detection_delay_s=None, estimate_rmse_deg=3.0)
        rows.append(row(flight, "plain", "none", **drawn, **missed, **{"tracking_rmse_deg.yaw": 2.0}))
    return rows


def written(campaign, rows, directory):
    frame = table_of(rows)
    if "fault.detected" in frame.columns:
        frame = frame.with_columns(pl.col("fault.detected").cast(pl.Boolean))
    path = write_campaign_report(campaign, frame, summary_of(campaign, frame), directory, "my camp.yaml")
    text = path.read_text(encoding="utf-8")
    return text, Page(text)


class Page(HTMLParser):
    """The text of a page, its figures, its commands; every element must be closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.texts, self.specs, self.commands = [], [], {}, []
        self.feed(text)
        self.close()
        assert self.open == []

    @property
    def text(self):
        return " ".join(" ".join(self.texts).split())

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        tag, attrs = self.open[-1] if self.open else ("", {})
        if attrs.get("type") == "application/json":
            self.specs[attrs["id"]] = json.loads(data)
        elif tag not in ("script", "style"):
            self.texts.append(data)
        if tag == "code" and data.startswith("scripts/"):
            self.commands.append(data)


def test_distribution_counts_what_has_no_value_and_leaves_out_what_is_unknown():
    found = ecdf(np.array([3.0, np.inf, 1.0, np.nan, 2.0]))
    assert found.values.tolist() == [1.0, 2.0, 3.0]
    assert found.shares.tolist() == [0.25, 0.5, 0.75]
    assert found.total == 4


def test_distribution_of_many_values_keeps_few_points_and_both_ends():
    values = np.random.default_rng(1).permutation(100_000) + 1.0
    found = ecdf(values)
    assert len(found.values) <= POINTS
    assert (found.values[0], found.values[-1]) == (1.0, 100_000.0)
    np.testing.assert_allclose(found.shares, found.values / 100_000, atol=1e-12)


def test_an_axis_that_is_declared_before_the_onset_has_not_found_the_fault(load, tmp_path):
    early = [fault(already_declared=True, detection_delay_s=None)] * 2 + [fault()] * 4
    rows = [row(flight, "watched", "sliding_mode", **each) for flight, each in enumerate(early)]
    _, page = written(load(VARY, flights=6), rows, tmp_path)
    assert "finds 4 of 6 faults, the median after 100 ms, 2 declared before their onset" in page.text


def test_page_tells_every_variant_and_how_to_fly_the_worst_again(load, tmp_path):
    text, page = written(load(BOTH, VARY, flights=24), flown(24), tmp_path)
    assert "finds 24 of 24 faults, the median after 100 ms, 0 false alarms an hour." in page.text
    assert "a median RMSE of 2 deg, 95 % 2 deg; has no fault observer." in page.text
    names = {trace["name"] for trace in page.specs["spec-ecdf-tracking"]["data"]}
    assert names == {"watched", "plain"}
    assert {"spec-ecdf-estimate", "spec-ecdf-delay"} <= set(page.specs)
    again = f"scripts/quadftc campaign 'my camp.yaml' --out {tmp_path} --flight 23 --variant watched"
    assert again in page.commands
    assert "24 flights of each variant" in page.text
    assert "http" not in text.partition("<script>")[0].replace("http-equiv", "")


def test_command_names_the_number_of_flights_and_the_seed_where_they_are_not_the_files(load, tmp_path):
    load(VARY, flights=3)
    campaign = load_campaign(tmp_path / "camp.yaml", flights=12, seed=5)
    assert (campaign.flights, campaign.seed) == (12, 5)
    _, page = written(campaign, [each for each in flown() if each["variant"] == "watched"], tmp_path)
    assert any("'my camp.yaml' --flights 12 --seed 5 --out" in command for command in page.commands)


@pytest.mark.parametrize("count", [1, 12])
def test_page_of_flights_without_faults_and_without_draws(load, tmp_path, count):
    rows = [row(flight, "watched", "sliding_mode") for flight in range(count)]
    _, page = written(load(flights=count), rows, tmp_path)
    assert "No flight had a sensor fault." in page.text
    assert set(page.specs) == {"spec-ecdf-tracking"}


def test_page_of_one_flight_with_a_fault_that_nothing_is_known_of(load, tmp_path):
    names = ("detected", "detection_delay_s", "estimate_rmse_deg", "tracking_rmse_deg")
    unknown = fault(**dict.fromkeys(names))
    rows = [row(0, "watched", "sliding_mode", **unknown, **{VALUE: 2.0, RATE: 100.0})]
    _, page = written(load(VARY, flights=1), rows, tmp_path)
    assert set(page.specs) == {"spec-ecdf-tracking"}


def test_flights_that_did_not_stay_finite_are_told_first(load, tmp_path):
    rows = flown()
    broken = {f"tracking_rmse_deg.{axis}": None for axis in AXES}
    rows[0] |= {"finite": False, "fault.estimate_rmse_deg": float("nan"), **broken}
    _, page = written(load(BOTH, VARY), rows, tmp_path)
    assert "'watched' (sliding_mode, any): 1 of 12 flights did NOT stay finite;" in page.text
    curve = next(each for each in page.specs["spec-ecdf-tracking"]["data"] if each["name"] == "watched")
    assert len(curve["customdata"]) == 11 + 2  # below the first, and on to the right
    assert page.commands[0].endswith("--flight 0 --variant watched")


def test_observer_that_finds_nothing_has_a_flat_curve(load, tmp_path):
    rows = [each for each in flown() if each["variant"] == "watched"]
    rows += [each | {"variant": "plain"} | fault(detected=False, detection_delay_s=None) for each in rows]
    _, page = written(load(BOTH, VARY), rows, tmp_path)
    curve = next(each for each in page.specs["spec-ecdf-delay"]["data"] if each["name"] == "plain")
    assert len(curve["customdata"]) == 2


def test_markup_in_names_and_descriptions_is_escaped(load, tmp_path):
    evil = "</script><script>alert(1)</script>"
    campaign = load(f"description: '{evil}'", f"vary: {{name: {{choice: ['{evil}', b]}}}}")
    rows = [each | {"name": evil} for each in flown() if each["variant"] == "watched"]
    text, page = written(campaign, rows, tmp_path)
    assert evil not in text
    assert evil in page.text


def test_place_that_cannot_be_written_is_an_error_of_one_line(load, tmp_path):
    with pytest.raises(ReportError, match=r"report\.html: cannot be written"):
        written(load(BOTH, VARY), flown(), Path(tmp_path, "missing"))
