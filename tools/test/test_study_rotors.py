"""The study of rotor diagnosis: what it makes of what an observer says."""

from types import SimpleNamespace

import numpy as np
import pytest

from quadftc_model.samples import FAULTY, HEALTHY
from quadftc_tools.study.rotors import SENSORS, hear, loss_row
from quadftc_tools.study.rotors_flights import DURATION, ONSET, RATE, Case, case_of, weak_rotor

ROWS, BEGIN = round(DURATION * RATE), round(ONSET * RATE)


def said(rotor=None, sensor=None, delay=10, loss=0.25):
    """What an observer says that names one rotor or sensor, ``delay`` samples after the onset."""
    states = {f"{name}_state": np.full((ROWS, 3), HEALTHY) for name in SENSORS}
    rotors, left = np.full((ROWS, 4), HEALTHY), np.ones((ROWS, 4))
    if sensor is not None:
        states[f"{sensor}_state"][BEGIN + delay :, 0] = FAULTY
    if rotor is not None:
        rotors[BEGIN + delay :, rotor], left[BEGIN + delay :, rotor] = FAULTY, 1.0 - loss
    clear = np.zeros((ROWS, 3), np.bool_)
    watched = {"attitude_ambiguous": clear, "gyro_ambiguous": clear, **states}
    return SimpleNamespace(rotor_state=rotors, rotor_estimate=left, **watched)


def test_delay_and_error_of_a_rotor_are_measured():
    case = Case(None, "rotor", 2, 0.3)
    heard = hear(case, said(rotor=2))
    assert heard.rotors[2] == pytest.approx(0.04)
    assert heard.error == pytest.approx(-0.05)
    row = loss_row("30 %", [case], [heard])
    assert row == ("30 %", "1", "100 %", "0 %", "0 %", "40 / 40 ms", "5 % / 5 %")


def test_wrong_rotor_and_sensor_count_as_such():
    case = Case(None, "rotor", 2, 0.3)
    assert loss_row("", [case], [hear(case, said(rotor=1, sensor="gyro"))])[2:5] == ("0 %", "100 %", "100 %")


def test_scenario_of_a_drawn_flight_has_its_fault():
    case = case_of(3, "rotor", weak_rotor(0.2, 0.3))
    assert 0.2 <= case.loss <= 0.3
    assert [fault.injection.channel for fault in case.scenario.faults] == ["rotor"]
