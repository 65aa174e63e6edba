"""In free flight, too, the batch engine flies what the closed loop flies."""

import numpy as np
import pytest
from batch_flights import assert_same_flight, assert_same_metrics, stepped, traced

from quadftc_campaign.batch.engine import Engine
from quadftc_campaign.flights import parts_of
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import build_scenario, parse_scenario
from quadftc_model.samples import FAULTY

FREE = """
duration: 1.2 s
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


@pytest.mark.thorough
def test_a_compiled_flight_is_that_of_the_closed_loop():
    scenario = free(observer="none")
    expected = fly(scenario)
    ((outcome, flight),) = traced([parts_of(scenario)], [scenario])
    assert np.isfinite(flight.position_reference[flight.delivered]).all()
    assert_same_flight(flight, expected)
    assert_same_metrics(outcome, expected, scenario)


WEAK = {"kind": "loss", "rotors": [1], "value": 0.3, "start": 2.2}  # once the diagnosis has learned
GPS = {"grade": "gps", "rate": 20.0, "delay": 0.05}


@pytest.mark.parametrize(
    "changes",
    [
        {"observer": "isolating", "duration": 2.6, "faults": [WEAK]},
        {"position_sensor": GPS, "sensors": {"grade": "mems", "delay": 3}},
        {"faults": [DROPOUT], "observer": "isolating"},
        {
            "faults": [
                {"kind": "stuck", "channel": "rotor", "rotors": [1, 3], "start": 0.3, "stop": 0.6},
                {"kind": "chipped", "rotors": [2], "value": 0.1, "unbalance": 1e-6, "start": 0.5},
                {"kind": "off", "rotors": 4, "start": 1.0},
            ]
        },
        {"vehicle": "crazyflie_2x", "disturbances": [], "schemes": {"tested": {"controller": "indi"}}},
    ],
)
def test_a_step_is_that_of_the_closed_loop(changes):
    """With an observer of all sensors, late positions, withheld samples, faulty rotors, measured speeds."""
    scenario = free(**changes)
    flight = fly(scenario)
    assert_same_flight(stepped(scenario)[1], flight)
    assert bool(np.any(flight.rotor_state == FAULTY)) == (WEAK in changes.get("faults", ()))


def test_plant_that_cannot_be_traced_is_refused_by_name():
    pytest.importorskip("mujoco")
    flights = [
        parts_of(free(plant={"kind": "mujoco", "inertia_factor": [factor, 1, 1]})) for factor in (1, 1.1)
    ]
    with pytest.raises(ValueError, match=r"plant \(Mujoco\) cannot be flown in a batch"):
        Engine().fly(flights, [(), ()])
