"""The plant against an independent integration, and what it keeps."""

import dataclasses

import numpy as np
import pytest
from sampling import sampled
from scipy.integrate import solve_ivp

from quadftc_model.parameters import build
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.vehicle import load_vehicle, vehicle_names
from quadftc_sim.disturbance import disturbances
from quadftc_sim.plants.test_stand import AttitudeStand

DT, STEPS = 0.004, 100
ANGLES, RATE = np.array([0.2, -0.3, 0.5]), np.array([0.4, -0.6, 0.3])
# torques as angular accelerations [rad/s²], to fit a vehicle of any size; the third is too much for the Qball
STEPS_WANTED = np.array([[12.0, -8.0, 4.0], [-20.0, 4.0, 2.0], [36.0, 36.0, -9.0], [0.0, 16.0, -3.0]])


def plant(name, **options):
    """A plant in two disturbances."""
    vehicle = load_vehicle(name)
    size = vehicle.inertia * np.array([8.0, 8.0, 2.0])
    sine = build(disturbances.get("sine"), {"amplitude": list(size), "frequency": [2.0, 3.0, 4.0]})
    constant = build(disturbances.get("constant"), {"amplitude": list(-0.5 * size)})
    return AttitudeStand(vehicle=vehicle, disturbances=(sine, constant), **options)


def torque_at(vehicle, index):
    return vehicle.inertia * STEPS_WANTED[index * len(STEPS_WANTED) // STEPS]


def flown(plant):
    state = plant.init(quaternion_from_euler(ANGLES), RATE)
    for index in range(STEPS):
        state = plant.step(state, torque_at(plant.vehicle, index), index * DT, DT)
    return state


def equations(plant, time, state, wanted):
    """Equations (1), (2) and (4) written out again, with Euler angles in place of the quaternion."""
    vehicle, rotors = plant.vehicle, plant.vehicle.rotors
    (phi, theta, _), omega, commands = state[:3], state[3:6], state[6:] if plant.motor_lag else wanted
    kinematics = np.array(
        [
            [1.0, np.sin(phi) * np.tan(theta), np.cos(phi) * np.tan(theta)],
            [0.0, np.cos(phi), -np.sin(phi)],
            [0.0, np.sin(phi) / np.cos(theta), np.cos(phi) / np.cos(theta)],
        ]
    )
    angle_rates = kinematics @ omega
    thrust = rotors.thrust_gain * np.maximum(commands - rotors.command_idle, 0.0)
    lift = np.stack([np.zeros_like(thrust), np.zeros_like(thrust), thrust], axis=-1)
    arms = np.column_stack([rotors.positions, np.zeros(len(thrust))])
    torque = np.sum(np.cross(arms, lift), axis=0)
    torque[2] += np.sum(rotors.yaw_sign * rotors.yaw_gain * commands)
    speeds = np.sqrt(thrust / rotors.thrust_coefficient)
    momentum = np.array([0.0, 0.0, rotors.rotor_inertia * np.sum(rotors.spin_sign * speeds)])
    torque += -np.cross(omega, momentum) - vehicle.rotational_drag * omega
    torque += sum(disturbance.at(time) for disturbance in plant.disturbances)
    inertia = vehicle.inertia * np.array(plant.inertia_factor)
    omega_dot = (torque - np.cross(omega, inertia * omega)) / inertia
    bandwidth = plant.motor_bandwidth or 1.0 / rotors.time_constant
    lag = (wanted - commands) * bandwidth if plant.motor_lag else np.zeros(0)
    return np.concatenate([angle_rates, omega_dot, lag])


def integrated(plant):
    """The same flight by an integrator of order 8 with a tight tolerance, one call for each held torque."""
    rotors = plant.vehicle.rotors
    trim = np.full(len(rotors.yaw_sign), rotors.command_trim)
    state = np.concatenate([ANGLES, RATE, trim if plant.motor_lag else []])
    length = DT * STEPS / len(STEPS_WANTED)
    for index, acceleration in enumerate(STEPS_WANTED):
        move = plant.vehicle.allocation @ (plant.vehicle.inertia * acceleration)
        wanted = np.clip(trim + move, rotors.command_min, rotors.command_max)
        span = (index * length, (index + 1) * length)
        state = solve_ivp(
            lambda t, x, wanted=wanted: equations(plant, t, x, wanted),
            span,
            state,
            "DOP853",
            rtol=1e-12,
            atol=1e-13,
        ).y[:, -1]
    return state


MOTORS = [(False, 0.0), (True, 0.0), (True, 40.0)]  # lag, bandwidth
INERTIAS = [(1.0, 1.0, 1.0), (0.7, 1.3, 1.1)]


@pytest.mark.parametrize(
    ("name", "inertia_factor", "motors"), sampled(vehicle_names(), INERTIAS, MOTORS, every=5)
)
def test_plant_agrees_with_an_independent_integration(name, inertia_factor, motors):
    motor_lag, bandwidth = motors
    options = {"motor_lag": motor_lag, "motor_bandwidth": bandwidth, "inertia_factor": inertia_factor}
    law = plant(name, substeps=10, **options)
    state, expected = flown(law), integrated(law)
    np.testing.assert_allclose(euler_from_quaternion(state.q_xyzw), expected[:3], atol=1e-8)
    np.testing.assert_allclose(state.body_rate, expected[3:6], rtol=0.0, atol=1e-8)
    if motor_lag:
        np.testing.assert_allclose(state.commands, expected[6:], atol=1e-8)


def test_error_of_the_plant_falls_with_order_four():
    exact = integrated(plant("qball_x4"))[3:6]
    errors = [np.max(np.abs(flown(plant("qball_x4", substeps=n)).body_rate - exact)) for n in (1, 2)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize("name", vehicle_names())
def test_attitude_stays_a_unit_quaternion(name):
    assert np.linalg.norm(flown(plant(name)).q_xyzw) == pytest.approx(1.0, abs=1e-15)


def test_level_vehicle_at_trim_stays_at_rest():
    law = AttitudeStand(vehicle=load_vehicle("qball_x4"), motor_lag=True)
    state = law.init(quaternion_from_euler(np.zeros(3)), np.zeros(3))
    for _ in range(100):
        state = law.step(state, np.zeros(3), 0.0, DT)
    np.testing.assert_allclose(state.body_rate, np.zeros(3), atol=1e-12)


def test_thrust_follows_a_step_with_the_time_constant_of_the_vehicle():
    vehicle = load_vehicle("qball_x4")
    law = AttitudeStand(vehicle=vehicle, motor_lag=True)
    state = law.init(quaternion_from_euler(np.zeros(3)), np.zeros(3))
    torque = 0.5 * vehicle.authority * np.array([1.0, 0.0, 0.0])
    for index in range(20):
        state = law.step(state, torque, index * DT, DT)
    share = (vehicle.mixer @ state.commands)[0] / torque[0]
    assert share == pytest.approx(1.0 - np.exp(-20 * DT / vehicle.rotors.time_constant), rel=1e-6)


def test_bandwidth_without_a_lag_is_refused():
    with pytest.raises(ValueError, match="motor_bandwidth = 20 rad/s: motor_lag is false"):
        AttitudeStand(vehicle=load_vehicle("qball_x4"), motor_bandwidth=20.0)


def test_disturbance_is_the_sum_of_its_parts():
    law = plant("qball_x4")
    expected = law.disturbances[0].at(0.7) + law.disturbances[1].at(0.7)
    np.testing.assert_array_equal(law.disturbance(0.7, np.zeros(3)), expected)
    assert dataclasses.replace(law, disturbances=()).disturbance(0.7, np.zeros(3)).tolist() == [0.0, 0.0, 0.0]
