"""In free flight, too, the batch engine flies what the closed loop flies."""

import numpy as np
import pytest
from batch_flights import assert_same_metrics, assert_same_outcome

from quadftc_campaign.batch.engine import fly_all
from quadftc_campaign.batch.jax_engine import JaxEngine
from quadftc_campaign.flights import batch_flight
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import build_scenario, find_scenario, load_scenario, parse_scenario
from quadftc_model.samples import FAULTY

FREE = """
duration: 0.8 s
rate: 250 Hz
seed: 3
vehicle: x500
plant: {kind: free_flight, start: [2, 0, 0.3]}
sensors: {grade: mems}
position_sensor: {grade: mocap}
trajectories: [{kind: circle, centre: [0, 0, 0.5], radius: 2, speed: 1, rise: 0.5}]
wind: [{kind: constant, velocity_mean: [3, 1, 0]}, {kind: dryden}]
disturbances: [{kind: sine, amplitude: 0.05, frequency: 3}]
faults:
  - {kind: bias, value: 5 deg, axes: roll, start: 0.4 s}
  - {kind: loss, rotors: [2], value: 20 %, rise: 0.2 s, start: 0.5 s}
schemes:
  tested: {observer: none, disturbance_observer: exosystem, controller: ismc, position_controller: geometric}
"""
DROPOUT = {"kind": "dropout", "channel": "imu", "start": 0.0, "stop": 0.7, "probability": 0.3}


def free(observer="none", **changes):
    """A short flight through space."""
    scenario = parse_scenario(FREE, overrides=[f"schemes.tested.observer={observer}"])
    changed = {(key,): value for key, value in changes.items()}
    return build_scenario(scenario.document.replaced(changed, "test")) if changed else scenario


@pytest.mark.parametrize("name", ["free_circle", "rotor_loss"])
def test_a_scenario_is_judged_by_its_metrics_to_its_end(name):
    scenario = load_scenario(find_scenario(name))
    (outcome,) = fly_all([batch_flight(scenario, "isolating")])
    assert_same_metrics(outcome, fly(scenario, "isolating"), scenario)


WEAK = {"kind": "loss", "rotors": [1], "value": 0.3, "start": 2.2}  # once the diagnosis has learned
NAMED = {"observer": "isolating", "duration": 2.6, "faults": [WEAK]}
GPS = {"grade": "gps", "rate": 20.0, "delay": 0.05}


def test_a_weak_rotor_that_is_named_is_judged_by_its_metrics():
    scenario = free(**NAMED)
    flight, (outcome,) = fly(scenario), fly_all([batch_flight(scenario)])
    assert_same_metrics(outcome, flight, scenario)
    assert np.any(flight.rotor_state == FAULTY)


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param(NAMED, marks=pytest.mark.thorough),
        {"position_sensor": GPS, "sensors": {"grade": "mems", "delay": 3}},
        {"faults": [DROPOUT], "observer": "isolating"},
        {
            "faults": [
                {"kind": "stuck", "channel": "rotor", "rotors": [1, 3], "start": 0.3, "stop": 0.6},
                {"kind": "chipped", "rotors": [2], "value": 0.1, "unbalance": 1e-6, "start": 0.5},
                {"kind": "off", "rotors": 4, "start": 0.6},
            ]
        },
        {"vehicle": "crazyflie_2x", "disturbances": [], "schemes": {"tested": {"controller": "indi"}}},
    ],
)
def test_a_flight_in_c_is_that_in_numpy_and_is_judged_by_its_metrics(changes):
    """With an observer of all sensors, late positions, withheld samples, faulty rotors, measured speeds."""
    scenario = free(**changes)
    flights = [batch_flight(scenario)]
    flight, (outcome,), (other,) = fly(scenario), fly_all(flights), fly_all(flights, "numpy")
    assert_same_metrics(outcome, flight, scenario)
    assert_same_outcome(outcome, other)
    assert bool(np.any(flight.rotor_state == FAULTY)) == (changes is NAMED)


@pytest.mark.thorough  # the plant in JAX: quadftc_sim/test/test_laws.py
@pytest.mark.parametrize("observer", ["none", "isolating"])
def test_a_flight_in_jax_is_that_in_c(observer):
    flights = [batch_flight(free(observer=observer))]
    assert_same_outcome(*JaxEngine().fly(flights), *fly_all(flights))
