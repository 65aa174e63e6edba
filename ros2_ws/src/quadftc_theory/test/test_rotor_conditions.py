"""What vehicles can do without a rotor: against closed forms and published results."""

import dataclasses

import numpy as np
import pytest
from layouts import SIXTH, circle, with_rotors

from quadftc_control.reduced_attitude import yaw_left
from quadftc_model.vehicle import load_vehicle
from quadftc_theory.conditions import Verdict
from quadftc_theory.rotor_conditions import largest_loss, rotor_conditions, steady_lift

NAMES = ("crazyflie_2x", "qball_x4", "x500", "hummingbird")


def hexarotor(layout, thrust_to_weight):
    """The X500 with six rotors; P pushes yaw one way, N the other."""
    vehicle = with_rotors(load_vehicle("x500"), circle(SIXTH), layout)
    return dataclasses.replace(vehicle, mass=vehicle.thrust_max / 9.80665 / thrust_to_weight)


@pytest.mark.parametrize("name", NAMES)
def test_largest_loss_is_that_at_which_the_diagonal_carries_less_than_its_half(name):
    vehicle = load_vehicle(name)
    rotors = vehicle.rotors
    hover = vehicle.weight / 4.0 / (rotors.thrust_coefficient * rotors.speed_max**2)
    assert largest_loss(vehicle, 0, 0.0) == pytest.approx(1.0 - hover, abs=0.011)


@pytest.mark.parametrize("name", NAMES)
def test_no_steady_flight_lifts_more_than_three_rotors_or_less_than_two_about_body_z(name):
    vehicle = load_vehicle(name)
    lift, _ = steady_lift(vehicle, 0)
    assert 0.5 * vehicle.thrust_to_weight - 1e-2 <= lift < 0.75 * vehicle.thrust_to_weight


def test_x500_comes_down_without_a_rotor_and_hummingbird_flies_on():
    verdicts = {
        name: [each.verdict for each in rotor_conditions(load_vehicle(name), [0])][1] for name in NAMES
    }
    assert verdicts == {
        "crazyflie_2x": Verdict.DEPENDS,
        "qball_x4": Verdict.DEPENDS,
        "x500": Verdict.FAIL,
        "hummingbird": Verdict.PASS,
    }


def test_only_a_rotor_that_is_lost_fails_the_check():
    conditions = list(rotor_conditions(load_vehicle("x500"), [2]))
    assert [each.name for each in conditions if each.failed] == ["rotor 3 off"]


def test_hexarotor_is_forced_to_spin_by_its_layout():
    """Du et al. (2015): PNPNPN by any rotor; PPNNPN by the last two alone."""
    for layout, spins in (("PNPNPN", {0, 1, 2, 3, 4, 5}), ("PPNNPN", {4, 5})):
        vehicle = hexarotor(layout, 2.5)
        left = yaw_left(vehicle, 1.0 - np.eye(6))
        assert set(np.flatnonzero(left < 0.1).tolist()) == spins
