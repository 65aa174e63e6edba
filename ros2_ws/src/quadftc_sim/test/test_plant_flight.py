"""A flight without ROS: what torque acts when, flying ahead, its clock and its end."""

import numpy as np
import pytest

from quadftc_model.vehicle import load_vehicle
from quadftc_sim.assembly import vehicle_from
from quadftc_sim.plants.test_stand import AttitudeStand
from quadftc_sim.sensors import ImuSensor
from quadftc_sim.simulator import NEVER_NS, PlantFlight, Simulator

PERIOD_NS = 4_000_000
EPOCH_NS = 7_000_000_000
BEGIN_NS = 123_000_000
ROLL, NOTHING = np.array([0.02, 0.0, 0.0]), np.zeros(3)


def flight(count=0, torque_timeout=0.5, delay=0):
    plant = AttitudeStand(vehicle=load_vehicle("qball_x4"))
    simulator = Simulator(vehicle_from(plant, ImuSensor(delay=delay), PERIOD_NS), EPOCH_NS, seed=1)
    return PlantFlight(simulator, count, torque_timeout, BEGIN_NS)


def test_flying_ahead_gives_what_flying_later_would():
    ahead, later = flight(), flight()
    for each in (ahead, later):
        each.emission()
    for torque in (ROLL, -ROLL, NOTHING):
        ahead.command(torque)
        ahead.fly_ahead()
        later.command(torque)
        found, wanted = ahead.emission(), later.emission()
        assert found.stamp_ns == wanted.stamp_ns
        np.testing.assert_array_equal(found.body_rate, wanted.body_rate)
        np.testing.assert_array_equal(found.angles, wanted.angles)


def test_torque_that_comes_after_the_period_was_flown_acts_in_the_next():
    one = flight()
    one.emission()
    one.command(NOTHING)
    one.fly_ahead()
    one.command(ROLL)
    one.fly_ahead()
    assert one.emission().body_rate[0] == 0.0
    assert one.emission().body_rate[0] > 0.0


def test_next_emission_is_due_a_period_after_the_last_whether_it_was_flown_or_not():
    one = flight()
    one.emission()
    assert one.due_ns == BEGIN_NS + PERIOD_NS
    one.fly_ahead()
    assert one.due_ns == BEGIN_NS + PERIOD_NS
    one.emission()
    assert one.due_ns == BEGIN_NS + 2 * PERIOD_NS


def test_flight_has_its_emissions_and_then_ends():
    one = flight(count=3)
    stamps = [one.emission().stamp_ns for _ in range(3)]
    assert stamps == [EPOCH_NS + k * PERIOD_NS for k in range(3)]
    assert not one.finished
    assert one.emission() is None
    assert one.finished
    assert (one.emitted, one.due_ns) == (3, NEVER_NS)


def test_torque_is_lost_after_the_time_out_and_then_does_not_act():
    one = flight(torque_timeout=3.5 * PERIOD_NS * 1e-9)
    one.emission()
    one.command(ROLL)
    rates = [0.0]
    for period in range(6):
        one.wait()
        assert one.torque_lost == (period >= 3)
        rates.append(one.emission().body_rate[0])
    gained = np.diff(rates)
    assert np.all(gained[:3] > 0.0)
    assert np.all(gained[3:] <= 0.0)  # drag
    one.command(ROLL)
    assert not one.torque_lost


@pytest.mark.parametrize("delay", [0, 2])
def test_awaited_is_the_torque_of_the_last_sample(delay):
    one = flight(delay=delay)
    for index in range(5):
        emission = one.emission()
        assert (emission.sample is None) == (index < delay)
        assert one.awaited_ns == (None if index < delay else EPOCH_NS + (index - delay) * PERIOD_NS)
