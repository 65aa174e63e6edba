"""Mixer, allocation and the torques that the rotors can give."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadftc_model.rotors import attainable, commands_from_torque, propeller_speeds, torque_from_commands
from quadftc_model.vehicle import load_vehicle, vehicle_names


def lopsided():
    """A vehicle without any symmetry, for what symmetry would hide."""
    qball = load_vehicle("qball_x4")
    positions = np.array([[-0.25, 0.05], [0.2, 0.1], [0.1, 0.05], [-0.05, -0.2]])
    return dataclasses.replace(
        qball, name="lopsided", rotors=dataclasses.replace(qball.rotors, positions=positions)
    )


VEHICLES = [*map(load_vehicle, vehicle_names()), lopsided()]
EVERY_VEHICLE = pytest.mark.parametrize("vehicle", VEHICLES, ids=lambda vehicle: vehicle.name)
SHARES = st.tuples(*[st.one_of(st.floats(-3.0, 3.0), st.sampled_from([0.0, 1.0, -1.0, 1e6, -1e6]))] * 3).map(
    np.array
)


def test_mixer_of_the_qball_is_the_matrix_of_equation_2():
    K_u, L_d, K_y = 120.0, 0.2, 4.0
    matrix = [[0, 0, K_u * L_d, -K_u * L_d], [K_u * L_d, -K_u * L_d, 0, 0], [K_y, K_y, -K_y, -K_y]]
    assert np.array_equal(load_vehicle("qball_x4").mixer, matrix)


def test_authority_of_the_qball_is_that_of_equation_2():
    np.testing.assert_allclose(load_vehicle("qball_x4").authority, [1.2, 1.2, 0.4], rtol=1e-12)


@EVERY_VEHICLE
def test_allocation_inverts_the_mixer(vehicle):
    np.testing.assert_allclose(vehicle.mixer @ vehicle.allocation, np.eye(3), atol=1e-12)


@EVERY_VEHICLE
def test_commands_give_the_torque_that_they_were_made_for(vehicle):
    torque = attainable(vehicle, vehicle.authority * np.array([0.3, -0.2, 0.4]))
    given_torque = torque_from_commands(vehicle, commands_from_torque(vehicle, torque))
    np.testing.assert_allclose(given_torque, torque, atol=1e-12 * np.max(vehicle.authority))


@EVERY_VEHICLE
@given(SHARES)
def test_attainable_torque_is_within_the_limits_of_every_rotor(vehicle, share):
    torque = attainable(vehicle, vehicle.authority * share)
    moves = vehicle.allocation @ torque
    assert np.all(np.abs(moves) <= vehicle.command_room * (1.0 + 1e-9))


@pytest.mark.parametrize("vehicle", VEHICLES[:-1], ids=vehicle_names())
@given(SHARES)
def test_attainable_torque_inside_is_unchanged_bit_for_bit(vehicle, share):
    torque = vehicle.authority * share
    torque *= (
        0.999 * vehicle.command_room / max(vehicle.command_room, np.max(np.abs(vehicle.allocation @ torque)))
    )
    assert np.array_equal(attainable(vehicle, torque), torque)


@EVERY_VEHICLE
@given(SHARES)
def test_attainable_gives_tilt_before_yaw(vehicle, share):
    torque = vehicle.authority * share
    without_yaw = attainable(vehicle, torque * np.array([1.0, 1.0, 0.0]))
    assert np.array_equal(attainable(vehicle, torque)[:2], without_yaw[:2])


@EVERY_VEHICLE
@given(SHARES)
def test_attainable_never_turns_a_torque_round(vehicle, share):
    torque = vehicle.authority * share
    result = attainable(vehicle, torque)
    assert np.all(result * torque >= 0.0)
    assert np.all(np.abs(result) <= np.abs(torque))


@EVERY_VEHICLE
@given(SHARES)
def test_attainable_leaves_yaw_what_room_there_is(vehicle, share):
    torque = attainable(vehicle, vehicle.authority * share)
    yaw_cut = abs(torque[2]) < min(abs(vehicle.authority[2] * share[2]), vehicle.authority[2]) * (1.0 - 1e-9)
    full = np.max(np.abs(vehicle.allocation @ torque)) >= vehicle.command_room * (1.0 - 1e-9)
    assert full or not yaw_cut


@EVERY_VEHICLE
def test_propeller_speed_gives_the_thrust_of_the_command(vehicle):
    rotors = vehicle.rotors
    commands = np.linspace(rotors.command_min, rotors.command_max, 5)
    thrust = rotors.thrust_coefficient * propeller_speeds(vehicle, commands) ** 2
    expected = rotors.thrust_gain * np.maximum(commands - rotors.command_idle, 0.0)
    np.testing.assert_allclose(thrust, expected, rtol=1e-12)
