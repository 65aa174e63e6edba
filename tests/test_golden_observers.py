"""What fault observers say on recordings and flights is what is stored, until somebody stores it anew."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from quadftc_tools.study.golden import STORED, judge, stored_verdicts
from quadftc_tools.study.golden_alarms import differences
from quadftc_tools.study.golden_trials import (
    RECORDINGS,
    SETS,
    flights_of,
    recorded_trials,
    simulated_trials,
    trials,
)
from recorded_logs import DATA, needs_data

ROOT = Path(__file__).resolve().parents[1]
OBSERVERS = sorted(path.stem for path in STORED.glob("*.json"))
SHARE = 20  # one trial in so many
FLOWN = [name for name in OBSERVERS if name != "supervised"]  # `isolating` has its judge within


def refuse_differences(chosen, observer):
    said = {trial.name: verdict for trial, verdict in judge(chosen, observer)}
    assert sum(len(verdict.alarms) for verdict in said.values())
    assert differences(stored_verdicts(observer), said) == []


@pytest.mark.slow
@pytest.mark.parametrize("observer", FLOWN)
def test_observer_says_on_some_flights_what_is_stored(observer):
    refuse_differences([*simulated_trials()][::SHARE], observer)


@pytest.mark.slow
@needs_data
@pytest.mark.parametrize("observer", FLOWN)
def test_observer_says_on_some_recordings_what_is_stored(observer):
    refuse_differences([*recorded_trials(DATA)][::SHARE], observer)


def test_what_a_faulty_gyro_has_taught_is_not_blamed_on_the_attitude():
    flight = [*flights_of("which_sensor", 21, 369)][-1]  # the fault of its gyro turns it by 0.5 rad
    verdict = flight.judge("bank")
    named = {alarm.element for alarm in verdict.alarms if alarm.state == "FAULTY"}
    assert "gyro/y" in named
    assert not any(element.startswith("attitude") for element in named)
    assert verdict.error_deg < 10.0


@pytest.mark.parametrize(("seed", "number"), [(2323, 377), (2323, 391), (2423, 662)])
def test_what_a_wrong_inertia_does_to_torques_is_nobodys_fault(seed, number):
    verdict = [*flights_of("which_sensor_healthy", seed, number + 1)][-1].judge("bank")
    assert not verdict.alarms
    assert verdict.error_deg < 2.0


@pytest.mark.thorough
@pytest.mark.parametrize("observer", OBSERVERS)
def test_observer_says_everywhere_what_is_stored(observer):
    refuse_differences(trials(DATA), observer)


def test_page_names_every_recording_in_its_set():
    rows = re.findall(r"^\| `(\w+)`.*?\|(.*)\|(.*)\|$", (ROOT / "docs/judging.md").read_text(), re.MULTILINE)
    for name, *cells in rows:
        for part, cell in zip(SETS, cells, strict=True):
            named = tuple(filter(None, re.split(r"[*, ]+", cell)))
            assert named == RECORDINGS[part].get(name, ()), (part, name)
    assert {name for name, *_ in rows} == {kind for kinds in RECORDINGS.values() for kind in kinds}
