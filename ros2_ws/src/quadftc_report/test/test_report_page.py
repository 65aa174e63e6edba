"""The page of a report: whole, escaped, each number where it belongs, and nothing from elsewhere."""

import dataclasses
import functools
import json
from html.parser import HTMLParser

import numpy as np
import pytest
from recorded_runs import recorded_run

from quadftc_flight.run_directory import MissingPartError, RecordedRun
from quadftc_flight.scenario import node_parameters, parse_scenario
from quadftc_flight.summary import summary
from quadftc_report import report as report_module
from quadftc_report.comparison import compare
from quadftc_report.page import flight_sections, render
from quadftc_report.report import ReportError, write_report

TEXT = """
name: small
description: "faults & </script><script>alert(1)</script> <b>trouble</b>"
duration: 2 s
rate: 100 Hz
seed: 5
vehicle: qball_x4
references: [{kind: step, angles: [5 deg, 0, 10 deg], rise: 1}]
disturbances: [{kind: constant, amplitude: [0.1, 0, 0], start: 0.5}]
faults: [{kind: bias, axes: roll, value: 1 deg, start: 1, stop: 1.5}]
schemes:
  proposed:
    {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc,
     checks: [
       {metric: tracking_rmse_deg, below: 5},
       {metric: fault_windows.0.tracking_mean_deg, axis: yaw, above: 9}]}
  conventional: {observer: none, controller: smc}
"""
REAL = ("name=rough", "sensors={gyro_bias: 1 deg/s}")
VOID = {"meta", "link", "br", "img", "input", "wbr"}


@functools.cache
def flown(scheme: str, *overrides: str) -> RecordedRun:
    """A run as if read from a bag."""
    scenario = parse_scenario(TEXT, overrides=overrides)
    parameters = {node: dict(values) for node, values in node_parameters(scenario, scheme).items()}
    versions = {"quadftc": "1.2.3", "commit": "abcdef"}
    return recorded_run(scenario, scheme, parameters=parameters, versions=versions)


class Page(HTMLParser):
    """The elements of a page, with their attributes and the text inside."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None], list[str]]] = []
        self.open: list[tuple[str, list[str]]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs), []))
        if tag not in VOID:
            self.open.append((tag, self.elements[-1][2]))

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag
        if tag in ("td", "th"):
            self.handle_data(" ")

    def handle_data(self, data):
        for _, words in self.open:
            words.append(data)

    def find(self, name: str, attribute: str = ""):
        """Attributes and text of every element of a name that has an attribute."""
        return [
            (attributes, " ".join("".join(words).split()))
            for tag, attributes, words in self.elements
            if tag == name and (not attribute or attribute in attributes)
        ]


def page_of(*runs: RecordedRun, warnings=(), folder: str | None = "report_figures") -> Page:
    return Page(render(flight_sections(compare(runs)), warnings, [], folder))


@pytest.fixture(scope="module")
def page() -> Page:
    """Both schemes on ideal sensors, and one on a gyro with bias."""
    return page_of(flown("conventional"), flown("proposed", *REAL), flown("proposed"), warnings=["a <b> c"])


def test_every_element_is_closed_and_every_link_leads_somewhere(page):
    assert page.open == []
    ids = [attributes["id"] for _, attributes, _ in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    links = [attributes["href"] for attributes, _ in page.find("a", "href")]
    named = [
        attributes["aria-labelledby"] for _, attributes, _ in page.elements if "aria-labelledby" in attributes
    ]
    assert len(links) > 20
    assert {link[1:] for link in links if link.startswith("#")} | set(named) <= set(ids)
    assert {link.split("/")[0] for link in links if not link.startswith("#")} == {"report_figures"}


def test_page_names_no_other_place_to_load_from(page):
    loading = [
        (tag, name, value)
        for tag, attributes, _ in page.elements
        for name, value in attributes.items()
        if name in ("src", "srcset", "data", "action") or (tag == "link" and name == "href")
    ]
    assert loading == [("link", "href", "data:,")]
    assert "@import" not in " ".join(text for _, text in page.find("style"))


def test_markup_in_scenario_and_warnings_is_text(page):
    (lead, _) = [text for attributes, text in page.find("p", "class") if attributes["class"] == "lead"]
    assert "</script><script>alert(1)</script> <b>trouble</b>" in lead
    assert page.find("b") == []
    assert "a <b> c" in [text for _, text in page.find("li")]
    scripts = [text for _, text in page.find("script")]
    assert not any(text == "alert(1)" for text in scripts)


def test_every_metric_is_on_the_page_with_its_full_value(page):
    shown = {
        (attributes["data-run"], attributes["data-metric"], attributes["data-axis"]): attributes["data-value"]
        for attributes, _ in page.find("td", "data-metric")
    }
    metrics = flown("conventional").summary["metrics"]
    for axis, value in metrics["tracking_rmse_deg"].items():
        assert shown["small-conventional", "tracking_rmse_deg", axis] == repr(value)
    window = metrics["fault_windows"][0]["fault_estimate_settling_s"]
    assert window["roll"] is None
    assert shown["small-conventional", "fault_windows.0.fault_estimate_settling_s", "roll"] == ""
    tilt = flown("proposed", *REAL).summary["metrics"]["max_tilt_deg"]
    assert shown["rough-proposed", "max_tilt_deg", ""] == repr(tilt)


def test_best_of_a_row_is_marked_and_the_change_is_told(page):
    best = [
        attributes["data-run"]
        for attributes, _ in page.find("td", "data-metric")
        if attributes["data-metric"] == "tracking_rmse_deg" and "best" in attributes["class"]
    ]
    assert best == ["small-proposed"] * 3
    texts = [
        text
        for attributes, text in page.find("td", "data-metric")
        if attributes["data-run"] == "small-proposed"
        and attributes["data-metric"] == "tracking_rmse_deg"
        and attributes["data-axis"] == "roll"
    ]
    assert any("(best)" in text and text.endswith("%") for text in texts)


def test_checks_say_passed_and_failed(page):
    rows = [text for _, text in page.find("tr") if text.endswith(("passed", "FAILED"))]
    assert sum(row.endswith("✓ passed") for row in rows) == 6
    assert sum("tracking_mean_deg yaw" in row and row.endswith("✗ FAILED") for row in rows) == 2


def test_own_scenarios_stand_neither_with_the_papers_nor_with_these_on_real_sensors(page):
    assert [text for _, text in page.find("h2")] == ["Summary", "Flights"]
    assert [text for _, text in page.find("h3")] == ["small", "rough"]


def test_papers_scenarios_come_first_and_those_on_real_sensors_after_them():
    names = ("small", "mems_faults", "paper_faults")
    noisy = [
        flown("proposed", f"name={name}", *(REAL[1:] if name == "mems_faults" else ())) for name in names
    ]
    found = page_of(*noisy)
    titles = [text for _, text in found.find("h2")]
    assert titles == [
        "Summary",
        "In the paper's conditions",
        "What the paper does not say",
        "Other scenarios",
    ]
    assert [text for _, text in found.find("h3")] == ["paper_faults", "mems_faults", "small"]


def test_claims_that_cannot_be_judged_are_one_line_for_each_reason():
    found = page_of(flown("proposed", "name=paper_faults"))
    (line,) = [text for _, text in found.find("li") if "claims: the " in text]
    assert "6 of 6 claims: the faults are not where the paper has them" in line


def test_every_figure_brings_what_it_is_drawn_from(page):
    plots = page.find("div", "data-figure")
    specs = {
        attributes["id"]: json.loads(text)
        for attributes, text in page.find("script", "type")
        if attributes["type"] == "application/json"
    }
    assert len(plots) == len(specs) == 19  # and the picture at the top
    for attributes, _ in plots:
        assert specs[attributes["data-figure"]]["data"], attributes["id"]


def test_page_begins_with_a_verdict_on_each_scenario_and_one_picture(page):
    verdicts = [
        (each["class"], text) for each, text in page.find("li", "class") if "verdict" in each["class"]
    ]
    assert [look for look, _ in verdicts] == ["verdict", "verdict"]  # a check fails in each
    assert verdicts[0][1].startswith("small: proposed estimates 1 fault within ")
    assert "; without diagnosis " in verdicts[0][1]
    assert "without" not in verdicts[1][1]
    ids = [attributes["id"] for _, attributes, _ in page.elements if "id" in attributes]
    assert ids.index("picture") < ids.index("summary")


def test_scenario_parameters_versions_and_seed_are_told(page):
    (pre, _) = [text for _, text in page.find("pre")]
    assert "kind: bias" in pre
    facts = [text for _, text in page.find("tr")]
    for fact in ("seed 5", "quadftc 1.2.3", "commit abcdef", "observer sliding_mode none", "rate 100.0"):
        assert fact in facts, fact


def test_page_of_a_run_cut_short_says_so_and_judges_nothing():
    run = flown("proposed")
    flight = run.flight.first(120)
    unchecked = run.scheme.model_copy(update={"checks": ()})
    item = {**summary(flight, run.scenario, unchecked, None), "passed": None}
    cut = dataclasses.replace(run, flight=flight, summary=item, warnings=("runs/small: cut short at 1.19 s",))
    found = page_of(cut, warnings=cut.warnings)
    assert np.any(["cut short at 1.19 s" in text for _, text in found.find("li")])
    assert any("1.2 of 2" in text for _, text in found.find("tr"))
    assert [text for _, text in found.find("td") if text.endswith(("passed", "FAILED"))] == []


@pytest.mark.parametrize(
    ("out", "words"),
    [
        (".", "is a directory"),
        ("report.pdf", "ends in .html"),
        ("file/report.html", "is not a directory"),
        ("taken.html", "is in the way"),
    ],
)
def test_place_that_will_not_do_is_refused_before_anything_is_read(tmp_path, out, words):
    (tmp_path / "file").touch()
    (tmp_path / "taken_figures").touch()
    with pytest.raises(ReportError, match=words):
        write_report([tmp_path / "no_such_run"], tmp_path / out)


def test_run_whose_component_is_not_installed_does_not_spoil_the_others(tmp_path, monkeypatch):
    def read(path):
        if path.name == "foreign":
            raise MissingPartError("foreign: no fault observer 'psychic'")
        return flown("proposed")

    monkeypatch.setattr(report_module, "read_bag", lambda path: path)
    for name in ("is_replay", "is_live"):
        monkeypatch.setattr(report_module, name, lambda bag: False)
    monkeypatch.setattr(report_module, "run_from_bag", read)
    runs = [tmp_path / name for name in ("own", "foreign")]
    read_runs, _, left_out = report_module._read_all(runs, lambda _what, _share: None)
    assert len(read_runs) == 1
    assert left_out == ["left out: foreign: no fault observer 'psychic'"]
    with pytest.raises(MissingPartError):
        report_module._read_all(runs[1:], lambda _what, _share: None)
