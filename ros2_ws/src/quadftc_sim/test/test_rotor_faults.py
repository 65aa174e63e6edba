"""Rotor faults: their laws, their schedule, and what a vehicle in free flight makes of them."""

import functools
import math

import numpy as np
import pytest

from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import level_sample
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.injection import make_injection
from quadftc_sim.injector import FaultInjector
from quadftc_sim.plants.free_flight import FreeFlight
from quadftc_sim.rotor_fault import healthy_rotors, true_effectiveness, with_fault

DT = 0.004
VEHICLE = load_vehicle("x500")
ROTORS = VEHICLE.rotors
PLANT = FreeFlight(vehicle=VEHICLE, start=(0.0, 0.0, 50.0))
HOVER = np.full(4, VEHICLE.hover_speed)


def fault(kind, **values):
    return make_injection(kind, {"channel": "rotor", "rotors": [1], **values}, rotors=4)


def condition(*faults, time=1.0):
    found = healthy_rotors(np.zeros((*np.shape(time), 4)))
    return functools.reduce(lambda before, each: with_fault(before, each, time), faults, found)


def hovering(plant, *faults):
    return plant.with_rotors(plant.init(quaternion_from_euler(np.zeros(3)), np.zeros(3)), condition(*faults))


def test_a_ramp_grows_evenly_and_ends():
    ramp = fault("loss", value=0.4, rise=2.0, start=1.0, stop=9.0)
    found = [condition(ramp, time=time).effectiveness[0] for time in (0.9, 1.0, 2.0, 3.0, 8.0, 9.0)]
    np.testing.assert_allclose(found, [1.0, 1.0, 0.8, 0.6, 0.6, 1.0], rtol=1e-15)


def test_faults_of_one_rotor_add_up():
    together = condition(
        fault("loss", value=0.5), fault("chipped", value=0.2, unbalance=1e-6), fault("off", rotors=[3])
    )
    np.testing.assert_allclose(true_effectiveness(together), [0.4, 1.0, 0.0, 1.0])
    np.testing.assert_array_equal(together.unbalance, [1e-6, 0.0, 0.0, 0.0])


def test_many_flights_have_each_their_condition():
    ramp = fault("loss", value=0.4, rise=2.0)
    many = condition(ramp, time=np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(many.effectiveness[:, 0], [1.0, 0.8, 0.6])
    assert np.all(many.effectiveness[:, 1:] == 1.0)


def test_a_rotor_at_70_percent_gives_the_torque_and_thrust_of_the_closed_form():
    plant = FreeFlight(vehicle=VEHICLE, start=(0.0, 0.0, 50.0), motor_lag=False)
    state = hovering(plant, fault("loss", value=0.3))
    missing = 0.3 * ROTORS.thrust_coefficient * VEHICLE.hover_speed**2
    force = plant.specific_force(state, 1.0)
    # at rest, an IMU at the centre of mass feels the thrust alone
    assert VEHICLE.aerodynamics.imu_position.any() or force[2] == pytest.approx(
        (VEHICLE.weight - missing) / VEHICLE.mass, rel=1e-9
    )
    after = plant.step(state, HOVER, 1.0, 1e-5)
    (x, y), torque = ROTORS.positions[0], wrench_from_speeds(VEHICLE, HOVER)[0]
    torque = torque - missing * np.array([y, -x, ROTORS.yaw_sign[0] * ROTORS.torque_to_thrust])
    np.testing.assert_allclose(after.body_rate / 1e-5, torque / VEHICLE.inertia, rtol=5e-3)


def test_an_off_rotor_runs_down_with_the_lag_of_the_motor():
    plant = FreeFlight(vehicle=VEHICLE, start=(0.0, 0.0, 50.0))
    state = hovering(plant, fault("off"))
    for index in range(25):
        state = plant.step(state, HOVER, index * DT, DT)
    left = math.exp(-25 * DT / ROTORS.time_constant)
    assert state.speeds[0] == pytest.approx(VEHICLE.hover_speed * left, abs=2e-4 * VEHICLE.hover_speed)
    np.testing.assert_allclose(state.speeds[1:], VEHICLE.hover_speed, rtol=1e-3)
    for index in range(500):
        state = plant.step(state, HOVER, index * DT, DT)
    assert state.speeds[0] < 1e-3 < ROTORS.speed_min


@pytest.mark.parametrize("motor_lag", [True, False])
def test_a_stuck_rotor_keeps_its_speed_and_a_saturated_one_ends_at_its_limit(motor_lag):
    plant = FreeFlight(vehicle=VEHICLE, start=(0.0, 0.0, 50.0), motor_lag=motor_lag)
    limit = 0.9 * VEHICLE.hover_speed
    state = hovering(plant, fault("stuck"), fault("saturated", rotors=[2], limit=limit))
    for index in range(200):
        state = plant.step(state, 1.1 * HOVER, index * DT, DT)
    assert state.speeds[0] == pytest.approx(VEHICLE.hover_speed, rel=1e-12)
    assert state.speeds[1] == pytest.approx(limit, rel=1e-6)


def test_a_chipped_propeller_shakes_with_its_centrifugal_force_at_its_speed():
    plant = FreeFlight(vehicle=VEHICLE, start=(0.0, 0.0, 50.0), motor_lag=False)
    unbalance, dt = 2e-7, 1e-3
    state = hovering(plant, fault("chipped", unbalance=unbalance))
    forces = []
    for index in range(40):
        forces.append(plant.specific_force(state, index * dt)[:2] * VEHICLE.mass)
        state = plant.step(state, HOVER, index * dt, dt)
    turned = ROTORS.spin_sign[0] * VEHICLE.hover_speed * dt * np.arange(40)
    size = unbalance * VEHICLE.hover_speed**2
    expected = size * np.column_stack([np.cos(turned), np.sin(turned)])
    np.testing.assert_allclose(forces, expected, atol=0.05 * size)


def test_the_injector_tells_the_condition_beside_the_faults_of_sensors():
    injector = FaultInjector(0, [make_injection("bias", {"value": 0.1}), fault("loss", value=0.3, start=0.1)])
    sample = level_sample()
    before, after = (injector.apply(stamp, sample) for stamp in (10**9, 10**9 + 10**8))
    assert before.rotors is not None
    assert after.rotors is not None
    np.testing.assert_allclose(before.attitude, 0.1)
    np.testing.assert_array_equal(before.rotors.effectiveness, np.ones(4))
    np.testing.assert_array_equal(after.rotors.effectiveness, [0.7, 1.0, 1.0, 1.0])
    assert FaultInjector(0).apply(10**9, sample).rotors is None
    healthy = FaultInjector(0, rotors=4).apply(10**9, sample).rotors
    np.testing.assert_array_equal(healthy.effectiveness, np.ones(4))


@pytest.mark.parametrize(
    ("values", "rotors", "words"),
    [
        ({"rotors": [5]}, 4, "rotors: 5 is no rotor; expected numbers from 1 to 4"),
        ({"rotors": [0]}, 4, "rotors: 0 is no rotor"),
        ({"rotors": ["x"]}, 4, "rotors: 'x' is no rotor"),
        ({}, 4, "rotors: missing; expected numbers from 1 to 4"),
        ({"rotors": [1], "axes": ["x"]}, 4, "axes: loss on a rotor has none"),
        ({"rotors": [1]}, 0, "only in free flight"),
        ({"rotors": [1], "value": 1.5}, 4, "value = 1.5: must be within"),
        ({"rotors": [1], "channel": "gyro"}, 4, "no fault 'loss'"),
    ],
)
def test_what_is_no_rotor_fault_is_refused_by_name(values, rotors, words):
    with pytest.raises(ValueError, match=words.replace("[", r"\[")):
        make_injection("loss", values, rotors=rotors)


def test_a_sensor_fault_takes_no_rotors():
    with pytest.raises(ValueError, match="rotors: bias is on a sensor"):
        make_injection("bias", {"rotors": [1], "channel": "gyro"}, rotors=4)
