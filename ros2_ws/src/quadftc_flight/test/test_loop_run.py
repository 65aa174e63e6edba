"""A flight of the closed loop, written as a bag and read again, is the same flight."""

import dataclasses

import numpy as np
import pytest

from quadftc_flight.closed_loop import fly
from quadftc_flight.loop_run import run_loop
from quadftc_flight.run_directory import read_run
from quadftc_flight.scenario import find_scenario, load_scenario


# on the test stand; with rotors and position in free flight
@pytest.mark.parametrize("name", ["gyro_faults", "free_circle"])
def test_bag_of_the_loop_holds_its_flight_bit_for_bit(name, tmp_path):
    dropout = "{kind: dropout, channel: imu, probability: 0.3, start: 0.5 s, stop: 1 s}"
    bias = "{kind: bias, channel: gyro, axes: roll, value: 0.3, start: 1 s}"
    changes = [f"faults=[{dropout}, {bias}]", "duration=2 s"]
    changes.append("trajectories=[{kind: hover}]" if name == "free_circle" else "references=[]")
    scenario = load_scenario(find_scenario(name), changes)
    result = run_loop(scenario, scenario.scheme(None), tmp_path, "c")
    run, flown = read_run(tmp_path / result["bag"]), fly(scenario)
    assert (run.warnings, run.summary["metrics"]) == ((), result["metrics"])
    assert not flown.delivered.all()
    for field in dataclasses.fields(flown):
        np.testing.assert_array_equal(getattr(run.flight, field.name), getattr(flown, field.name), field.name)
