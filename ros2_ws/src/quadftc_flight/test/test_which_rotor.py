"""Which rotor is named: judged on a flight made by hand."""

import dataclasses

import numpy as np
import pytest

from quadftc_flight.diagnosis_metrics.which_rotor import rotor_confusion
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import VECTORS, unknown_flight
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.scenario import ScenarioError, parse_scenario
from quadftc_model.samples import FAULTY, HEALTHY

SCENARIO = """
duration: 20 s
rate: 100 Hz
vehicle: x500
plant: {kind: free_flight}
trajectories: [{kind: hover, position: [0, 0, 1]}]
faults:
  - {kind: loss, channel: rotor, rotors: [2], value: 30 %, start: 2 s, stop: 6 s}
schemes: {plain: {controller: pid, checks: [{metric: rotors.naming_delay_max_s, below: 1}]}}
"""


def judged(**columns):
    """Metrics of a flight of 20 s at 100 Hz on which rotor 2 loses 30 % between 2 and 6 s."""
    flight = unknown_flight(10**9 + np.arange(2000) * 10**7, 4)
    columns = {**{name: np.zeros((2000, 3)) for name in VECTORS}, **columns}
    truth = np.ones((2000, 4))
    truth[200:600, 1] = 0.7
    healthy = np.full((2000, 4), HEALTHY, np.uint8)
    known = {"fault_state": healthy[:, :3], "rotor_effectiveness": truth, "rotor_state": healthy}
    known |= {"rotor_estimate": np.ones((2000, 4))}
    flight = dataclasses.replace(flight, **{**known, **columns})
    event = FaultEvent("2", "loss", 2.0, 6.0, "rotor")
    return flight_metrics(flight, (), (), [event])["rotors"]


def test_a_rotor_named_late_and_a_healthy_one_named():
    state, estimate = np.full((2000, 4), HEALTHY, np.uint8), np.ones((2000, 4))
    state[210:600, 1] = FAULTY
    estimate[210:600, 1] = 0.72
    state[700:750, 3] = FAULTY  # nothing is wrong with it
    found = judged(rotor_state=state, rotor_estimate=estimate)
    assert (found["rotor_faults"], found["unnamed"], found["misnamed"]) == (1, 0, 0)
    assert found["naming_delay_max_s"] == pytest.approx(0.1)
    assert found["size_error_max"] == pytest.approx(0.02)
    assert (found["false_namings"], found["false_naming_time_s"]) == (1, pytest.approx(0.5))
    of_rotor = found["confusion_s"]["rotor"]
    assert (of_rotor["faulty_rotor"], of_rotor["none"], of_rotor["time"]) == pytest.approx((3.9, 0.1, 4.0))
    # the 5 s after the end of a fault count for nothing
    assert found["confusion_s"]["none"]["time"] == pytest.approx(2.0 + 9.0)


def test_the_wrong_rotor_and_a_sensor_are_misnamed():
    state = np.full((2000, 4), HEALTHY, np.uint8)
    state[300:400, 0] = FAULTY
    gyro = np.full((2000, 3), HEALTHY, np.uint8)
    gyro[400:500, 0] = FAULTY
    found = judged(rotor_state=state, gyro_state=gyro)
    assert (found["unnamed"], found["misnamed"], found["false_namings"]) == (1, 1, 1)
    assert found["events"][0]["misnamed_share"] == pytest.approx(0.5)
    of_rotor = found["confusion_s"]["rotor"]
    assert (of_rotor["healthy_rotor"], of_rotor["sensor"]) == pytest.approx((1.0, 1.0))


def test_a_sample_with_two_kinds_of_faults_does_not_count():
    yes, no = np.array([True, False]), np.zeros(2, bool)
    assert not rotor_confusion(yes, yes, np.True_, np.True_).any()
    assert rotor_confusion(yes, no, np.False_, np.False_)[2, 3]


def test_the_schedule_of_rotors_is_that_of_the_scenario():
    scenario = parse_scenario(SCENARIO)
    assert scenario.rotor_events == (FaultEvent("2", "loss", 2.0, 6.0, "rotor"),)
    assert scenario.fault_events == ()
    assert scenario.faults[0].spec.startswith("loss channel=rotor rotors=2 start=2.0 stop=6.0")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["faults.0.rotors=[5]"], "faults[0].rotors: 5 is no rotor; expected numbers from 1 to 4"),
        (["faults.0.value=1.3"], "1.3: must be within [0, 1]"),
        (["plant.kind=test_stand", "trajectories=[]"], "faults[0].channel: 'rotor': only in free flight"),
        (["faults.0.kind=bias"], "no rotor fault 'bias'"),
    ],
)
def test_what_is_no_rotor_fault_is_refused_with_its_key(changes, words):
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(SCENARIO, overrides=changes)
    assert words in str(caught.value)
