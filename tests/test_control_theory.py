"""Controllers on the plant against their theory: ultimate bounds, steady errors, wind-up."""

import numpy as np
import pytest

from quadftc_control.controller import controllers
from quadftc_control.controllers import pid
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_model.parameters import build
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import AttitudeReference, ControllerInputs, DisturbanceObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.disturbance import disturbances
from quadftc_sim.plant import Plant

VEHICLE = load_vehicle("qball_x4")
TRUE = np.bool_(True)
DT = 0.004
PUSH = np.array([1.5, -1.5, 0.75])  # rad/s², three quarters of k_c3
ZEROS = np.zeros(3)


def pushing(kind, acceleration=PUSH, **values):
    """A disturbance of the size of an angular acceleration [rad/s²]."""
    return build(disturbances.get(kind), {"amplitude": list(VEHICLE.inertia * acceleration), **values})


def swing(time):
    """A reference that moves on all axes."""
    angle = 0.8 * time + np.array([0.0, 1.0, 2.0])
    size = np.array([0.1, 0.1, 0.2])
    return AttitudeReference(size * np.sin(angle), 0.8 * size * np.cos(angle), -0.64 * size * np.sin(angle))


def level(_time):
    return AttitudeReference(ZEROS, ZEROS, ZEROS)


def flown(name, reference=level, pushes=(), duration=6.0, angles=ZEROS, observer="none", **parameters):
    """Times (n,), attitude errors (n, 3) [rad], sliding variables (n, 3) and torques (n, 3) of a flight."""
    law = build(controllers.get(name), parameters, vehicle=VEHICLE)
    estimator = disturbance_observers.get(observer)(vehicle=VEHICLE)
    plant = Plant(vehicle=VEHICLE, disturbances=tuple(pushes))
    motion, torque, memory, estimates = plant.init(quaternion_from_euler(angles), ZEROS), ZEROS, None, None
    rows = []
    for index in range(round(duration / DT)):
        time, dt = index * DT, DT if index else 0.0
        seen = DisturbanceObserverInputs(motion.body_rate, TRUE, torque)
        estimates = estimator.init(seen) if estimates is None else estimates
        estimates, estimate = estimator.step(estimates, seen, dt)
        imu = ImuSample(motion.q_xyzw, motion.body_rate, ZEROS, TRUE, TRUE, TRUE)
        inputs = ControllerInputs(imu, reference(time), estimate)
        memory = law.init(inputs) if memory is None else memory
        memory, output = law.step(memory, inputs, dt)
        torque = output.torque
        rows.append((np.full(3, time), output.error, output.sliding_variable, torque))
        motion = plant.step(motion, torque, time, DT)
    assert np.all(np.isfinite(euler_from_quaternion(motion.q_xyzw)))
    times, *columns = (np.array(column) for column in zip(*rows, strict=True))
    return times[:, 0], *columns


@pytest.mark.parametrize("kind", ["constant", "sine"])
def test_integral_sliding_mode_stays_in_its_layer_under_a_bounded_disturbance(kind):
    values = {"frequency": 3.0} if kind == "sine" else {}
    _, _, S, _ = flown("ismc", swing, [pushing(kind, start=1.0, **values)])
    assert np.max(np.abs(S)) <= 0.1  # phi
    assert np.max(np.abs(S)) > 0.05  # and the disturbance was there


def test_integral_sliding_mode_holds_a_constant_disturbance_inside_the_layer():
    _, _, S, _ = flown("ismc", level, [pushing("constant")])
    np.testing.assert_allclose(S[-1], 0.1 * PUSH / np.array([2.0, 2.0, 1.0]), rtol=0.01)  # phi d / k_c3


def test_integral_sliding_mode_leaves_the_layer_under_too_large_a_disturbance():
    _, _, S, _ = flown("ismc", level, [pushing("constant", 2.0 * PUSH)])
    assert np.all(np.abs(S[-1]) > 0.1)


def test_integral_sliding_mode_leaves_no_error_under_a_constant_disturbance():
    _, error, _, _ = flown("ismc", level, [pushing("constant")], 10.0)
    assert np.degrees(np.max(np.abs(error[-1]))) < 0.01


def test_conventional_sliding_mode_is_off_by_the_share_of_the_layer():
    small = 0.1 * PUSH  # keeps the axes apart
    _, error, _, _ = flown("smc", level, [pushing("constant", small)], 10.0)
    k_c2, k_c3, phi = np.array([4.0, 4.0, 3.0]), np.array([10.0, 10.0, 4.0]), 0.5
    np.testing.assert_allclose(error[-1], small * phi / (k_c3 * k_c2), rtol=0.01)


def test_integral_of_the_pid_removes_a_constant_disturbance():
    _, error, _, _ = flown("pid", level, [pushing("constant")], 15.0)
    assert np.degrees(np.max(np.abs(error[-1]))) < 0.01


def test_disturbance_observer_takes_the_load_off_the_sliding_mode():
    peaks = []
    for observer in ("none", "exosystem"):
        times, _, S, _ = flown("ismc", swing, [pushing("constant", start=1.0)], observer=observer)
        peaks.append(np.max(np.abs(S[times > 2.0])))
    assert peaks[1] < 0.02 * peaks[0]


@pytest.mark.parametrize("name", ["ismc", "smc"])
def test_moving_reference_is_followed_without_error(name):
    times, error, _, _ = flown(name, swing, duration=10.0)
    assert np.degrees(np.max(np.abs(error[times > 6.0]))) < 0.1


@pytest.mark.parametrize("name", controllers.names())
def test_large_step_is_not_overshot(name):
    _, error, _, _ = flown(name, level, duration=10.0, angles=np.array([0.0, 0.0, 2.8]))
    assert np.degrees(np.min(error[:, 2])) > -0.1
    assert np.degrees(np.max(np.abs(error[-1]))) < 0.1


def test_integral_of_the_pid_does_not_wind_up(monkeypatch):
    flight = {"duration": 6.0, "angles": np.array([0.0, 0.0, 2.8]), "k_i": 60.0}
    overshoot = -np.min(flown("pid", level, **flight)[1][:, 2])
    monkeypatch.setattr(
        pid, "anti_windup", lambda integral, error, _wanted, _given, dt: integral + dt * error
    )
    without = -np.min(flown("pid", level, **flight)[1][:, 2])
    assert np.degrees(without) > 10.0
    assert overshoot < 0.01 * without


def test_yaw_blown_once_round_leaves_the_sliding_mode_as_it_was():
    gust = pushing(
        "constant", np.array([0.0, 0.0, -14.0]), start=0.5, stop=1.5
    )  # more than the authority of 10
    times, error, S, _ = flown("ismc", level, [gust], 12.0)
    assert np.max(np.abs(error[:, 2])) > 3.0  # it was blown round
    assert np.degrees(np.max(np.abs(error[times > 11.0]))) < 0.1
    assert np.all(np.abs(S[-1]) < 0.01)
