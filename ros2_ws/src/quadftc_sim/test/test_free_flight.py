"""Free flight against closed forms and an independent integration, and what the ground carries."""

import dataclasses

import numpy as np
import pytest
from in_c import moving
from sampling import sampled
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quadftc_model.parameters import build
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import AIR_DENSITY, STANDARD_GRAVITY
from quadftc_model.vehicle import load_vehicle, vehicle_names
from quadftc_sim.disturbance import disturbances
from quadftc_sim.flying_plant import FlightState
from quadftc_sim.plants.free_flight import SINKING, FreeFlight
from quadftc_sim.wind import winds

DT = 0.004
HIGH = (3.0, -2.0, 50.0)  # m, far above the ground
ANGLES, RATE = np.array([0.2, -0.3, 0.5]), np.array([0.4, -0.6, 0.3])
STILL = FreeFlight(vehicle=load_vehicle("qball_x4"), start=HIGH)
BARE = dataclasses.replace(
    STILL.vehicle,
    rotational_drag=np.zeros(3),
    aerodynamics=dataclasses.replace(STILL.vehicle.aerodynamics, rotor_drag=0.0, drag_area=np.zeros(3)),
)


def flown(plant, state, speeds, count, dt=DT):
    step = moving(plant, len(speeds)) if np.ndim(speeds) == 1 and count > 100 else plant.step
    for index in range(count):
        state = step(state, speeds, index * dt, dt)
    return state


def windy(name, **options):
    """A plant in wind and two disturbances."""
    vehicle = load_vehicle(name)
    sine = build(disturbances.get("sine"), {"amplitude": list(vehicle.inertia), "frequency": [2.0, 3.0, 4.0]})
    air = build(winds.get("constant"), {"velocity_mean": [3.0, -2.0, 0.5]})
    return FreeFlight(vehicle=vehicle, disturbances=(sine,), winds=(air,), start=HIGH, **options)


def wanted_speeds(vehicle):
    return vehicle.hover_speed * np.array([1.05, 0.98, 1.1, 1.0])


def equations(plant, time, state, wanted):
    """The equations of motion written out again, with matrices and cross products."""
    vehicle, rotors = plant.vehicle, plant.vehicle.rotors
    velocity, q, omega, speeds = state[3:6], state[6:10], state[10:13], state[13:]
    turn = Rotation.from_quat(q).as_matrix()
    thrust = rotors.thrust_coefficient * speeds**2
    spin_up = (wanted - speeds) / plant.motor_time_constant
    lift = np.stack([np.zeros(len(thrust)), np.zeros(len(thrust)), thrust], axis=-1)
    arms = np.column_stack([rotors.positions, np.zeros(len(thrust))])
    torque = np.sum(np.cross(arms, lift), axis=0)
    torque[2] += np.sum(rotors.yaw_sign * thrust) * rotors.yaw_gain / rotors.thrust_gain
    torque[2] -= rotors.rotor_inertia * np.sum(rotors.spin_sign * spin_up)
    momentum = np.array([0.0, 0.0, rotors.rotor_inertia * np.sum(rotors.spin_sign * speeds)])
    torque += sum(each.at(time) for each in plant.disturbances) - vehicle.rotational_drag * omega
    inertia = plant.inertia
    omega_dot = (torque - np.cross(omega, inertia * omega + momentum)) / inertia
    air = velocity - sum(each.at(time) for each in plant.winds)
    relative = turn.T @ air
    body, flat = vehicle.aerodynamics, np.array([1.0, 1.0, 0.0])
    drag = -body.rotor_drag * np.sum(speeds) * flat * relative
    drag -= 0.5 * AIR_DENSITY * body.drag_area * np.abs(relative) * relative
    force = drag + np.array([0.0, 0.0, np.sum(thrust)])
    acceleration = turn @ force / vehicle.mass - np.array([0.0, 0.0, STANDARD_GRAVITY])
    product = Rotation.from_quat(
        q
    ).as_matrix()  # q' = q (omega, 0) / 2, by the vector part and the scalar part
    assert np.allclose(product, turn)
    q_dot = 0.5 * np.append(q[3] * omega + np.cross(q[:3], omega), -q[:3] @ omega)
    return np.concatenate([velocity, acceleration, q_dot, omega_dot, spin_up])


@pytest.mark.parametrize("name", vehicle_names())
def test_flight_with_drag_wind_and_motor_lag_equals_an_independent_integration(name):
    plant = windy(name)
    start = plant.init(quaternion_from_euler(ANGLES), RATE)
    wanted, count = wanted_speeds(plant.vehicle), 100
    found = solve_ivp(
        lambda time, state: equations(plant, time, state, wanted),
        (0.0, count * DT),
        np.concatenate(start[:5]),
        method="DOP853",
        rtol=1e-11,
        atol=1e-12,
    )
    state = np.concatenate(flown(plant, start, wanted, count)[:5])
    np.testing.assert_allclose(state, found.y[:, -1], rtol=2e-6, atol=2e-6)


def test_free_fall_is_that_of_the_closed_form():
    plant = dataclasses.replace(STILL, vehicle=BARE, motor_lag=False)
    state = plant.init(quaternion_from_euler(ANGLES), RATE)._replace(velocity=np.array([1.0, 2.0, 3.0]))
    after = flown(plant, state, np.zeros(4), 250)
    fallen = np.array(HIGH) + np.array([1.0, 2.0, 3.0]) - np.array([0.0, 0.0, 0.5 * STANDARD_GRAVITY])
    np.testing.assert_allclose(after.position, fallen, atol=1e-9)
    np.testing.assert_allclose(plant.specific_force(after, 1.0), 0.0, atol=1e-12)


def test_energy_and_angular_momentum_are_kept_without_drag():
    plant = dataclasses.replace(STILL, vehicle=BARE, motor_lag=False)
    state = plant.init(quaternion_from_euler(ANGLES), np.array([2.0, -3.0, 1.0]))

    def kept(state: FlightState):
        momentum = Rotation.from_quat(state.q_xyzw).apply(plant.inertia * state.body_rate)
        turning = 0.5 * np.sum(plant.inertia * state.body_rate**2)
        moving = 0.5 * BARE.mass * np.sum(state.velocity**2)
        return [*momentum, turning + moving + BARE.mass * STANDARD_GRAVITY * state.position[2]]

    np.testing.assert_allclose(kept(flown(plant, state, np.zeros(4), 500)), kept(state), rtol=1e-9)


def test_fall_with_drag_ends_at_the_terminal_velocity():
    plant = dataclasses.replace(STILL, start=(0.0, 0.0, 5000.0), motor_lag=False)
    area = plant.vehicle.aerodynamics.drag_area[2]
    terminal = np.sqrt(2.0 * plant.vehicle.mass * STANDARD_GRAVITY / (AIR_DENSITY * area))
    level = plant.init(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))
    after = flown(plant, level, np.zeros(4), 1600, dt=0.02)
    assert after.velocity[2] == pytest.approx(-terminal, rel=1e-3)


@pytest.mark.parametrize("name", vehicle_names())
def test_hover_speed_carries_the_vehicle(name):
    plant = FreeFlight(vehicle=load_vehicle(name), start=HIGH)
    state = plant.init(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))
    after = flown(plant, state, plant.first_command, 250)
    np.testing.assert_allclose(after.position, HIGH, atol=1e-9)
    np.testing.assert_allclose(plant.specific_force(after, 1.0), [0.0, 0.0, STANDARD_GRAVITY], atol=1e-9)


@pytest.mark.parametrize("name", sampled(vehicle_names(), every=3))
def test_ground_carries_a_vehicle_that_falls_on_it(name):
    plant = FreeFlight(vehicle=load_vehicle(name))
    state = plant.init(quaternion_from_euler(np.array([0.2, 0.1, 0.3])), np.zeros(3))
    after = flown(plant, state, np.zeros(plant.command_size), 1500)
    np.testing.assert_allclose(plant.specific_force(after, 0.0), [0.0, 0.0, STANDARD_GRAVITY], atol=1e-6)
    assert np.abs(after.velocity).max() < 1e-6
    idle = np.sum(wrench_from_speeds(plant.vehicle, after.speeds)[1])
    sunk = SINKING * (1.0 - idle / (plant.vehicle.mass * STANDARD_GRAVITY))
    assert after.position[2] == pytest.approx(-plant.feet[0, 2] - sunk, abs=1e-6)
    assert np.hypot(*after.position[:2]) < 0.5


def test_accelerometer_off_the_centre_feels_the_rotation():
    body = dataclasses.replace(BARE.aerodynamics, imu_position=np.array([0.1, 0.0, 0.0]))
    plant = dataclasses.replace(STILL, vehicle=dataclasses.replace(BARE, aerodynamics=body), motor_lag=False)
    state = plant.init(np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 3.0]))
    force = plant.specific_force(state._replace(speeds=np.zeros(4)), 0.0)
    np.testing.assert_allclose(force, [-0.9, 0.0, 0.0], atol=1e-12)
