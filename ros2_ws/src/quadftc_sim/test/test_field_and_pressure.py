"""Magnetometer and barometer against closed forms, and their random numbers."""

import math

import numpy as np
import pytest

from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.assembly import vehicle_from
from quadftc_sim.barometer import (
    BAROMETER_GRADES,
    SEA_LEVEL,
    Barometer,
    PressureInputs,
    standard_height,
    standard_pressure,
)
from quadftc_sim.magnetometer import MAGNETOMETER_GRADES, FieldInputs, Magnetometer
from quadftc_sim.plants.free_flight import FreeFlight
from quadftc_sim.sensors import ImuSensor
from quadftc_sim.simulator import Simulator

NONE, DUE = np.zeros(3), np.bool_(True)


def measured(law, q_xyzw):
    """The field [T] that a magnetometer without errors says."""
    errors = np.zeros((*q_xyzw.shape[:-1], 3))
    return law.step(errors, FieldInputs(q_xyzw, DUE, errors), 0.05)[1].field


@pytest.mark.parametrize(("height", "pressure"), [(0.0, 101325.0), (1000.0, 89874.6), (5000.0, 54019.9)])
def test_the_pressure_is_that_of_the_standard_atmosphere(height, pressure):
    assert standard_pressure(height) == pytest.approx(pressure, rel=1e-5)  # table of ICAO Doc 7488
    assert standard_height(standard_pressure(height)) == pytest.approx(height, abs=1e-6)


def test_level_and_facing_east_the_field_is_that_of_the_earth():
    law = Magnetometer(rate=20.0, inclination=math.radians(60.0), declination=math.radians(10.0))
    east, north, up = measured(law, quaternion_from_euler(NONE))
    assert math.degrees(math.atan2(east, north)) == pytest.approx(10.0)
    assert math.degrees(math.atan2(-up, math.hypot(east, north))) == pytest.approx(60.0)
    turned = measured(law, quaternion_from_euler(np.array([0.0, 0.0, math.pi / 2])))
    assert turned == pytest.approx([north, -east, up])  # facing north: x is north, y is west


def test_at_any_attitude_the_field_is_as_strong():
    rng = np.random.default_rng(1)
    law, q_xyzw = Magnetometer(rate=20.0), quaternion_from_euler(rng.uniform(-3.0, 3.0, (50, 3)))
    field = measured(law, q_xyzw)
    assert np.linalg.norm(field, axis=-1) == pytest.approx(np.full(50, law.strength))
    one = measured(law, q_xyzw[7])
    assert field[7] == pytest.approx(one, abs=1e-18)


def test_the_slow_error_of_the_pressure_keeps_its_size():
    rng, law = np.random.default_rng(2), Barometer(rate=50.0, wander=10.0, wander_time=1.0)
    wander = law.init(rng.standard_normal((400, 2)))
    for _ in range(200):
        wander, said = law.step(wander, PressureInputs(0.0, DUE, rng.standard_normal((400, 2))), 0.02)
    assert np.std(said.pressure - SEA_LEVEL) == pytest.approx(10.0, rel=0.15)


def test_a_sensor_that_does_not_measure_keeps_its_error():
    law, draws = Barometer(rate=50.0, wander=10.0), np.ones(2)
    wander, said = law.step(np.float64(3.0), PressureInputs(0.0, np.bool_(False), draws), 0.02)
    assert wander == 3.0
    assert not said.there


def fly(**sensors):
    plant = FreeFlight(vehicle=load_vehicle("x500"))
    law = vehicle_from(plant, ImuSensor(attitude_noise=0.01), 4_000_000, **sensors)
    simulator = Simulator(law, 0, 5)
    emissions = [simulator.start()]
    emissions += [simulator.advance(plant.first_command) for _ in range(99)]
    return emissions


def test_they_measure_at_their_rates_and_change_no_other_sensor():
    graded = {"magnetometer": Magnetometer(**MAGNETOMETER_GRADES["mems"])}
    graded["barometer"] = Barometer(**BAROMETER_GRADES["mems"])
    alone, flown = fly(), fly(**graded)
    assert sum(each.field is not None for each in flown) == 9  # every 12th: 20.8 Hz
    assert sum(each.pressure is not None for each in flown) == 20
    assert all(each.field is None and each.pressure is None for each in alone)
    for one, other in zip(alone, flown, strict=True):
        assert np.array_equal(one.sample.q_xyzw, other.sample.q_xyzw)


def test_the_height_is_known_to_the_noise_of_the_barometer():
    noise = 1.2  # Pa; 0.1 m
    emissions = fly(barometer=Barometer(rate=250.0, noise=noise, altitude=400.0))
    heights = np.array([standard_height(each.pressure) - 400.0 for each in emissions])
    errors = heights - [each.flight.position[2] for each in emissions]
    assert abs(np.mean(errors)) < 0.04
    assert np.std(errors) == pytest.approx(noise / 11.5, rel=0.3)  # 11.5 Pa/m at 400 m


@pytest.mark.parametrize(
    ("law", "parameter"), [(Magnetometer, "rate"), (Magnetometer, "strength"), (Barometer, "altitude")]
)
def test_impossible_parameters_are_refused(law, parameter):
    with pytest.raises(ValueError, match=parameter):
        law(**{parameter: -1e5})
