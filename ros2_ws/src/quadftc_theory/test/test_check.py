"""The check of a scheme: bounds from a scenario and from a recorded run, sections, verdict, JSON."""

import functools
import json

import numpy as np
import pytest

from quadftc_flight.scenario import find_scenario, load_scenario, with_duration
from quadftc_theory.checks import check_scenario, circumstances
from quadftc_theory.conditions import Verdict


def loaded(name, *overrides):
    return load_scenario(find_scenario(name), ["rate=125 Hz", *overrides])


@functools.cache
def report(name, *overrides, scheme="proposed"):
    """Of the first half minute, with ten seconds of the first faults, at half the rate: less to compute."""
    scenario = with_duration(loaded(name, *overrides), 30.0)
    return check_scenario(scenario, scenario.scheme(scheme))


def failures(found):
    return [item.name for section in found.sections for item in section.conditions if item.failed]


PAPER = ("paper_faults", "paper_constant_disturbance", "paper_varying_disturbance")


@pytest.mark.parametrize("name", PAPER)
@pytest.mark.parametrize("scheme", ["proposed", "conventional"])
def test_in_the_papers_conditions_every_needed_condition_holds(name, scheme):
    assert failures(report(name, scheme=scheme)) == []


def test_on_a_mems_imu_the_faultless_gyro_fails_and_the_drift_with_it():
    found = failures(report("mems_faults"))
    assert any(name.startswith("(12)") for name in found)
    assert "drift by a gyro bias" in found


def test_the_papers_own_output_is_infeasible():
    (section,) = [each for each in report("paper_faults").sections if "own set-up" in each.title]
    assert [each.verdict for each in section.conditions] == [Verdict.FAIL] * 3


@pytest.mark.parametrize(
    ("override", "name"),
    [
        ("schemes.proposed.observer={kind: sliding_mode, epsilon_s: 1 deg}", "(9), (19)"),
        ("schemes.proposed.observer={kind: sliding_mode, L1: 0.0}", "A-bar - L-bar C-bar"),
        ("schemes.proposed.controller={kind: ismc, k_c3: [0.001, 2, 1]}", "Theorem 2"),
        ("schemes.proposed.controller={kind: ismc, phi: [0.1, 0.1, 0.0001]}", "(41)"),
    ],
)
def test_a_gain_that_breaks_a_condition_is_named(override, name):
    assert [item for item in failures(report("paper_faults", override)) if item.startswith(name)]


def test_the_bounds_are_those_of_the_scenario():
    scenario = loaded("paper_varying_disturbance")
    given = circumstances(scenario, scenario.scheme())
    # 0.10 / 0.03, 0.08 / 0.03, 0.03 / 0.04 rad/s², and a little drag
    np.testing.assert_allclose(given.disturbance.peak, [3.333, 2.667, 0.75], rtol=0.02)
    # 2 deg of roll and pitch, 3 deg of yaw at the end: not all at once
    assert np.radians(3.8) < given.fault.value < np.radians(np.sqrt(17.0))
    assert given.fault_length.value == 20.0
    assert given.fault_growth.value == pytest.approx(np.radians(0.15), rel=0.01)
    # an exosystem that is constant lags behind a sine by its frequency over the bandwidth
    np.testing.assert_allclose(given.disturbance_error.peak[:2], [3.333 * 0.05, 2.667 * 0.07], rtol=0.03)


CALM = """\
name: calm
description: nothing happens
duration: 2 s
rate: 250 Hz
seed: 1
vehicle: qball_x4
sensors: {grade: ideal}
schemes:
  proposed: {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc}
"""


def test_a_scenario_without_faults_and_disturbances_is_judged_too(tmp_path):
    path = tmp_path / "calm.yaml"
    path.write_text(CALM, encoding="utf-8")
    scenario = load_scenario(path, [])
    found = check_scenario(scenario, scenario.scheme())
    assert found.passed
    assert found.to_dict()["bounds"]["fault_growth"]["value"] is None  # there is none: infinite


def test_the_json_has_every_condition_and_no_nan():
    found = report("mems_faults")
    text = json.dumps(found.to_dict(), allow_nan=False)
    data = json.loads(text)
    assert data["passed"] is False
    assert {item["verdict"] for section in data["sections"] for item in section["conditions"]} == {
        *(verdict.value for verdict in Verdict)
    }
