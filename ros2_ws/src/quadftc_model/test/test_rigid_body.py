"""The rigid body: a second derivation, and what must be conserved."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadftc_model.rigid_body import (
    angular_acceleration,
    gyroscopic_acceleration,
    propeller_momentum,
    propeller_torque,
    rk4,
)
from quadftc_model.rotations import normalise, quaternion_product, quaternion_rate
from quadftc_model.rotors import propeller_speeds
from quadftc_model.vehicle import load_vehicle, vehicle_names

RATE = st.floats(-50.0, 50.0)


def unequal_commands(vehicle):
    """Rotor commands whose propeller momenta do not cancel."""
    low, high = vehicle.rotors.command_trim, vehicle.rotors.command_max
    return np.linspace(low, high, len(vehicle.rotors.spin_sign))


def free_flight(vehicle, commands, steps=2000, dt=0.001):
    """Attitude and body rate after a tumble without torques and drag, the propellers turning."""
    vehicle = dataclasses.replace(vehicle, rotational_drag=np.zeros(3))
    zeros = np.zeros(3)

    def derivative(_time, state):
        q_xyzw, rate = state
        acceleration = angular_acceleration(vehicle, rate, zeros, propeller_momentum(vehicle, commands))
        return quaternion_rate(q_xyzw, rate), acceleration

    state = (np.array([0.0, 0.0, 0.0, 1.0]), np.array([3.0, 2.0, -4.0]))
    for _ in range(steps):
        q_xyzw, rate = rk4(derivative, 0.0, state, dt)
        state = (normalise(q_xyzw), rate)
    return state


def earth_momentum(vehicle, q_xyzw, rate, commands):
    """Angular momentum of body and propellers in earth axes [N m s]."""
    spin = np.sum(vehicle.rotors.spin_sign * propeller_speeds(vehicle, commands))
    momentum = vehicle.inertia * rate + np.array([0.0, 0.0, vehicle.rotors.rotor_inertia * spin])
    conjugate = q_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
    return quaternion_product(quaternion_product(q_xyzw, np.append(momentum, 0.0)), conjugate)[:3]


@pytest.mark.parametrize("name", vehicle_names())
@given(st.tuples(RATE, RATE, RATE).map(np.array))
def test_gyroscopic_acceleration_equals_the_vector_form(name, rate):
    inertia = load_vehicle(name).inertia
    expected = -np.cross(rate, inertia * rate) / inertia
    np.testing.assert_allclose(gyroscopic_acceleration(inertia, rate), expected, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("name", vehicle_names())
def test_propeller_torque_is_minus_omega_cross_the_momentum_of_the_rotors(name):
    vehicle, rate = load_vehicle(name), np.array([1.0, -2.0, 3.0])
    commands = unequal_commands(vehicle)
    speeds = vehicle.rotors.spin_sign * propeller_speeds(vehicle, commands)
    momentum = np.array([0.0, 0.0, vehicle.rotors.rotor_inertia * np.sum(speeds)])
    torque = propeller_torque(rate, propeller_momentum(vehicle, commands))
    np.testing.assert_allclose(torque, -np.cross(rate, momentum), rtol=1e-13)


@pytest.mark.parametrize("name", vehicle_names())
def test_angular_momentum_is_conserved_without_torque_and_drag(name):
    vehicle = load_vehicle(name)
    commands = unequal_commands(vehicle)
    before = earth_momentum(vehicle, np.array([0.0, 0.0, 0.0, 1.0]), np.array([3.0, 2.0, -4.0]), commands)
    after = earth_momentum(vehicle, *free_flight(vehicle, commands), commands)
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-9 * np.linalg.norm(before))


@pytest.mark.parametrize("name", vehicle_names())
def test_energy_is_conserved_without_torque_and_drag(name):
    vehicle = load_vehicle(name)
    _, rate = free_flight(vehicle, unequal_commands(vehicle))
    before = np.sum(vehicle.inertia * np.array([3.0, 2.0, -4.0]) ** 2)
    assert np.sum(vehicle.inertia * rate**2) == pytest.approx(before, rel=1e-9)


@pytest.mark.parametrize("name", vehicle_names())
def test_every_torque_is_divided_by_the_inertia(name):
    vehicle = load_vehicle(name)
    rotors, disturbance = np.array([0.1, -0.2, 0.3]), np.array([0.4, 0.5, -0.6])
    rates = np.array([0.0, 0.0, 3.0])  # about a principal axis: no gyroscopic torque
    trim = np.full(len(vehicle.rotors.spin_sign), vehicle.rotors.command_trim)
    momentum = propeller_momentum(vehicle, trim)
    actual = angular_acceleration(vehicle, rates, rotors + disturbance, momentum)
    expected = (rotors + disturbance - vehicle.rotational_drag * rates) / vehicle.inertia
    np.testing.assert_allclose(actual, expected, rtol=1e-14)
