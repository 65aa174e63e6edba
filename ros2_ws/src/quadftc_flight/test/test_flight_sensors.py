"""Magnetometer and barometer as keys of a scenario."""

import numpy as np
import pytest

from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import ScenarioError, node_parameters, parse_scenario
from quadftc_model.assembly import node_values
from quadftc_sim.assembly import simulator_from

FLIGHT = """
name: hover
duration: 1 s
rate: 250 Hz
vehicle: x500
plant: {kind: free_flight, start: [0, 0, 1]}
sensors: {grade: mems}
position_sensor: {grade: mocap}
schemes:
  plain: {controller: smc}
"""
GRADED = (
    FLIGHT + "magnetometer: {grade: mems, inclination: 60 deg}\nbarometer: {grade: mems, altitude: 400 m}\n"
)


@pytest.mark.parametrize(("text", "rates"), [(FLIGHT, (0.0, 0.0)), (GRADED, (20.0, 50.0))])
def test_the_plant_gets_the_sensors_of_the_scenario(text, rates):
    scenario = parse_scenario(text)
    simulator = simulator_from(node_parameters(scenario, scenario.schemes["plain"])["plant"])
    for name, rate in zip(("magnetometer", "barometer"), rates, strict=True):
        sensor = getattr(simulator.law, name)
        assert (0.0 if sensor is None else sensor.rate) == rate
        if sensor is not None:
            assert node_values(sensor, "") == node_values(getattr(scenario, name), "")


@pytest.mark.parametrize("name", ["magnetometer", "barometer"])
@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("{grade: best}", ".grade: 'best': expected one of ideal, mems"),
        ("{nois: 1}", ".nois: unknown key (did you mean 'noise'?)"),
        ("{noise: 1 m}", ".noise: '1 m': 'm' is not a unit of this quantity"),
        ("{rate: -1 Hz}", ".rate: -1.0 Hz: must be within [0, 4000]"),
        ("mems", ": 'mems': expected a mapping"),
    ],
)
def test_a_wrong_sensor_is_refused_with_its_key(name, value, said):
    with pytest.raises(ScenarioError) as refused:
        parse_scenario(f"{FLIGHT}{name}: {value}\n")
    assert f"{name}{said}" in str(refused.value)


@pytest.mark.parametrize("name", ["magnetometer", "barometer"])
def test_a_test_stand_has_no_such_sensor(name):
    stand = FLIGHT.replace("kind: free_flight, start: [0, 0, 1]", "").replace(
        "position_sensor: {grade: mocap}\n", ""
    )
    with pytest.raises(ScenarioError, match=f"{name}: only in free flight"):
        parse_scenario(f"{stand}{name}: {{grade: mems}}\n")


def test_the_closed_loop_flies_the_same_with_and_without():
    alone, graded = (fly(parse_scenario(text)) for text in (FLIGHT, GRADED))
    for name in ("position", "rotor_speeds", "torque"):
        assert np.array_equal(getattr(alone, name), getattr(graded, name), equal_nan=True), name
    assert np.any(alone.rotor_speeds)
