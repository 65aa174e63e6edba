"""The observer supervised at any attitude: beyond 90 deg of pitch, upside down, in loops and flips."""

import math

import numpy as np
import pytest
from in_c import as_flown, fly_law

from quadftc_fdi.fault_observers.supervised import Supervised
from quadftc_fdi.supervision.inertial_filter import apply_correction, start_filter
from quadftc_fdi.supervision.measurement import defined, nearest_residual, predict_angles
from quadftc_fdi.supervision.transition import SIZE
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, turn
from quadftc_model.samples import ALARMS, FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

DEG, DT = math.pi / 180.0, 0.004
P = np.diag(np.full(SIZE, (0.05 * DEG) ** 2))
ATTITUDES = [
    [10.0, 85.0, 40.0],
    [170.0, 30.0, -20.0],
    [-100.0, -88.0, 170.0],
    [0.0, 0.0, 0.0],
    [60.0, 70.0, 5.0],
]


def predicted(angles, tau=0.0, omega=(0.0, 0.0, 0.0)):
    state = start_filter(quaternion_from_euler(np.array(angles) * DEG), np.eye(SIZE))
    return state._replace(P=P, x=np.full(13, 0.0) + tau * (np.arange(13) == 12)), np.array(omega)


@pytest.mark.parametrize("angles", ATTITUDES)
def test_the_measurement_matrix_is_the_derivative_of_the_prediction(angles):
    state, omega = predicted(angles, 0.008, (1.0, -12.0, 2.0))
    H = predict_angles(state, omega).H
    for column, step in enumerate(1e-6 * np.eye(SIZE)):
        ahead, behind = (predict_angles(apply_correction(state, sign * step), omega) for sign in (1, -1))
        slope = nearest_residual(behind, ahead.angles) / 2e-6
        scale = 1.0 / np.cos(predict_angles(state, omega).angles[1])
        np.testing.assert_allclose(slope, H[:, column], atol=0.02 * scale)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("angles", ATTITUDES)
def test_a_fault_of_an_angle_is_a_residual_of_that_angle_alone_also_across_the_pole(angles, axis):
    state, omega = predicted(angles)
    fault = 7.0 * DEG * np.eye(3)[axis]
    measured = euler_from_quaternion(quaternion_from_euler(np.array(angles) * DEG + fault))
    np.testing.assert_allclose(nearest_residual(predict_angles(state, omega), measured), fault, atol=1e-9)


def test_noise_of_the_attitude_is_magnified_and_correlated_as_the_filter_says():
    state, omega = predicted([20.0, 75.0, 0.0])
    prediction = predict_angles(state, omega)
    noise = 0.01 * DEG * np.random.default_rng(1).normal(size=(4000, 3))
    measured = [euler_from_quaternion(turn(state.q_xyzw, each)) for each in noise]
    found = np.cov(np.array([nearest_residual(prediction, each) for each in measured]).T) / (0.01 * DEG) ** 2
    np.testing.assert_allclose(np.diag(found), prediction.gain, rtol=0.1)
    correlation = found[0, 2] / math.sqrt(found[0, 0] * found[2, 2])
    assert correlation == pytest.approx(prediction.lean, abs=0.01)


def test_only_roll_and_yaw_within_a_degree_of_the_pole_are_undefined():
    for pitch, expected in ((80.0, True), (88.5, True), (89.5, False), (-89.9, False)):
        state, omega = predicted([5.0, pitch, 0.0])
        prediction = predict_angles(state, omega)
        for clear in defined(prediction, P, (0.05 * DEG) ** 2 * prediction.gain, np.True_):
            np.testing.assert_array_equal(clear, [expected, True, expected])


def test_where_little_is_known_roll_and_yaw_correct_the_filter_but_are_not_tested():
    for pitch, testable in ((0.0, [True] * 3), (70.0, [False] * 3)):
        state, omega = predicted([5.0, pitch, 0.0])
        prediction = predict_angles(state, omega)
        usable, tested = defined(
            prediction, (3.0 * DEG) ** 2 * np.eye(SIZE), 1e-5 * prediction.gain, np.True_
        )
        assert np.all(usable)
        np.testing.assert_array_equal(tested, testable)


def test_across_a_pole_the_evidence_on_pitch_starts_anew():
    """There the residual of pitch changes its sign, which is no fault."""
    law, there = Supervised(vehicle=load_vehicle("qball_x4")), np.True_

    def sample(pitch):
        q_xyzw = quaternion_from_euler(np.array([0.0, pitch * DEG, 0.0]))
        return FaultObserverInputs(
            ImuSample(q_xyzw, np.zeros(3), np.zeros(3), there, there, there), np.zeros(3)
        )

    state = law.init(sample(89.9))
    state, _ = law.step(state, sample(89.9), DT)
    assert state.passing.tolist() == [False, True, False]
    stale = state.evidence._replace(base=np.full(3, -2.0 * DEG), means=np.full((3, 5), -2.0 * DEG))
    for passing in (False, True):
        before = state._replace(evidence=stale, passing=np.array([False, passing, False]))
        after, _ = law.step(before, sample(89.0), DT)
        assert (after.evidence.base[1] > -1.5 * DEG) == passing
        assert after.evidence.base[0] < -1.5 * DEG


def flown(faulty_from):
    """Four flights of 11 s, the first healthy, then a fault of 5 deg of roll, pitch, yaw, from a time [s] on.

    Each loops in pitch and flips in roll with 800 deg/s at most. The gyro has a bias, scale and alignment
    errors; the attitude comes 8 ms late. Return states, faults [rad] and estimates (samples, 4, 3) [rad].
    """
    rng = np.random.default_rng(4)
    M, bias, tau = (
        0.01 * np.diag([1.0, -1.0, 0.5]) + 0.5 * DEG * np.eye(3)[[1, 2, 0]],
        0.4 * DEG,
        2,
    )  # samples
    inverse = np.linalg.inv(np.eye(3) + M)
    observer, there, peak = Supervised(vehicle=load_vehicle("qball_x4")), np.bool_(True), 800.0 * DEG

    def rate(t):
        omega = 0.5 * np.sin(np.array([1.1, 1.7, 0.6]) * t)
        for axis, start in ((1, 7.5), (0, 9.0)):
            part = (t - start) * peak / (4.0 * math.pi)
            if 0.0 < part < 1.0:
                omega[axis] += 0.5 * peak * (1.0 - math.cos(2.0 * math.pi * part))
        return omega

    late, faults, samples = [np.array([0.0, 0.0, 0.0, 1.0])], [], []
    for k in range(round(11.0 / DT)):
        for part in (0.25, 0.75) if k else ():
            late.append(turn(late[-1], 0.5 * DT * rate((k - 1 + part) * DT)))
        read = turn(late[max(len(late) - 1 - 2 * tau, 0)], 0.1 * DEG * rng.normal(size=3))
        fault = 5.0 * DEG * np.eye(4, 3, -1) * (k * DT >= faulty_from)
        gyro = inverse @ (rate(k * DT) + bias) + 0.1 * DEG * rng.normal(size=3)
        attitude = quaternion_from_euler(euler_from_quaternion(read) + fault)
        faults.append(fault)
        samples.append(
            [
                FaultObserverInputs(ImuSample(q, gyro, np.zeros(3), there, there, there), np.zeros(3))
                for q in attitude
            ]
        )
    flights = [fly_law(*as_flown(observer, [*each]), DT)[1] for each in zip(*samples, strict=True)]
    rows = [*zip(*flights, strict=True)]
    states, estimates = (
        [[getattr(each.said, name) for each in row] for row in rows] for name in ("state", "fault")
    )
    return np.array(states), np.array(faults), np.array(estimates)


def test_faults_are_found_on_their_axes_in_loops_and_flips_and_none_else():
    states, faults, estimates = flown(faulty_from=7.6)
    alarms, faulty = np.isin(states, ALARMS), faults != 0.0
    onset = round(7.6 / DT)
    assert not np.any(alarms & ~faulty)
    assert np.all(alarms[onset + 5 :] == faulty[onset + 5 :])
    assert np.max(np.abs(estimates - faults)[onset + 25 :]) < 1.5 * DEG
