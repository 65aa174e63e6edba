"""A flight sample by sample."""

import numpy as np
import pytest

from quadftc_model.parameters import build
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.assembly import vehicle_from
from quadftc_sim.disturbance import disturbances
from quadftc_sim.plants.test_stand import AttitudeStand
from quadftc_sim.sensors import GRADES, ImuSensor
from quadftc_sim.simulator import Simulator

EPOCH, PERIOD = 1_000_000_000, 4_000_000  # ns
TORQUE = np.array([0.2, -0.1, 0.05])


def simulator(sensor=GRADES["mems"], seed=1, inertia_factor=(1.0, 1.0, 1.0)):
    vehicle = load_vehicle("qball_x4")
    push = build(disturbances.get("constant"), {"amplitude": [0.03, 0.06, 0.08], "start": 0.02})
    plant = AttitudeStand(vehicle=vehicle, disturbances=(push,), inertia_factor=inertia_factor)
    return Simulator(vehicle_from(plant, build(ImuSensor, sensor), PERIOD), EPOCH, seed)


def flown(made, count=20):
    return [made.start(), *(made.advance(TORQUE) for _ in range(count))]


def test_stamps_count_periods_from_the_epoch():
    assert [emission.stamp_ns for emission in flown(simulator(), 3)] == [EPOCH + PERIOD * k for k in range(4)]


def test_scenario_time_is_zero_at_the_epoch():
    assert simulator().time == 0.0


def test_ideal_sample_is_the_truth_of_the_same_instant():
    emission = flown(simulator(GRADES["ideal"]))[-1]
    assert emission.sample_stamp_ns == emission.stamp_ns
    np.testing.assert_array_equal(emission.sample.body_rate, emission.body_rate)


def test_delayed_sample_is_the_truth_of_its_own_stamp():
    emissions = flown(simulator({"delay": 2}))
    assert [emission.sample for emission in emissions[:2]] == [None, None]
    truth = {emission.stamp_ns: emission.body_rate for emission in emissions}
    for emission in emissions[2:]:
        np.testing.assert_array_equal(emission.sample.body_rate, truth[emission.sample_stamp_ns])


def test_disturbance_is_told_as_angular_acceleration_from_its_onset_on():
    told = np.array([emission.disturbance for emission in flown(simulator(), 10)])
    expected = np.where(np.arange(11)[:, None] >= 5, [1.0, 2.0, 2.0], 0.0)
    np.testing.assert_allclose(told, expected, rtol=1e-12)


def test_disturbance_is_told_over_the_true_inertia():
    told = flown(simulator(inertia_factor=(2.0, 0.5, 4.0)), 10)[-1].disturbance
    np.testing.assert_allclose(told, [0.5, 4.0, 0.5], rtol=1e-12)


@pytest.mark.parametrize("period", [0, -1])
def test_period_that_is_not_positive_is_refused(period):
    with pytest.raises(ValueError, match=r"period = .* s: must be positive"):
        vehicle_from(AttitudeStand(vehicle=load_vehicle("qball_x4")), ImuSensor(), period)
