"""The page on a verdict: the sentence first, a picture, all components, the evidence; text is escaped."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.inspect import inspect
from quadftc_report.verdict_page import write_page


def write(directory: Path, offset: float = 0.0, name: str = "log") -> str:
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 20.0, 0.004)
    rates = 0.01 * rng.standard_normal((len(time), 3))
    rates[2500:, 1] += offset
    log = FlightLog(
        path=Path(name),
        format="test",
        gyros={"": Signal(time, rates)},
        thrust_command=Signal(time, np.ones((len(time), 1))),
    )
    return write_page(inspect(log), directory).read_text(encoding="utf-8")


def test_page_of_a_finding_has_sentence_timeline_and_evidence(tmp_path: Path):
    text = write(tmp_path, 0.5)
    assert text.index('class="verdict"') < text.index('id="plot-picture"') < text.index('id="plot-timeline"')
    assert "Gyro y has an offset of" in text
    assert 'id="finding-1"' in text
    specs = re.findall(r'<script type="application/json" id="spec-([\w-]+)">(.*?)</script>', text, re.DOTALL)
    assert {name for name, _ in specs} == {"picture", "timeline", "signals"}
    timeline = json.loads(dict(specs)["timeline"])
    assert {"judged", "not judged", "fault"} == {trace["name"] for trace in timeline["data"]}


def test_page_of_a_log_that_lacks_much_is_escaped_and_says_what_is_missing(tmp_path: Path):
    text = write(tmp_path, name="<b>log")
    assert "&lt;b&gt;log" in text
    assert "<b>log" not in text
    assert "verdict unsure" in text
    assert "no voltage is logged" in text
