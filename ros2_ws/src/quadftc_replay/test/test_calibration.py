"""A level of false alarms: what ranks promise, what is refused, and what a verdict says below a level."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadftc_replay.calibration import Calibration, find_level, level_for, load_calibrations
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import prepare
from quadftc_replay.inspection.found import CERTAIN, Found, make_finding
from quadftc_replay.inspection.verdict import Ending, Level
from quadftc_replay.inspection.wording import BELOW, REQUIRED, apply_level, make_verdict

GYRO = make_finding("gyro", "x", "offset", 3.0, probability=0.8, size=0.2, unit="rad/s")
ROTOR = make_finding("rotor", "2", "off", 5.0, probability=0.97)


def calibration(scores: list[float], hours: float) -> Calibration:
    kept = sorted((each for each in scores if each), reverse=True)
    return Calibration("ArduPilot", len(scores), hours, tuple(kept))


@pytest.mark.parametrize("rank", [1, 2, 5])
@pytest.mark.parametrize("ties", [False, True])
def test_of_all_flights_at_most_the_rank_are_above_the_threshold_of_the_others(rank, ties):
    scores = np.random.default_rng(rank).uniform(0.5, 0.99, 40)
    scores = np.where(scores < 0.7, 0.0, np.floor(10.0 * scores) / 10.0 if ties else scores).tolist()
    above = 0
    for number, score in enumerate(scores):  # each of them in turn is the new flight: all are as likely
        known = calibration(scores[:number] + scores[number + 1 :], 39.0)
        level = find_level(known, "asked", rank / 40.0)
        assert level.rate_per_h == pytest.approx(rank / 40.0)
        above += score > level.threshold
    assert above <= rank
    assert ties or above == rank


def test_level_that_cannot_be_kept_is_refused_with_the_lowest():
    known = calibration([0.9, *[0.0] * 98], 9.9)
    assert find_level(known, "1/10h", 0.1).threshold == 0.9
    with pytest.raises(ValueError, match=r"1/11h: 99 healthy ArduPilot flights, 9\.9 h, support .*, 1/10h"):
        find_level(known, "1/11h", 1.0 / 11.0)
    silent = calibration([CERTAIN, CERTAIN, 0.8, *[0.0] * 96], 9.9)
    with pytest.raises(ValueError, match=r"0\.3/h, 1/3\.3h"):  # no finding exceeds the largest score
        find_level(silent, "1/5h", 0.2)
    assert find_level(silent, "3/10h", 0.3).threshold == 0.8


@pytest.mark.parametrize("asked", ["", "1", "0/10h", "1/0h", "-1/10h", "1/10", "one/h", "nan/h"])
def test_level_that_makes_no_sense_is_refused(asked):
    with pytest.raises(ValueError, match="expected so many in so many hours, such as 1/10h"):
        level_for(asked, "ArduPilot BIN")


def test_format_without_flights_is_refused():
    with pytest.raises(
        ValueError, match=r"no calibration flights logged as Crazyflie uSD; .* ArduPilot, PX4"
    ):
        level_for("1/1h", "Crazyflie uSD")


def test_flights_of_both_autopilots_come_with_the_judge():
    assert [each.autopilot for each in load_calibrations()] == ["ArduPilot", "PX4"]
    for known in load_calibrations():
        assert known.hours > 5.0  # the level of the documents
        assert len(known.scores) <= known.flights
        assert list(known.scores) == sorted(known.scores, reverse=True)


LEVEL = Level(asked="1/10h", threshold=0.9, rate_per_h=0.1, flights=99, hours=9.9)


def told(*findings):
    """A verdict with some findings, before and after a level of 0.9."""
    time = np.arange(0.0, 10.0, 0.01)
    log = FlightLog(path=Path("log"), format="ArduPilot BIN", gyros={"": Signal(time, np.zeros((1000, 3)))})
    flight, judged = prepare(log), [*REQUIRED]
    ending = Ending(kind="in flight", time_s=10.0, impact_s=None, sentence="the log ends in flight")
    found = [Found(each) for each in findings]
    verdict = make_verdict(flight, None, ending, found, [], judged, [], None)
    return verdict, apply_level(verdict, flight, LEVEL)


def test_finding_below_the_level_moves_to_the_timeline():
    before, after = told(GYRO, ROTOR)
    assert after.findings == (ROTOR,)
    assert after.outcome == "fault"
    assert after.sentence == f"Rotor 2 gives no thrust from 5.00 s; 1 finding is {BELOW}, 1/10h."
    assert [each.time_s for each in after.timeline] == [each.time_s for each in before.timeline]
    texts = [each.text for each in after.timeline if BELOW in each.text]
    assert texts == [f"{BELOW}: gyro x has an offset of 0.2 rad/s from 3.00 s"]
    assert after.level == LEVEL


def test_flight_with_findings_below_the_level_alone_is_not_healthy():
    _, after = told(GYRO)
    assert (after.outcome, after.healthy, after.findings) == ("not enough to say", False, ())
    assert after.sentence.startswith(
        f"Not enough to say: 1 finding is {BELOW}, 1/10h; no fault found in gyro"
    )


def test_level_changes_nothing_above_it():
    for findings in ((), (ROTOR,)):
        before, after = told(*findings)
        assert after == before.model_copy(update={"level": LEVEL})
