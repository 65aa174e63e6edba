"""The report in a real browser: it draws every figure, links their time axes, fits, and loads nothing."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from browser import start_browser

from quadftc_flight.metrics import look_up
from quadftc_flight.scenario import parse_scenario
from quadftc_report.report import write_report

CALM = """
name: calm
description: Ideal sensors, and two seconds of <script>document.title = 'broken out of'</script> trouble
duration: 2 s
rate: 250 Hz
vehicle: qball_x4
sensors: {grade: ideal}
references: [{kind: step, angles: [5 deg, -4 deg, 10 deg], start: 0.2 s, rise: 0.5 s}]
disturbances: [{kind: constant, amplitude: 0.02 N m, start: 0.3 s}]
faults:
  - {kind: bias, axes: roll, value: 1 deg, start: 0.5 s, stop: 1.5 s}
  - {kind: sine, axes: [pitch, yaw], amplitude: 2 deg, frequency: 5.0, start: 0.5 s, stop: 1.5 s}
schemes:
  proposed: {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc}
  conventional: {observer: none, disturbance_observer: none, controller: smc}
"""
FIGURES = 9  # of each scenario
ALL = 2 * FIGURES + 8 + 1  # with those of the replay, and the key picture
PATIENCE = 60.0  # s
WIDE, NARROW = 1280, 400  # px
DRAWN = "return document.documentElement.dataset.figures === 'drawn'"
RANGES = """
return Object.fromEntries([...document.querySelectorAll(".plot")].map(
  plot => [plot.id, [plot.dataset.scenario, plot.layout.xaxis.range.map(Number)]]))
"""


@pytest.fixture(scope="module")
def runs(fly_graph, busy_scenario, replay_run) -> dict[str, Path]:
    """Two scenarios, each flown with both schemes for two seconds, and a replay: name to directory."""
    scenarios = (parse_scenario(CALM), busy_scenario)
    flown = [fly_graph(each, scheme)[0] for each in scenarios for scheme in each.schemes]
    replay = replay_run(flown[0], "bias axis=pitch value=5deg start=0.5s stop=1.5s", observer="supervised")
    return {directory.name: directory for directory in (*flown, replay)}


@pytest.fixture(scope="module")
def page(runs, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("report") / "report.html"
    return write_report(list(runs.values()), out).page


@pytest.fixture(scope="module")
def browser():
    with start_browser("THE REPORT") as started:
        yield started


@pytest.fixture(scope="module")
def opened(browser, page):
    """The page in a wide window, with every figure drawn; tests that open it anew come last."""
    return open_page(browser, page, WIDE)


def open_page(browser, page: Path, width: int):
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width == NARROW}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    for kind in ("browser", "performance"):
        browser.get_log(kind)  # forget what was before
    browser.get(page.as_uri())
    wait_for(browser, DRAWN)
    return browser


def wait_for(browser, script: str) -> None:
    from selenium.webdriver.support.wait import WebDriverWait

    WebDriverWait(browser, PATIENCE).until(lambda _: browser.execute_script(script), script)


def test_every_line_of_every_figure_is_drawn_without_an_error(opened):
    found = opened.execute_script("""
        return [...document.querySelectorAll(".plot")].map(plot => [
          plot.id,
          JSON.parse(document.getElementById(plot.dataset.figure).textContent).data.length,
          [...plot.querySelectorAll("[class^=scatterlayer] .trace")]
            .filter(trace => [...trace.querySelectorAll("path")].some(line => line.getAttribute("d"))).length,
        ])
    """)
    assert len(found) == ALL
    assert [(name, wanted, there) for name, wanted, there in found if not 0 < wanted == there] == []
    assert opened.get_log("browser") == []


def test_zoom_of_a_figure_zooms_all_of_its_scenario_and_no_other(opened):
    first = opened.execute_script("return document.querySelectorAll('.plot')[1].id")  # behind the key one
    before = opened.execute_script(RANGES)
    opened.execute_script(
        "document.documentElement.dataset.figures = 'waiting';"
        "Plotly.relayout(arguments[0], {'xaxis.range[0]': 0.5, 'xaxis.range[1]': 1.25})",
        first,
    )
    wait_for(opened, DRAWN)
    after = opened.execute_script(RANGES)
    scenario = before[first][0]
    assert sum(place[0] == scenario for place in before.values()) == FIGURES
    for name, (where, span) in after.items():
        assert span == ([0.5, 1.25] if where == scenario else before[name][1]), name


def test_metrics_on_the_page_equal_the_summaries(opened, runs):
    summaries = {
        name: json.loads((directory / "summary.json").read_text(encoding="utf-8"))
        for name, directory in runs.items()
    }
    cells = opened.execute_script("""
        return [...document.querySelectorAll("[data-metric]")].map(
          ({ dataset, firstChild }) =>
            [dataset.run, dataset.metric, dataset.axis, dataset.value, firstChild.data])
    """)
    for run, metric, axis, written, text in cells:
        value = look_up(summaries[run]["metrics"], f"{metric}.{axis}" if axis else metric)
        assert written == ("" if value is None else repr(float(value))), (run, metric, axis)
        assert value is None or text.strip(), (run, metric, axis)
    shown = {(run, f"{metric}.{axis}" if axis else metric) for run, metric, axis, *_ in cells}
    wanted = {(run, path) for run, item in summaries.items() for path in numbers(item["metrics"])}
    assert wanted <= shown
    assert len(wanted) > 200


def numbers(metrics, prefix=""):
    """Dotted paths of all numbers, without the bounds of the fault windows and the table of sensors."""
    items = enumerate(metrics) if isinstance(metrics, list) else metrics.items()
    for name, value in items:
        if isinstance(value, (dict, list)):
            if name == "confusion_s":  # a table of its own
                continue
            yield from numbers(value, f"{prefix}{name}.")
        elif isinstance(value, float) and name not in ("start", "stop"):
            assert math.isfinite(value)
            yield f"{prefix}{name}"


def test_page_loads_nothing_but_itself(opened, page):
    messages = [json.loads(entry["message"])["message"] for entry in opened.get_log("performance")]
    asked = [
        message["params"]["request"]["url"]
        for message in messages
        if message["method"] == "Network.requestWillBeSent"
    ]
    assert page.as_uri() in asked
    assert [url for url in asked if url != page.as_uri() and not url.startswith(("data:", "blob:"))] == []


def test_markup_in_a_scenario_is_shown_and_not_run(opened):
    assert opened.title == "quadftc report: calm, busy, replay-calm-proposed"
    lead = opened.execute_script("return document.querySelector('#calm .lead').textContent")
    assert "<script>document.title = 'broken out of'</script>" in lead


def test_page_fits_a_narrow_screen(browser, page):
    narrow = open_page(browser, page, NARROW)
    assert narrow.execute_script("return document.documentElement.scrollWidth") == NARROW
    sizes = narrow.execute_script("""
        return [...document.querySelectorAll(".plot .main-svg")].map(svg => svg.getBoundingClientRect().right)
    """)
    assert len(sizes) >= ALL
    assert max(sizes) <= NARROW


def test_printed_page_shows_every_figure_and_every_folded_part(browser, page):
    """Asked to print before it has drawn: nothing is missing."""
    browser.get(page.as_uri())
    browser.execute_script("dispatchEvent(new Event('beforeprint'))")
    for missing in (".plot:not(.js-plotly-plot)", "details:not([open])"):
        assert browser.execute_script("return document.querySelectorAll(arguments[0]).length", missing) == 0
