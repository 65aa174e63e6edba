"""Position errors in wind: every vehicle keeps its place with the same gains."""

import pytest

from quadftc_control.position_controller import position_controllers
from quadftc_model.vehicle import vehicle_names
from quadftc_tools.study.tracking import scenario_of, tracked

BIAS = {"kind": "bias", "channel": "accelerometer", "axes": "x", "value": 1.0, "start": 8.0}


@pytest.mark.parametrize("vehicle", vehicle_names())
def test_circle_at_two_metres_a_second_in_gusts_is_followed_within_a_tenth_of_a_metre(vehicle):
    assert 0.001 < tracked(scenario_of(vehicle, "circle", "geometric")).rms < 0.1


@pytest.mark.parametrize("controller", position_controllers.names())
def test_figure_of_eight_is_followed_by_every_position_controller(controller):
    assert 0.001 < tracked(scenario_of("x500", "figure of eight", controller)).rms < 0.1


def test_bias_of_the_accelerometer_moves_the_vehicle_by_little():
    result = tracked(scenario_of("x500", "circle", "geometric", [BIAS]))
    assert 0.001 < result.rms < 0.1
    assert result.largest < 0.2
