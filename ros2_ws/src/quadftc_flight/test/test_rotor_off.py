"""Flights with a rotor off, told to the controller 60 ms late, as a diagnosis would."""

import dataclasses

import numpy as np
import pytest

from quadftc_fdi.fault_observers.none import NoDiagnosis
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import parse_scenario
from quadftc_model.samples import FAULTY, HEALTHY, RotorEstimate

OFF, BACK, LATE = 1.0, 5.0, 0.06  # s
FLIGHT = """
duration: 11.5 s
rate: 250 Hz
seed: 2
vehicle: hummingbird
plant: {kind: free_flight, start: [0, 0, 5]}
sensors: {grade: mems}
position_sensor: {grade: mocap}
trajectories: [{kind: hover, position: [0, 0, 5]}]
wind: [{kind: constant, velocity_mean: [3, 1, 0]}, {kind: dryden, wind_speed: 5, airspeed: 4, height: 6}]
faults: [{kind: off, channel: rotor, rotors: [3], start: 1 s, stop: 5 s}]
schemes:
  tested: {observer: none, disturbance_observer: exosystem, controller: ismc, position_controller: geometric}
"""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Told(NoDiagnosis):
    """Knows the third rotor to be off, some time after it is."""

    def init(self, inputs):
        return 0.0, super().init(inputs)

    def step(self, state, inputs, dt):
        now = state[0] + dt
        last, estimate = super().step(state[1], inputs, dt)
        off = (np.arange(4) == 2) & (OFF + LATE <= now < BACK + LATE)
        states = np.where(off, FAULTY, HEALTHY).astype(np.uint8)
        rotors = RotorEstimate(states, 1.0 - off, *[np.zeros(4)] * 3, states, off & False)
        return (now, last), estimate._replace(rotors=rotors)


@pytest.fixture(scope="module")
def flight():
    scenario = parse_scenario(FLIGHT)
    scheme = scenario.scheme(None)
    observer = dataclasses.replace(scheme.observer, law=Told(vehicle=scenario.plant.vehicle))
    return fly(scenario, scheme.model_copy(update={"observer": observer}))


def rows(flight, begin, end):
    return slice(round(begin * 250), round(end * 250))


def test_the_vehicle_spins_and_stays_at_its_place(flight):
    error = np.linalg.norm(flight.position - flight.position_reference, axis=1)
    assert np.all(flight.rotor_speeds[rows(flight, OFF + 0.5, BACK), 2] < 1.0)  # it was really off
    assert np.max(error) < 2.0
    assert np.max(error[rows(flight, OFF + 3.0, BACK)]) < 0.4
    assert np.min(np.abs(flight.body_rate[rows(flight, OFF + 3.0, BACK), 2])) > 10.0


def test_when_the_rotor_is_back_yaw_goes_back_to_its_reference(flight):
    last = rows(flight, 11.2, 11.5)
    assert np.max(np.abs(flight.body_rate[last, 2])) < 0.1
    assert np.degrees(np.max(np.abs(flight.angles[last]))) < 5.0
    error = np.linalg.norm(flight.position - flight.position_reference, axis=1)
    assert np.max(error[last]) < 0.1
