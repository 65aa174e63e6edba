"""The closed loop without ROS: the paper's results, and what holds sample by sample."""

import dataclasses
import functools
import math

import numpy as np
import pytest

from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import NO_STATE, Flight
from quadftc_flight.scenario import (
    Scenario,
    find_scenario,
    load_scenario,
    node_parameters,
    parse_scenario,
    with_components,
    with_duration,
    with_seed,
)
from quadftc_flight.summary import summary
from quadftc_model.samples import AXES, HEALTHY
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.assembly import simulator_from

DEG = math.pi / 180.0
PAPER = ("paper_faults", "paper_constant_disturbance", "paper_varying_disturbance")
CHECKED = [  # scenario, scheme
    *((name, "proposed") for name in PAPER),
    ("paper_faults", "conventional"),
    ("mems_catalogue", "supervised"),
    ("mems_varying_disturbance", "supervised"),
    ("mems_varying_disturbance", "indi"),
    ("mems_faults", "supervised"),
    ("mems_constant_disturbance", "supervised"),
    ("gyro_faults", "isolating"),
    ("gyro_faults", "supervised"),
    ("successive_faults", "isolating"),
]
LARGEST = ([0.0, 0.0, 0.0], [0.05, 0.04, 0.015], [0.10, 0.08, 0.03])  # N m; disturbances of each

SHORT = """
duration: 2 s
rate: 250 Hz
vehicle: qball_x4
references: [{kind: step, angles: [10 deg, 0, 0], rise: 0.5}]
disturbances: [{kind: constant, amplitude: [0.2, 0, 0]}]
schemes: {only: {observer: sliding_mode, disturbance_observer: exosystem, controller: ismc}}
"""


EVERY_PAPER = pytest.mark.parametrize(("name", "scheme"), [(name, "proposed") for name in PAPER])


@functools.cache
def whole(name: str, scheme: str) -> tuple[Scenario, Flight]:
    """A scenario and its flight, flown once for all tests."""
    scenario = load_scenario(find_scenario(name))
    return scenario, fly(scenario, scheme)


def short(*overrides: str) -> Flight:
    return fly(parse_scenario(SHORT, overrides=overrides))


def identical(one: Flight, other: Flight) -> bool:
    return all(
        getattr(one, field.name).tobytes() == getattr(other, field.name).tobytes()
        for field in dataclasses.fields(Flight)
    )


@pytest.mark.parametrize(("name", "scheme"), CHECKED)
def test_scheme_passes_the_checks_of_its_scenario(name, scheme):
    scenario, flight = whole(name, scheme)
    checks = summary(flight, scenario, scenario.scheme(scheme), wall_time=1.0)["checks"]
    assert checks
    assert [check for check in checks if not check["passed"]] == []


def test_supervised_diagnosis_costs_nothing_without_faults():
    """Once the gyro bias is known, it tracks no worse than the same controller without diagnosis."""
    scenario = with_duration(load_scenario(find_scenario("mems_constant_disturbance"), ["faults=[]"]), 24.0)

    def tracking(flown: Scenario) -> np.ndarray:
        flight = fly(flown, "supervised")
        error = (flight.angles - flight.reference)[flight.time > 15.0]
        return np.sqrt(np.nanmean(error**2, axis=0))

    without = with_components(scenario, "supervised", observer="none")
    assert np.all(tracking(scenario) < 1.05 * tracking(without))


@EVERY_PAPER
def test_proposed_scheme_estimates_within_a_fifth_of_a_second_and_tracks(name, scheme):
    scenario, flight = whole(name, scheme)
    metrics = summary(flight, scenario, scenario.scheme(scheme), wall_time=1.0)["metrics"]
    for axis in AXES:
        assert metrics["fault_estimate_max_settled_deg"][axis] < 0.05
        assert metrics["tracking_rmse_deg"][axis] < 0.1
        assert all(window["fault_estimate_settling_s"][axis] <= 0.2 for window in metrics["fault_windows"])


@EVERY_PAPER
def test_the_faults_and_disturbances_were_really_there(name, scheme):
    scenario, flight = whole(name, scheme)
    first, second = ((w.start <= flight.time) & (flight.time < w.stop) for w in scenario.fault_windows)
    assert not flight.fault[~(first | second)].any()
    np.testing.assert_allclose(flight.fault[first, 0], 1.0 * DEG, atol=1e-12)
    np.testing.assert_allclose(flight.fault[second, 0], -2.0 * DEG, atol=1e-12)
    for window in (first, second):
        assert np.ptp(flight.fault[window, 1]) == pytest.approx(4.0 * DEG, rel=1e-3)
        assert np.max(np.abs(flight.fault[window, 2])) == pytest.approx(3.0 * DEG, rel=1e-3)
    later = flight.time >= 5.0
    disturbed = np.max(np.abs(flight.disturbance[later]), axis=0) * [0.03, 0.03, 0.04]  # N m
    np.testing.assert_allclose(disturbed, LARGEST[PAPER.index(name)], rtol=1e-3)
    assert not flight.disturbance[~later].any()


def test_conventional_control_leans_by_the_whole_fault():
    _, flight = whole("paper_faults", "conventional")
    window = (flight.time >= 20.0) & (flight.time < 40.0)
    assert not flight.reference[window, 0].any()
    assert np.mean(flight.angles[window, 0]) / DEG == pytest.approx(-1.0, abs=0.1)
    settled = (flight.time >= 25.0) & (flight.time < 40.0)
    np.testing.assert_allclose(flight.angles[settled, 0] / DEG, -1.0, atol=0.02)


def test_two_flights_with_one_seed_are_identical():
    scenario = with_duration(load_scenario(find_scenario("mems_faults")), 2.0)
    assert identical(fly(scenario), fly(scenario))
    assert not identical(fly(scenario), fly(with_seed(scenario, 2)))


def test_the_beginning_of_a_flight_does_not_depend_on_its_end():
    _, flight = whole("paper_varying_disturbance", "proposed")
    beginning = fly(with_duration(load_scenario(find_scenario("paper_varying_disturbance")), 6.0))
    assert len(beginning) == 1500
    assert np.array_equal(beginning.angles, flight.angles[:1500])
    assert np.array_equal(beginning.torque, flight.torque[:1500])


def test_rows_are_stamped_from_one_second_on_at_the_rate():
    flight = short("rate=300 Hz")
    assert len(flight) == 600
    assert flight.stamp_ns[0] == 1_000_000_000
    assert set(np.diff(flight.stamp_ns)) == {3_333_333}
    assert flight.time[1] == 0.003333333
    assert flight.delivered.all()
    assert (flight.fault_state == HEALTHY).all()


def test_a_sample_withheld_leaves_the_torque_as_it_is():
    flight = short("faults=[{kind: dropout, channel: imu, start: 0.2, stop: 0.4}]")
    gap = (flight.time >= 0.2) & (flight.time < 0.4)
    assert np.array_equal(flight.delivered, ~gap)
    assert np.isnan(flight.torque[gap]).all()
    assert (flight.fault_state[gap] == NO_STATE).all()
    assert np.isfinite(flight.angles).all()
    first, last = np.flatnonzero(gap)[[0, -1]]
    held = flight.torque[first - 1, 0]
    assert abs(held) > 0.05  # it moves when the gap begins
    spin_up = (flight.body_rate[last + 1, 0] - flight.body_rate[first, 0]) / (
        flight.time[last + 1] - flight.time[first]
    )
    vehicle = load_vehicle("qball_x4")
    drag = vehicle.rotational_drag[0] * np.mean(flight.body_rate[first : last + 1, 0])
    torque = held + 0.2 - drag  # 0.2 N m: the disturbance
    assert spin_up == pytest.approx(torque / vehicle.inertia[0], rel=1e-3)  # about the principal axis alone
    after = slice(-50, None)
    np.testing.assert_allclose(flight.angles[after, 0], 10.0 * DEG, atol=1.0 * DEG)


def test_a_late_sample_belongs_to_the_moment_it_was_taken():
    flight = short("sensors.delay=3", "schemes.only.observer=none", "references.0.start=0.0")
    assert len(flight) == 500 - 3  # the last three come after the end
    assert flight.stamp_ns[0] == 1_000_000_000
    seen = flight.error + flight.reference
    np.testing.assert_allclose(seen, flight.angles, atol=1e-12)


@pytest.mark.parametrize("delay", [0, 3])
def test_a_torque_acts_when_its_sample_has_come(delay):
    flight = short("disturbances=[]", "references=[{kind: hold, angles: 5 deg}]", f"sensors.delay={delay}")
    assert flight.torque[0].all()
    assert not flight.body_rate[: delay + 1].any()
    assert flight.body_rate[delay + 1].all()


def test_nan_in_the_sensor_goes_no_further():
    flight = short("faults=[{kind: nan, channel: attitude, start: 1, stop: 1.2}]")
    broken = (flight.time >= 1.0) & (flight.time < 1.2)
    assert np.isnan(flight.fault[broken]).all()
    assert flight.delivered.all()
    assert np.isfinite(flight.torque).all()
    assert np.isfinite(flight.fault_estimate).all()
    assert np.max(np.abs(flight.angles[-50:, 0] - 10.0 * DEG)) < 1.0 * DEG


def test_motor_lag_reaches_the_plant():
    with_lag = short("plant.motor_lag=true")
    assert not np.array_equal(with_lag.angles, short().angles)
    assert np.isfinite(with_lag.angles).all()


def test_the_papers_observer_drifts_at_the_gyro_bias():
    # it integrates the gyro: a bias b looks to it like a fault that grows at -b, and the vehicle follows
    scenario = parse_scenario(SHORT, overrides=["sensors.grade=mems", "references=[]", "disturbances=[]"])
    parameters = node_parameters(scenario)
    flight = fly(scenario)
    bias = measured_gyro_bias(parameters["plant"])
    assert np.max(np.abs(bias)) > 0.2 * DEG
    error = flight.fault_estimate - flight.fault
    slopes = np.polyfit(flight.time, error, 1)[0]
    np.testing.assert_allclose(slopes, -bias, atol=0.05 * DEG)
    np.testing.assert_allclose(np.polyfit(flight.time, flight.angles, 1)[0], -bias, atol=0.1 * DEG)


def measured_gyro_bias(plant_parameters) -> np.ndarray:
    """Mean gyro reading of the vehicle at rest, flown by nobody [rad/s]."""
    simulator = simulator_from(plant_parameters)
    emissions = [simulator.start(), *(simulator.advance(np.zeros(3)) for _ in range(2000))]
    return np.mean([emission.sample.body_rate for emission in emissions if emission.sample], axis=0)


def test_the_mems_scenario_asks_more_than_the_papers_observer_can_give():
    scenario = load_scenario(find_scenario("mems_faults"))
    flight = fly(with_duration(scenario, 15.0), "proposed")  # before the first fault even
    checks = summary(flight, scenario, scenario.scheme("proposed"), 1.0)["checks"]
    assert checks
    assert not any(check["passed"] for check in checks)
