"""False alarms: the stored flights belong to today's judge, and what the tables count."""

from __future__ import annotations

import json

import pytest
from sampling import sampled

from quadftc_replay.calibration import FLIGHTS
from quadftc_replay.inspection.found import make_finding
from quadftc_tools.study.false_alarms import Judged, Truth, judge_seed, named_table, reliability_table
from quadftc_tools.study.numbers import poisson_interval, share_interval

STORED = json.loads(FLIGHTS.read_text())
ROUNDING = 0.01  # of a probability; another compiler rounds otherwise


@pytest.mark.parametrize(
    "stored", sampled(STORED["again"], every=4), ids=lambda each: f"{each['autopilot']}-{each['seed']}"
)
def test_stored_flights_belong_to_this_judge(stored):
    (judged,) = judge_seed(stored["seed"], stored["is_faulty"], [stored["autopilot"]])
    assert judged.score == pytest.approx(stored["score"], abs=ROUNDING), (
        "the judge has changed: store its flights anew by quadftc_tools.study.false_alarms --write"
    )


def test_some_stored_flights_have_findings():
    scores = [each["score"] for each in STORED["again"]]
    assert sum(score > 0.5 for score in scores) >= 4


def test_exact_intervals():
    assert poisson_interval(0) == (0.0, pytest.approx(3.689, abs=1e-3))
    assert poisson_interval(10) == (pytest.approx(4.795, abs=1e-3), pytest.approx(18.39, abs=1e-2))
    assert share_interval(0, 10) == (0.0, pytest.approx(0.3085, abs=1e-4))
    assert share_interval(10, 10) == (pytest.approx(0.6915, abs=1e-4), 1.0)
    assert share_interval(5, 10) == (pytest.approx(0.1871, abs=1e-4), pytest.approx(0.8129, abs=1e-4))


class Said:
    """A verdict with nothing but findings."""

    def __init__(self, *findings):
        self.findings = findings


def test_a_finding_is_true_if_component_element_and_onset_are():
    truth = Truth("rotor", "2", 10.0, 1.0)
    right = make_finding("rotor", "2", "off", 10.4, probability=0.97)
    late = make_finding("rotor", "2", "off", 11.5, probability=0.96)
    other = make_finding("gyro", "x", "offset", 10.0, probability=1.0)
    judged = [
        Judged(1, "x500", "px4", truth, Said(right, late)),
        Judged(2, "x500", "px4", None, Said(right, other)),
    ]
    assert judged[1].score == 1.0
    rows = [line.split(" | ")[:3] for line in reliability_table(judged).splitlines()[2:]]
    assert rows == [["| 0.95 to 0.99", "3", "1"], ["| 0.99 to 1", "1", "0"]]


def test_a_fault_is_named_if_the_first_finding_is_true():
    truth = Truth("gyro", "x", 10.0, -0.2)
    told = make_finding("gyro", "x", "offset", 10.05, probability=0.97, size=-0.23, sigma=0.02)
    large = make_finding("gyro", "x", "offset", 10.0, probability=0.97, size=0.2, sigma=0.02)
    other = make_finding("gyro", "y", "offset", 10.0, probability=0.97)
    verdicts = [Said(told, other), Said(large), Said(other, told), Said()]
    judged = [Judged(1, "x500", "px4", truth, each) for each in verdicts]
    (row,) = (line.split(" | ") for line in named_table(judged).splitlines()[2:])
    assert row[:4] == ["| simulated PX4", "gyro", "4", "2"]
    assert row[5:] == ["0.03/0.05 s", "1 |"]  # of the sizes one has the wrong sign
