"""The residual gate: what it finds and when, what it misses, its states, drift by a gyro bias."""

import math

import numpy as np
import pytest
from in_c import fly_arrays
from scipy.optimize import brentq

from quadftc_fdi.fault_observers.threshold import DEG, Threshold
from quadftc_model.arrays import rows_of
from quadftc_model.rotations import body_rates, euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import FAULTY, HEALTHY, RECOVERING, SUSPECT, FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("qball_x4")
ROLL = np.array([1.0, 0.0, 0.0])


def motion(time):
    """Euler angles (n, 3) [rad] and body rate of a smooth motion, at times (n,) [s]."""
    frequency, phase = np.array([1.1, 0.9, 0.7]), np.array([0.0, 1.0, 2.0])
    argument = time[:, None] * frequency + phase
    angles = 0.2 * np.sin(argument)
    return angles, body_rates(angles, 0.2 * frequency * np.cos(argument))


def flown(observer, measured, rates, dt, absent=None):
    """Estimates (n, ...) for measured angles and rates (n, 3)."""
    there, zeros = np.ones(len(rates), bool), np.zeros_like(rates)
    seen = there if absent is None else ~absent
    imu = ImuSample(quaternion_from_euler(measured), rates, zeros, seen, there, there)
    return fly_arrays(observer, FaultObserverInputs(imu, zeros), dt)[1]


def states_of(estimates, axis=0):
    return estimates.state[:, axis]


@pytest.mark.parametrize(("slope_deg", "rate"), [(12.0, 50), (30.0, 1000)])
def test_ramp_is_found_when_15_deg_above_7_deg_per_second_have_accumulated(rate, slope_deg):
    observer = Threshold(vehicle=VEHICLE)
    time = np.arange(6 * rate) / rate
    measured = slope_deg * DEG * np.maximum(time - 1.0, 0.0)[:, None] * ROLL
    states = states_of(flown(observer, measured, np.zeros_like(measured), 1.0 / rate))
    T = observer.filter_time

    def accumulated(until):  # [deg]; the low pass of the slope exceeds 7 deg/s from ``begin`` on
        begin = -T * math.log(1.0 - 7.0 / slope_deg)
        decay = math.exp(-begin / T) - math.exp(-until / T)
        return (slope_deg - 7.0) * (until - begin) - slope_deg * T * decay

    expected = brentq(lambda until: accumulated(until) - 15.0, 0.2, 5.0)
    assert time[np.argmax(states == FAULTY)] - 1.0 == pytest.approx(expected, abs=2.0 / rate)
    assert np.all(states[time < 1.0] == HEALTHY)
    assert SUSPECT in states


@pytest.mark.parametrize(
    ("fault", "found"),
    [
        (lambda t: 14.0 * (t >= 1.0), False),
        (lambda t: 6.5 * np.maximum(t - 1.0, 0.0), False),
        (lambda t: 3.0 * np.sin(2.0 * t), False),
        (lambda t: 20.0 * (t >= 1.0), True),
    ],
    ids=["step of 14 deg", "ramp of 6.5 deg/s", "sine of 6 deg/s", "step of 20 deg"],
)
def test_only_large_and_fast_faults_are_found(fault, found):
    time = np.arange(2000) / 250
    measured = DEG * fault(time)[:, None] * ROLL
    states = states_of(flown(Threshold(vehicle=VEHICLE), measured, np.zeros_like(measured), time[1]))
    assert (FAULTY in states) == found


def test_faulty_axis_is_dead_reckoned_and_the_others_are_measured():
    time = np.arange(750) / 250
    angles, rates = motion(time)
    fault = 25.0 * DEG * (time >= 1.0)[:, None] * ROLL
    offset = 0.001 * np.array([0.0, 1.0, 1.0]) * (time >= 2.0)[:, None]
    last = rows_of(flown(Threshold(vehicle=VEHICLE), angles + fault + offset, rates, time[1]), -1)
    assert last.state.tolist() == [FAULTY, HEALTHY, HEALTHY]
    np.testing.assert_allclose(last.fault, fault[-1], atol=0.05 * DEG)
    corrected = euler_from_quaternion(last.corrected.q_xyzw)
    np.testing.assert_allclose(corrected, angles[-1] + offset[-1], atol=0.05 * DEG)
    np.testing.assert_allclose(last.onset_age, [time[-1] - 1.0, -1.0, -1.0], atol=0.01)


def test_axis_is_trusted_again_a_second_after_the_fault():
    time = np.arange(1250) / 250
    fault = 25.0 * DEG * ((time >= 1.0) & (time < 3.0))[:, None] * ROLL
    states = states_of(flown(Threshold(vehicle=VEHICLE), fault, np.zeros_like(fault), time[1]))
    assert np.all(states[(time >= 1.2) & (time < 3.0)] == FAULTY)
    assert np.all(states[(time > 3.0) & (time < 3.99)] == RECOVERING)
    assert np.all(states[time > 4.01] == HEALTHY)


def test_gyro_bias_moves_the_estimate_and_only_patience_ends_the_fault():
    bias, patience = 1.0 * DEG, 6.0
    time = np.arange(2500) / 250
    fault = 25.0 * DEG * ((time >= 1.0) & (time < 4.0))[:, None] * ROLL
    observer = Threshold(vehicle=VEHICLE, patience=patience)
    estimates = flown(observer, fault, np.zeros_like(fault) + bias * ROLL, time[1])
    estimate = estimates.fault[:, 0]
    drift = (estimate[900] - estimate[400]) / (time[900] - time[400])
    assert drift == pytest.approx(-bias, rel=0.01)
    states = states_of(estimates)
    assert np.all(states[time < 1.0] == HEALTHY)
    assert np.all(states[(time > 4.0) & (time < 1.0 + patience - 0.01)] == FAULTY)
    assert np.all(states[time > 1.0 + patience + 0.01] == HEALTHY)


def test_absent_attitude_does_not_accumulate():
    time = np.arange(1000) / 250
    angles, rates = motion(time)
    absent = (time >= 1.0) & (time < 1.9)
    measured = np.where(absent[:, None], 0.0, angles)
    estimates = flown(Threshold(vehicle=VEHICLE), measured, rates, time[1], absent)
    assert np.all(states_of(estimates) == HEALTHY)
    corrected = euler_from_quaternion(estimates.corrected.q_xyzw)
    assert np.max(np.abs(corrected - angles)) < 0.05 * DEG
