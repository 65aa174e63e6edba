"""The page on a verdict: the cause and its picture first, then what happened and what was judged."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from quadftc_replay.flight_log import Event, FlightLog, Signal
from quadftc_replay.inspection.found import Found, make_finding
from quadftc_replay.inspection.inspect import Inspection, inspect
from quadftc_report.verdict_page import figures_of, render_verdict

TIME = np.arange(0.0, 20.0, 0.004)


def flight(name: str = "log", offsets: dict[int, float] | None = None, **others) -> Inspection:
    """A gyro that reads offsets about some axes from 10 s on."""
    rates = 0.01 * np.random.default_rng(0).standard_normal((len(TIME), 3))
    for axis, offset in (offsets or {}).items():
        rates[2500:, axis] += offset
    thrust = Signal(TIME, np.ones((len(TIME), 1)))
    signals = {"gyros": {"": Signal(TIME, rates)}, "thrust_command": thrust, **others}
    return inspect(FlightLog(path=Path(name), format="test", **signals))


def specs(text: str) -> dict[str, dict]:
    found = re.findall(r'<script type="application/json" id="spec-([\w-]+)">(.*?)</script>', text, re.DOTALL)
    return {name: json.loads(spec) for name, spec in found}


def test_cause_and_its_picture_come_before_any_table():
    text = render_verdict(flight(offsets={1: 0.5}))
    places = [text.index(each) for each in ("<h1", 'id="plot-finding-1"', "<table", 'id="plot-gyro"')]
    assert places == sorted(places)
    assert re.search(r"✗ fault</span>", text)
    assert re.search(r'<h1 class="verdict fault">Gyro y has an offset of', text)
    assert re.search(r"gyro y: offset from 10\.0\d s", text)
    assert re.search(r"From 10\.0\d s; size 0\.\d+ rad/s ± [\d.]+ rad/s \(1 σ\); probability \d", text)


def test_picture_has_a_unit_one_legend_entry_a_line_and_the_onset():
    spec = specs(render_verdict(flight(offsets={1: 0.5})))["finding-1"]
    assert spec["layout"]["yaxis"]["title"]["text"].endswith("[rad/s]")
    assert spec["layout"]["xaxis"]["title"]["text"] == "time [s]"
    onset = next(each for each in spec["layout"]["shapes"] if each["name"].startswith("onset"))
    assert abs(onset["x0"] - 10.0) < 0.05
    for each in specs(render_verdict(flight())).values():
        names = [trace["name"] for trace in each["data"]]
        assert len(names) == len(set(names)), "a name stands for one line of a plot"


def test_second_finding_has_a_figure_of_its_own():
    inspection = flight(offsets={0: 0.5, 1: 0.5})
    text = render_verdict(inspection)
    assert len(inspection.found) == 2
    assert text.index('id="plot-finding-1"') < text.index("Also found") < text.index('id="plot-finding-2"')


def test_finding_without_a_curve_is_shown_on_the_signal_of_its_component():
    inspection = flight(offsets={1: 0.5})
    bare = inspection._replace(found=tuple(each._replace(curve=None) for each in inspection.found))
    [first, *_], _ = figures_of(bare)
    assert first.panels[0].title == "body rate"
    assert first.panels[0].marks[0].time == inspection.found[0].finding.onset_s


def test_second_sensor_without_a_curve_is_drawn_itself():
    rates = np.zeros((len(TIME), 3))
    gyros = {"": Signal(TIME, rates + 1.0), "1": Signal(TIME, rates)}
    inspection = flight(gyros=gyros)
    finding = make_finding("gyro 1", "", "absent", 5.0)
    verdict = inspection.verdict.model_copy(update={"findings": (finding,)})
    [first, *_], _ = figures_of(inspection._replace(verdict=verdict, found=(Found(finding),)))
    assert first.panels[0].title == "body rate 1"
    assert not first.panels[0].traces[0].y.any()


def test_messages_before_the_cause_are_folded():
    events = (Event(1.0, "MSG", "early one"), Event(12.0, "MSG", "late one"))
    text = render_verdict(flight(offsets={1: 0.5}, events=events))
    folded = text[text.index("<details>") : text.index("</details>")]
    assert "1 message of the autopilot before the first cause" in folded
    assert "early one" in folded
    assert "late one" in text[text.index("</details>") :]


def test_page_of_a_log_that_lacks_much_is_escaped_and_says_what_is_missing():
    text = render_verdict(flight("<b>log"))
    assert "&lt;b&gt;log" in text
    assert "<b>log" not in text
    assert '<h1 class="verdict unsure">' in text
    assert "? not enough to say" in text
    assert re.search(r"<h1.*battery \(no voltage is logged\)", text)
    assert text.count("no voltage is logged") == 1, "a reason is given once"
    assert re.search(r'class="open".*\n.*\?</span>not judged</td>', text)
    assert text.index("not judged</td>") < text.index("no fault found</td>"), "what is open comes first"


def test_component_that_may_be_at_fault_instead_is_not_called_sound():
    inspection = flight()
    finding = make_finding("response", "roll", "reversed", 2.0, ambiguous_with=("gyro/x", "rotor/1"))
    verdict = inspection.verdict.model_copy(update={"findings": (finding,)})
    text = render_verdict(inspection._replace(verdict=verdict, found=(Found(finding),)))
    assert re.search(r">gyro</th>.*\n.*\?</span>may be at fault instead of response roll</td>", text)
    assert "; or gyro x or rotor 1" in text
    assert "fault instead" not in render_verdict(flight())


def test_log_without_a_signal_to_draw_has_a_page():
    log = FlightLog(path=Path("log"), format="test", thrust_command=Signal(TIME, np.ones((len(TIME), 1))))
    assert "nothing logged" in render_verdict(inspect(log))
