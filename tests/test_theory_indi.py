"""Incremental dynamic inversion on the plant: what it rejects and stands, what measured rotors are worth."""

import dataclasses

import numpy as np
import pytest
from in_c import in_c, moving

from quadftc_control.allocation import allocate
from quadftc_control.controller import controllers
from quadftc_model.parameters import build
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import (
    STANDARD_GRAVITY,
    AttitudeReference,
    ControllerInputs,
    ImuSample,
    RotorFeedback,
)
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.disturbance import disturbances
from quadftc_sim.plants.free_flight import FreeFlight
from quadftc_sim.plants.test_stand import AttitudeStand
from quadftc_theory.indi_conditions import margins

VEHICLE, X500 = load_vehicle("qball_x4"), load_vehicle("x500")
PUSH = [0.1, -0.1, 0.05]  # N m; a tenth of what the rotors can give
TRUE = np.bool_(True)
DT = 0.004
ZEROS = np.zeros(3)
LEVEL = AttitudeReference(ZEROS, ZEROS, ZEROS)


def flown(duration=4.0, angles=ZEROS, push=PUSH, late=0, plant=None, **parameters):
    """Attitude errors (n, 3) [rad] in a constant disturbance, from rest at ``angles``.

    Samples come ``late`` periods after they were taken.
    """
    law = build(controllers.get("indi"), parameters, vehicle=VEHICLE)
    pushes = (build(disturbances.get("constant"), {"amplitude": push}),)
    settings = {"motor_lag": True, "substeps": 2, **(plant or {})}
    stand = AttitudeStand(vehicle=VEHICLE, disturbances=pushes, **settings)
    motion, memory, errors, samples = stand.init(quaternion_from_euler(angles), ZEROS), None, [], []
    move, runner = moving(stand, 3), None
    for index in range(round(duration / DT)):
        imu = ImuSample(motion.q_xyzw, motion.body_rate, ZEROS, TRUE, TRUE, TRUE)
        samples.append(ControllerInputs(imu, LEVEL, ZEROS))
        inputs = samples[max(index - late, 0)]
        runner = runner or in_c(law, inputs)
        memory, output = runner.step(memory, inputs, DT) if index else runner.first(inputs)
        errors.append(output.error)
        motion = move(motion, output.torque, index * DT, DT)
    return np.array(errors)


def settled(errors):
    """Whether the attitude is right at the end, in every axis to a hundredth of a degree."""
    return bool(np.all(np.abs(np.degrees(errors[-100:])) < 0.01))


def test_constant_disturbance_leaves_no_error_though_nothing_estimates_it():
    errors = flown()
    assert np.degrees(np.max(np.abs(errors))) > 0.1  # it was there
    assert settled(errors)


def test_wrong_inertia_leaves_no_error():
    for factor in (0.3, 2.0):
        errors = flown(
            duration=12.0, angles=np.array([0.2, -0.2, 0.2]), plant={"inertia_factor": (factor,) * 3}
        )
        assert settled(errors), factor


def test_angular_acceleration_and_torque_are_of_the_same_time():
    """With the right inertia nothing is left between them, however fast the torque changes."""
    law = controllers.get("indi")(vehicle=VEHICLE)
    free = dataclasses.replace(VEHICLE, rotational_drag=np.zeros(3))
    stand = AttitudeStand(vehicle=free, motor_lag=True, substeps=8)
    motion, state = stand.init(quaternion_from_euler(ZEROS), ZEROS), None
    generator = np.random.default_rng(1)
    differences, sizes = [], []
    for index in range(200):
        imu = ImuSample(motion.q_xyzw, motion.body_rate, ZEROS, TRUE, TRUE, TRUE)
        inputs = ControllerInputs(imu, LEVEL, ZEROS)
        before = law.init(inputs) if state is None else state
        state, _ = law.step(before, inputs, DT if index else 0.0)
        torque = np.array([generator.uniform(-0.1, 0.1), 0.0, 0.0])  # one axis: no gyroscopic torque
        state = state._replace(wanted=torque)
        acceleration = 0.5 * (before.rate.slope + state.rate.slope)
        differences.append((VEHICLE.inertia * acceleration - state.torque.value)[0])
        sizes.append(state.torque.value[0])
        motion = stand.step(motion, torque, index * DT, DT)
    assert np.std(sizes) > 1e-3
    assert np.max(np.abs(differences)) < 1e-9 * np.max(np.abs(sizes))


def flown_free(law=None, noise=0.0, motor_bandwidth=0.0, duration=4.0, angles=ZEROS, **parameters):
    """Attitude errors (n, 3) [rad] and torques (n, 3) [N m] of a hover with measured rotors.

    ``law`` is the vehicle that the law takes it for, ``noise`` that of the gyro [rad/s].
    """
    controller = build(controllers.get("indi"), parameters, vehicle=law or X500)
    plant = FreeFlight(vehicle=X500, motor_bandwidth=motor_bandwidth, substeps=2, ground=False)
    motion, memory, errors, torques = plant.init(quaternion_from_euler(angles), ZEROS), None, [], []
    move, runner = moving(plant, 4), None
    generator = np.random.default_rng(1)
    for index in range(round(duration / DT)):
        seen = motion.body_rate + noise * generator.standard_normal(3)
        imu = ImuSample(motion.q_xyzw, seen, ZEROS, TRUE, TRUE, TRUE)
        torque, _ = wrench_from_speeds(X500, motion.speeds)
        inputs = ControllerInputs(imu, LEVEL, ZEROS, RotorFeedback(torque, np.bool_(True), np.ones(4)))
        runner = runner or in_c(controller, inputs)
        memory, output = runner.step(memory, inputs, DT) if index else runner.first(inputs)
        errors.append(output.error)
        torques.append(output.torque)
        speeds = allocate(X500, X500.mass * STANDARD_GRAVITY, output.torque).speeds
        motion = move(motion, speeds, index * DT, DT)
    return np.array(errors), np.array(torques)


def test_measured_rotors_make_up_for_slow_ones():
    slow = {"motor_bandwidth": 7.0, "duration": 8.0, "angles": np.array([0.1, -0.1, 0.1])}  # the law: 53
    assert settled(flown_free(**slow)[0])
    assert np.degrees(np.max(np.abs(flown_free(measured_torque=False, **slow)[0][-500:]))) > 1.0


def test_rotors_that_accelerate_do_not_shake_the_vehicle_about_z():
    weightless = dataclasses.replace(X500, rotors=dataclasses.replace(X500.rotors, rotor_inertia=0.0))
    knowing, unknowing = (flown_free(law, noise=0.002)[1][250:, 2] for law in (X500, weightless))
    assert np.std(np.diff(knowing)) < 0.1 * np.std(np.diff(unknowing))
    start = np.array([0.1, -0.1, 0.5])
    assert settled(flown_free(angles=start, duration=8.0)[0])


@pytest.mark.parametrize(("share", "stands"), [(0.7, True), (1.4, False)])
def test_delay_margin_is_where_the_loop_breaks(share, stands):
    law = controllers.get("indi")(vehicle=VEHICLE)
    late = round(share * min(margins(law, axis, DT).delay for axis in range(3)) / DT)
    errors = flown(duration=10.0, push=[0.01, 0.0, 0.0], late=late)
    assert (np.degrees(np.max(np.abs(errors[-250:]))) < 0.1) == stands


@pytest.mark.parametrize(("share", "stands"), [(0.7, True), (1.4, False)])
def test_inertia_margin_is_where_the_loop_breaks(share, stands):
    law = controllers.get("indi")(vehicle=VEHICLE, k_angle=(6.0, 6.0, 4.0))
    factor = share * margins(law, 0, DT).heaviest
    plant = {"inertia_factor": (factor, 1.0, 1.0)}
    errors = flown(duration=15.0, push=[0.001, 0.0, 0.0], plant=plant, k_angle=(6.0, 6.0, 4.0))
    grows = np.max(np.abs(errors[-500:, 0])) > 2.0 * np.max(np.abs(errors[500:1000, 0]))
    assert grows != stands
