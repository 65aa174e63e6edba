"""The augmented-state Kalman filter: steps, gyro bias, consistency, and what the zeros at s = 0 do."""

import numpy as np
import pytest
from in_c import fly_arrays
from scipy.stats import chi2

from quadftc_fdi.fault_observers.augmented_kalman import DEG, AugmentedKalman
from quadftc_model.arrays import rows_of
from quadftc_model.rotations import body_rates, euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import FAULTY, HEALTHY, FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("qball_x4")
STEP = 3.0 * DEG * np.array([1.0, -1.0, 0.7])


def motion(time):
    """Euler angles (..., 3) [rad] and body rate of a smooth motion, at times (...,) [s]."""
    frequency, phase = np.array([1.1, 0.9, 0.7]), np.array([0.0, 1.0, 2.0])
    argument = np.asarray(time)[..., None] * frequency + phase
    angles = 0.2 * np.sin(argument)
    return angles, body_rates(angles, 0.2 * frequency * np.cos(argument))


def inputs_of(angles, rates, rate_valid=None):
    """Inputs (n, ...) of measured angles and rates (n, ..., 3)."""
    there, zeros = np.ones(angles.shape[:-1], bool), np.zeros_like(rates)
    valid = there if rate_valid is None else rate_valid
    imu = ImuSample(quaternion_from_euler(angles), rates, zeros, there, valid, there)
    return FaultObserverInputs(imu, zeros)


def flown(observer, angles, rates, dt, rate_valid=None):
    """Estimates (n, ...) and last state for measured angles and rates (n, 3)."""
    state, estimates = fly_arrays(observer, inputs_of(angles, rates, rate_valid), dt)
    return estimates, state


@pytest.mark.parametrize("rate", [50, 250, 1000])
def test_step_fault_is_found_at_once_and_tracked_without_gyro_bias(rate):
    time = np.arange(round(4.0 * rate)) / rate
    angles, rates = motion(time)
    fault = STEP * (time[:, None] >= 2.0)
    estimates, _ = flown(AugmentedKalman(vehicle=VEHICLE), angles + fault, rates, 1.0 / rate)
    states, errors = estimates.state, estimates.fault - fault
    onset = 2 * rate
    assert np.all(states[rate // 2 : onset] == HEALTHY)
    assert np.all(states[onset + 1 :] == FAULTY)
    assert np.max(np.abs(errors[onset + 1 :])) < 0.05 * DEG
    assert np.max(np.abs(errors[:onset])) < 0.01 * DEG
    np.testing.assert_allclose(estimates.onset_age[-1], time[-1] - 2.0, atol=2.0 / rate)


def noisy(rng, observer, time, shape, fault_walk=0.0):
    """Measured angles, rates, true angles, bias and fault of flights in the filter's own model."""
    dt = time[1]
    size = (len(time), *shape, 3)
    angles, rates = (np.broadcast_to(part[:, None] if shape else part, size) for part in motion(time))
    bias = observer.gyro_bias * rng.normal(size=(*shape, 3))
    fault = observer.initial_fault * rng.normal(size=(*shape, 3))
    fault = fault + np.cumsum(fault_walk * np.sqrt(dt) * rng.normal(size=size), axis=0)
    gyro = rates + bias + observer.gyro_noise / np.sqrt(dt) * rng.normal(size=size)
    return angles + fault + observer.attitude_noise * rng.normal(size=size), gyro, angles, bias, fault


def test_gyro_bias_is_found_without_calling_it_a_fault():
    observer = AugmentedKalman(vehicle=VEHICLE)
    time = np.arange(2500) / 250
    measured, gyro, _, bias, _ = noisy(np.random.default_rng(2), observer, time, ())
    estimates, state = flown(observer, measured, gyro, time[1])
    assert np.max(np.abs(bias)) > 0.2 * DEG
    assert np.max(np.abs(state.gyro_bias - bias)) < 0.02 * DEG
    assert np.all(estimates.state < FAULTY)
    np.testing.assert_allclose(estimates.corrected.body_rate[-1], gyro[-1] - state.gyro_bias, rtol=1e-12)


def test_errors_are_as_large_as_the_covariance_says():
    """Normalised error squared of all nine states, 60 flights in the filter's own model: 99.9 % band."""
    observer = AugmentedKalman(vehicle=VEHICLE, gyro_bias_walk=0.0)
    time = np.arange(1500) / 250
    flights = 60
    measured, gyro, angles, bias, fault = noisy(
        np.random.default_rng(3), observer, time, (flights,), observer.fault_walk
    )
    inputs = inputs_of(measured, gyro)
    state = observer.init(rows_of(inputs, 0))
    for k in range(len(time)):
        state, _ = observer.step(state, rows_of(inputs, k), time[1] if k else 0.0)
    error = np.concatenate(
        [
            wrap(euler_from_quaternion(state.q_xyzw) - angles[-1]),
            state.gyro_bias - bias,
            state.fault - fault[-1],
        ],
        axis=-1,
    )
    squared = np.einsum("...i,...ij,...j->...", error, np.linalg.inv(state.P), error)
    low, high = chi2.ppf([0.0005, 0.9995], 9 * flights)
    assert low < np.sum(squared) < high


def test_fault_that_is_there_at_the_first_sample_is_taken_for_attitude():
    observer = AugmentedKalman(vehicle=VEHICLE, initial_fault=1.0 * DEG)
    still = np.zeros((500, 3))
    estimates, _ = flown(observer, still + STEP, still, 0.004)
    np.testing.assert_allclose(estimates.fault[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(euler_from_quaternion(estimates.corrected.q_xyzw[-1]), STEP, atol=1e-12)
    np.testing.assert_allclose(estimates.std_dev[-1], 1.0 * DEG, rtol=0.02)  # and the filter knows


def test_missing_gyro_in_a_turn_is_no_fault():
    time = np.arange(750) / 250
    angles, rates = motion(time)
    absent = (time >= 1.6) & (time < 1.9)
    rates = np.where(absent[:, None], 50.0, rates)  # what stands there must not matter
    estimates, _ = flown(AugmentedKalman(vehicle=VEHICLE), angles, rates, time[1], ~absent)
    assert np.max(np.abs(estimates.fault)) < 0.1 * DEG
    assert np.all(estimates.state < FAULTY)
