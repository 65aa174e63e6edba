"""Frames of autopilots: angles, rates and gravity keep their meaning; torques come out of PX4's mixer."""

import math

import numpy as np
import pytest

from quadftc_model.autopilots import ardupilot_imu, px4_full_torque, px4_imu, px4_torque, tilt_disagreement
from quadftc_model.frames import enu_flu_from_ned_frd, enu_from_ned, flu_from_frd
from quadftc_model.rotations import (
    euler_from_quaternion,
    quaternion_from_euler,
    quaternion_from_rotation_vector,
    quaternion_product,
    to_earth,
    wrap,
)
from quadftc_model.vehicle import load_vehicle

ANGLES = np.random.default_rng(3).uniform([-3.0, -1.5, -3.0], [3.0, 1.5, 3.0], (50, 3))  # roll, pitch, yaw
AIRCRAFT = np.roll(quaternion_from_euler(ANGLES), 1, axis=-1)  # w first; the formulas are the same in NED


def test_roll_stays_pitch_turns_and_yaw_counts_from_east():
    angles = euler_from_quaternion(enu_flu_from_ned_frd(AIRCRAFT))
    expected = np.stack([ANGLES[:, 0], -ANGLES[:, 1], math.pi / 2 - ANGLES[:, 2]], axis=-1)
    assert np.allclose(wrap(angles - expected), 0.0, atol=1e-9)


def test_vectors_turned_to_the_earth_first_or_last_are_the_same():
    vectors = np.random.default_rng(4).normal(size=ANGLES.shape)
    in_ned = to_earth(np.roll(AIRCRAFT, -1, axis=-1), vectors)
    assert np.allclose(enu_from_ned(in_ned), to_earth(enu_flu_from_ned_frd(AIRCRAFT), flu_from_frd(vectors)))
    assert np.array_equal(flu_from_frd(flu_from_frd(vectors)), vectors)


def test_attitude_turns_as_the_gyro_says():
    rate, dt = np.array([0.3, -0.2, 0.5]), 1e-3  # FRD
    later = quaternion_product(np.roll(AIRCRAFT, -1, axis=-1), quaternion_from_rotation_vector(rate * dt))
    turned = quaternion_product(
        enu_flu_from_ned_frd(AIRCRAFT), quaternion_from_rotation_vector(flu_from_frd(rate) * dt)
    )
    assert np.allclose(enu_flu_from_ned_frd(np.roll(later, 1, axis=-1)), turned, atol=1e-12)


def test_level_vehicle_that_looks_north_has_yaw_from_east_and_gravity_up():
    sample = px4_imu(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, -9.81]))
    assert np.allclose(euler_from_quaternion(sample.q_xyzw), [0.0, 0.0, math.pi / 2])
    assert np.allclose(sample.specific_force, [0.0, 0.0, 9.81])
    assert sample.attitude_valid
    assert not px4_imu(np.full(4, np.nan), np.zeros(3), np.zeros(3)).attitude_valid


@pytest.mark.parametrize("w_first", [True, False])
def test_gravity_tells_in_which_order_ardupilot_writes_its_attitude(w_first):
    q_wxyz = np.roll(quaternion_from_euler(np.array([0.1, 0.2, 1.0])), 1)
    down = flu_from_frd(px4_imu(q_wxyz, np.zeros(3), np.zeros(3)).specific_force)
    level = px4_imu(q_wxyz, np.zeros(3), down)
    force = -9.81 * np.array([-math.sin(0.2), math.sin(0.1) * math.cos(0.2), math.cos(0.1) * math.cos(0.2)])
    fields = q_wxyz if w_first else np.roll(q_wxyz, -1)
    right, wrong = (ardupilot_imu(fields, np.zeros(3), force, order) for order in (w_first, not w_first))
    assert np.allclose(right.q_xyzw, level.q_xyzw)
    assert tilt_disagreement(right) < 1e-6
    assert tilt_disagreement(wrong) > math.radians(30.0)


@pytest.mark.parametrize("name", ["x500", "crazyflie_2x"])
def test_setpoint_of_px4_becomes_the_torque_that_was_asked_for(name):
    """As PX4 does it: pseudo-inverse in FRD, normalised, times the setpoint, into thrusts of the rotors."""
    vehicle = load_vehicle(name)
    full = vehicle.rotors.thrust_gain * (vehicle.rotors.command_max - vehicle.rotors.command_idle)
    effect = vehicle.effectiveness[1:] * full * np.array([[1.0], [-1.0], [-1.0]])  # torques in FRD
    six = np.concatenate([effect, np.zeros((2, effect.shape[1])), -full * np.ones((1, effect.shape[1]))])
    mix = np.linalg.pinv(six)
    sizes = [math.sqrt(np.sum(mix[:, axis] ** 2) / (effect.shape[1] / 2)) for axis in (0, 1)]
    mix[:, :2] /= max(sizes)
    mix[:, 2] /= np.max(mix[:, 2])
    mix[:, 5] /= np.mean(np.abs(mix[:, 5]))
    wanted, thrust = np.array([0.03, -0.02, 0.004]) * full * vehicle.rotors.positions.max(), 2.0 * full
    setpoint = np.zeros(6)
    setpoint[:3] = px4_torque(wanted, px4_full_torque(vehicle))
    setpoint[5] = -thrust / vehicle.thrust_max
    commands = mix @ setpoint  # of full thrust
    assert np.allclose(flu_from_frd(effect @ commands), wanted)
    assert np.sum(commands) * full == pytest.approx(thrust)
    assert np.all(np.abs(px4_torque(1e3 * wanted, px4_full_torque(vehicle), 0.3)) <= 0.3)
