"""The classical sliding-mode observer: steps, reach, leak, drift by a gyro bias, noise."""

import math

import numpy as np
import pytest
from in_c import fly_arrays

from quadftc_fdi.fault_observers.edwards_spurgeon import DEG, EdwardsSpurgeon
from quadftc_model.rotations import body_rates, euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import FAULTY, HEALTHY, RECOVERING, FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("qball_x4")
STEP = 3.0 * DEG * np.array([1.0, -1.0, 0.7])


def motion(time):
    """Euler angles (n, 3) [rad] and body rate of a smooth motion, at times (n,) [s]."""
    frequency, phase = np.array([1.1, 0.9, 0.7]), np.array([0.0, 1.0, 2.0])
    argument = time[:, None] * frequency + phase
    angles = 0.2 * np.sin(argument)
    return angles, body_rates(angles, 0.2 * frequency * np.cos(argument))


def flown(observer, measured, rates, dt):
    """Estimates (n, ...) for measured angles and rates (n, 3), and the last state."""
    there, zeros = np.ones(len(rates), bool), np.zeros_like(rates)
    imu = ImuSample(quaternion_from_euler(measured), rates, zeros, there, there, there)
    state, estimates = fly_arrays(observer, FaultObserverInputs(imu, zeros), dt)
    return estimates, state


@pytest.mark.parametrize("rate", [50, 250, 1000])
def test_step_fault_is_tracked_without_gyro_bias(rate):
    time = np.arange(3 * rate) / rate
    angles, rates = motion(time)
    fault = STEP * (time[:, None] >= 1.0)
    estimates, _ = flown(EdwardsSpurgeon(vehicle=VEHICLE), angles + fault, rates, 1.0 / rate)
    errors = estimates.fault - fault
    assert np.max(np.abs(errors[time < 1.0])) < 0.01 * DEG
    assert np.max(np.abs(errors[time >= 1.2])) < 0.05 * DEG
    off = euler_from_quaternion(estimates.corrected.q_xyzw[-1]) - angles[-1]
    assert np.max(np.abs(off)) < 0.05 * DEG


def test_states_follow_a_fault_that_comes_and_goes():
    time = np.arange(1250) / 250
    fault = STEP * ((time >= 1.0) & (time < 3.0))[:, None]
    estimates, _ = flown(EdwardsSpurgeon(vehicle=VEHICLE), fault, np.zeros_like(fault), time[1])
    states = estimates.state[:, 0]
    expected = [(0.5, HEALTHY), (1.1, FAULTY), (2.9, FAULTY), (3.5, RECOVERING), (4.5, HEALTHY)]
    assert [(at, states[round(250 * at)]) for at, _ in expected] == expected
    ages = estimates.onset_age[:, 0]
    np.testing.assert_allclose(ages[[500, 875]], [1.0, 2.5], atol=0.02)  # RECOVERING, too
    assert ages[200] == ages[-1] == -1.0


def test_gyro_bias_moves_the_estimate_at_its_own_rate():
    bias = np.array([0.05, -0.03, 0.02]) * DEG
    still = np.zeros((1250, 3))
    estimates, _ = flown(EdwardsSpurgeon(vehicle=VEHICLE, leak=0.0), still, still + bias, 0.004)
    np.testing.assert_allclose(estimates.fault[-1], -bias * 1249 * 0.004, rtol=0.01)


def test_constant_fault_leaks_with_its_time_constant():
    fault = STEP * (np.arange(2501) >= 1)[:, None]
    estimates, _ = flown(EdwardsSpurgeon(vehicle=VEHICLE, leak=0.1), fault, np.zeros_like(fault), 0.004)
    np.testing.assert_allclose(estimates.fault[-1], STEP * math.exp(-1.0), rtol=0.01)


def test_error_slides_within_the_reach_of_the_injection_only():
    observer = EdwardsSpurgeon(vehicle=VEHICLE, leak=0.0)
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    reach = observer.rho / observer.a_f
    for share in (0.9, 1.1):
        fault = share * reach * direction * (np.arange(250) >= 1)[:, None]
        estimates, state = flown(observer, fault, np.zeros_like(fault), 0.004)
        np.testing.assert_allclose(estimates.fault[-1], min(share, 1.0) * reach * direction, rtol=1e-3)
        assert (np.linalg.norm(state.e) == 0.0) == (share < 1.0)


def test_noise_of_the_estimate_is_that_of_the_low_pass():
    observer, sigma = EdwardsSpurgeon(vehicle=VEHICLE, leak=0.0), 0.1 * DEG
    measured = sigma * np.random.default_rng(4).normal(size=(5000, 3))
    measured[0] = 0.0  # the start is kept for ever
    estimates, _ = flown(observer, measured, np.zeros_like(measured), 0.004)
    gain = -math.expm1(-0.004 / observer.tau)
    found = np.std(estimates.fault[100:])
    assert found == pytest.approx(sigma * math.sqrt(gain / (2.0 - gain)), rel=0.05)
