"""The paper's claims: flights that do what the paper says agree, and each claim fails when its numbers do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from recorded_runs import recorded_run

from quadftc_flight.flight import VECTORS, Flight, unknown_flight
from quadftc_flight.scenario import Scenario, find_scenario, load_scenario
from quadftc_report.claims import judge
from quadftc_report.comparison import Comparison, compare

RATE = 20.0  # Hz
TIME = np.arange(0, 80, 1 / RATE)
DEG = np.radians(1.0)
NAMES = ("paper_faults", "paper_constant_disturbance", "paper_varying_disturbance")


def disturbance(name: str, size: float) -> np.ndarray:
    """Angular acceleration [rad/s²] (n, 3) from 5 s on."""
    shape = {NAMES[0]: 0.0 * TIME, NAMES[1]: 1.0 + 0.0 * TIME, NAMES[2]: np.sin(TIME - 5.0)}[name]
    return np.where(TIME[:, None] >= 5.0, size * shape[:, None] * np.ones(3), 0.0)


def ideal_flight(name: str, observer: bool, size: float = 1.0) -> Flight:
    """A flight as the paper tells it; a disturbance moves the conventional vehicle by 2 deg for 1 rad/s²."""
    columns = {vector: np.zeros((len(TIME), 3)) for vector in VECTORS}
    faulty = ((TIME >= 20) & (TIME < 40))[:, None] * np.array([1.0, 2.0, 3.0])
    faulty = (faulty + ((TIME >= 50) & (TIME < 70))[:, None] * np.array([-2.0, 2.0, -3.0])) * DEG
    columns |= {"fault": faulty, "disturbance": disturbance(name, size)}
    if observer:
        columns |= {"fault_estimate": faulty, "disturbance_estimate": columns["disturbance"]}
    else:
        columns |= {"angles": 2.0 * DEG * columns["disturbance"] - faulty, "torque": faulty}
    stamps = 1_000_000_000 + np.round(1e9 * TIME).astype(np.int64)
    count = len(TIME)
    return dataclasses.replace(
        unknown_flight(stamps),
        time=TIME,
        delivered=np.ones(count, np.bool_),
        fault_state=np.ones((count, 3), np.uint8),
        **columns,
    )


def paper_scenario(name: str, *overrides: str) -> Scenario:
    return load_scenario(find_scenario(name), [f"rate={RATE} Hz", *overrides])


def comparison(name: str, size: float = 1.0, overrides=(), **changes) -> Comparison:
    """The two runs of a scenario of the paper; ``changes``: what to add to columns of one run's flight."""
    scenario = paper_scenario(name, *overrides)
    runs = []
    for scheme in ("proposed", "conventional"):
        flight = ideal_flight(name, scheme == "proposed", size)
        added = {vector: getattr(flight, vector) + value for vector, value in changes.get(scheme, {}).items()}
        runs.append(recorded_run(scenario, scheme, dataclasses.replace(flight, **added)))
    return compare(runs)[0]


def verdicts(judged: Comparison, among=()) -> dict[str, bool | None]:
    return {found.claim.key: found.holds for found in judge(judged, among)}


@pytest.fixture(scope="module")
def three() -> list[Comparison]:
    """All scenarios, the varying disturbance being twice as large as the constant one."""
    return [comparison(name, 2.0 if name == NAMES[2] else 1.0) for name in NAMES]


@pytest.mark.parametrize("index", range(3))
def test_flights_as_the_paper_tells_them_agree_with_every_claim(three, index):
    found = judge(three[index], three)
    assert len(found) >= 5
    assert [item.claim.key for item in found if item.holds is not True] == []


WAVE = np.sin(40.0 * TIME)[:, None] * np.ones(3)


@pytest.mark.parametrize(
    ("name", "scheme", "changes", "claims"),
    [
        (NAMES[0], "proposed", {"fault_estimate": 0.06 * DEG}, {"faults_estimated"}),
        (NAMES[1], "proposed", {"fault_estimate": 0.06 * DEG}, {"faults_estimated"}),
        (NAMES[0], "proposed", {"angles": 0.11 * DEG}, {"proposed_follows"}),
        (NAMES[1], "proposed", {"angles": 0.11 * DEG}, {"tracking_maintained"}),
        (NAMES[2], "proposed", {"angles": 0.11 * DEG}, {"tracking_still_maintained"}),
        (NAMES[0], "conventional", {"angles": 0.2 * DEG}, {"roll_is_minus_one_degree"}),
        (NAMES[1], "conventional", {"angles": -2.0 * DEG}, {"conventional_leans_without_fault"}),
        (NAMES[1], "proposed", {"disturbance_estimate": 0.11}, {"disturbance_compensated"}),
        (NAMES[0], "proposed", {"angles": 5 * DEG}, {"proposed_follows", "proposed_superior"}),
        (NAMES[0], "proposed", {"torque": WAVE}, {"no_chattering"}),
        (
            NAMES[0],
            "conventional",
            {"angles": ideal_flight(NAMES[0], True).fault},
            {"conventional_follows_its_sensor", "roll_is_minus_one_degree"},
        ),
    ],
)
def test_claim_fails_when_its_numbers_do(three, name, scheme, changes, claims):
    judged = comparison(name, 2.0 if name == NAMES[2] else 1.0, **{scheme: changes})
    found = verdicts(judged, three)
    assert {key for key, verdict in found.items() if verdict is False} == claims


def test_claim_on_two_scenarios_needs_both_and_tells_which_is_worse(three):
    weak = comparison(NAMES[2], 1.0)
    assert verdicts(weak)["conventional_more_affected"] is None
    found = next(item for item in judge(weak, three) if item.claim.key == "conventional_more_affected")
    assert found.holds is False
    assert "RMS of the disturbance roll 70.9, pitch 70.9, yaw 70.9 % of that in scenario 1" in found.reason


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        (["sensors.grade=mems"], "the sensors are not ideal"),
        (["plant.motor_lag=true"], "the vehicle is not the paper's"),
        (["faults.0.start=21 s"], "the faults are not where the paper has them"),
        (["schemes.proposed.controller=pid"], "no run with the paper's observers and controller"),
        (["schemes.conventional.controller=pid"], "no run with the conventional control"),
    ],
)
def test_runs_that_are_not_the_papers_get_no_verdict(overrides, reason):
    found = judge(comparison(NAMES[0], overrides=overrides))
    assert {item.holds for item in found} == {None}
    assert reason in found[0].reason


def test_disturbance_that_is_not_the_papers_gets_no_verdict():
    late = np.where(TIME[:, None] >= 5.0, 0.5 * np.sin(TIME)[:, None] * np.ones(3), 0.0)
    for changes, reason in (
        ({"disturbance": late}, "the disturbance is not constant"),
        ({"disturbance": 0.1}, "a disturbance acts before 5 s"),
    ):
        found = judge(comparison(NAMES[1], conventional=changes))
        assert {item.holds for item in found} == {None}
        assert reason in found[0].reason


def test_run_that_was_cut_short_gets_no_verdict(three):
    scenario = three[0].runs[0].scenario
    runs = (three[0].runs[0], recorded_run(scenario, "conventional", three[0].runs[1].flight.first(800)))
    found = judge(Comparison(runs, NAMES[0]))
    assert found[0].holds is None
    assert "was recorded for 40.0 s of 80 s only" in found[0].reason


def test_scenario_that_is_not_in_the_paper_has_no_claims():
    assert judge(comparison(NAMES[0], overrides=["name=mine"])) == []
