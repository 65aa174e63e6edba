"""The inertial filter finds the gyro's errors and is consistent; its matrices are derivatives."""

import math

import numpy as np

from quadftc_fdi.supervision.inertial_filter import (
    apply_correction,
    correct,
    correction_factors,
    estimate_rate,
    predict,
    start_covariance,
    start_filter,
)
from quadftc_fdi.supervision.measurement import predict_angles
from quadftc_fdi.supervision.transition import SCALE, SIZE, ProcessNoise
from quadftc_model.rotations import (
    euler_from_quaternion,
    quaternion_from_euler,
    quaternion_from_rotation_vector,
    quaternion_product,
    wrap,
)

DEG = math.pi / 180.0
DT = 0.004
START = np.concatenate([[0.1 * DEG] * 3, [1.0 * DEG] * 3, [0.01] * 9, [0.01]])
NOISE = ProcessNoise(np.array([(0.007 * DEG) ** 2 * DT]), np.zeros(1), np.zeros(1))
NONE = ProcessNoise(np.zeros(1), np.zeros(1), np.zeros(1))


def ahead(state, gyro, noise=NONE):
    """State after a step, without anchors, and the transition."""
    earlier = np.zeros((*gyro.shape[:-1], 0, SIZE, SIZE))
    after, _, F = predict(state, earlier, gyro, 0.0 * gyro, noise, DT)
    return after, F


def some_state(seed=0):
    rng = np.random.default_rng(seed)
    q = quaternion_from_euler(np.array([0.3, -0.4, 1.0]))
    return start_filter(q, np.diag(START**2))._replace(x=0.05 * rng.normal(size=13)), rng.normal(size=3)


def test_scale_errors_and_a_sensor_mounted_askew_begin_apart():
    P = start_covariance(1.0, 1.0, 0.005, 0.01, 1.0)[SCALE, SCALE]
    by_rows = np.eye(9).reshape(9, 3, 3)  # M of each element
    symmetric, skew = [by_rows + sign * by_rows.swapaxes(-1, -2) for sign in (1.0, -1.0)]
    assert np.allclose(P, (0.5 * 0.005**2 * symmetric + 0.01**2 * skew).reshape(9, 9), atol=1e-12)


def test_the_transition_is_the_derivative_of_the_propagation():
    state, gyro = some_state()
    after, F = ahead(state, gyro)
    for column, step in enumerate(1e-6 * np.eye(SIZE)):
        moved, _ = ahead(apply_correction(state, step), gyro)
        turn = quaternion_product(after.q_xyzw * [-1, -1, -1, 1], moved.q_xyzw)
        found = np.concatenate([2.0 * turn[:3], moved.x - after.x]) / 1e-6
        np.testing.assert_allclose(
            found, F.of(np.eye(SIZE))[:, column], atol=2e-4
        )  # F is of first order in dt


def test_an_accelerated_rotation_is_integrated_to_third_order():
    """About an axis that turns, as the rate changes linearly within each step."""

    def error(steps):
        dt, state = 0.4 / steps, start_filter(np.array([0.0, 0.0, 0.0, 1.0]), np.diag(START**2))
        none = np.zeros((0, SIZE, SIZE))
        for k in range(steps):
            before, after = (
                np.array([14.0, 3.0, 0.0]) + t * np.array([0.0, 5.0, 30.0]) for t in (k * dt, k * dt + dt)
            )
            state, _, _ = predict(state, none, 0.5 * (before + after), after - before, NONE, dt)
        return state.q_xyzw

    exact = error(2000)
    coarse, fine = (np.linalg.norm(error(steps) - exact) for steps in (100, 200))
    assert coarse / fine > 12.0
    assert coarse < 1e-5


def flown(flights, seconds, seed):
    """Flights with gyro bias, scale error and delay: final error states (n, 16) and covariances."""
    rng = np.random.default_rng(seed)
    truth = START * rng.normal(size=(flights, SIZE))
    bias, M, tau = truth[:, 3:6], truth[:, 6:15].reshape(-1, 3, 3), truth[:, 15:]
    w, phase = rng.uniform(0.5, 3.0, (flights, 3)), rng.uniform(0.0, 6.0, (flights, 3))
    q = quaternion_from_euler(np.zeros((flights, 3)))
    noisy = quaternion_product(q, quaternion_from_rotation_vector(0.1 * DEG * rng.normal(size=(flights, 3))))
    state = start_filter(noisy, np.diag(START**2))
    everything = np.ones((flights, 3), bool)
    for k in range(round(seconds / DT)):
        omega = 0.5 * np.sin(w * k * DT + phase)
        q = quaternion_product(q, quaternion_from_rotation_vector(omega * DT))
        walk = 0.007 * DEG / math.sqrt(DT) * rng.normal(size=(flights, 3))
        gyro = np.linalg.solve(np.eye(3) + M, (omega + bias)[..., None])[..., 0] + walk
        state, _ = ahead(state, gyro, NOISE)
        prediction = predict_angles(state, estimate_rate(state.x, gyro))
        late = quaternion_product(q, quaternion_from_rotation_vector(-omega * tau))
        read = quaternion_product(
            late, quaternion_from_rotation_vector(0.1 * DEG * rng.normal(size=(flights, 3)))
        )
        residual = wrap(euler_from_quaternion(read) - prediction.angles)
        state, _, _ = correct(state, prediction, residual, (0.1 * DEG) ** 2 * prediction.gain, everything)
    turn = quaternion_product(state.q_xyzw * [-1, -1, -1, 1], q)
    wrong = np.concatenate([2.0 * turn[:, :3], truth[:, 3:] - state.x], axis=1)
    return wrong, state.P


def test_bias_scale_alignment_and_delay_are_found_with_an_honest_covariance():
    flights = 60
    wrong, P = flown(flights, 12.0, seed=5)
    spread = np.sqrt(np.mean(np.diagonal(P, axis1=1, axis2=2), axis=0))
    assert np.all(spread[3:6] < 0.02 * DEG)  # from 1 deg/s
    assert np.all(spread[6:15] < 0.005)  # from 1 %
    assert spread[15] < 1e-3  # from 10 ms
    nees = np.einsum("ni,nij,nj->n", wrong, np.linalg.inv(P), wrong)
    # over independent flights chi-square, 16 degrees of freedom each: within 4 standard deviations
    assert abs(np.sum(nees) - flights * SIZE) < 4.0 * math.sqrt(2.0 * flights * SIZE)


def test_an_axis_that_is_left_out_is_not_corrected():
    state, gyro = some_state()
    prediction = predict_angles(state, estimate_rate(state.x, gyro))
    used = np.array([False, True, True])
    _, dx, _ = correct(state, prediction, np.array([1.0, 0.0, 0.0]), np.full(3, 1e-6), used)
    np.testing.assert_array_equal(dx, 0.0)


def test_a_gap_in_a_tumble_does_not_multiply_what_is_unknown():
    state, _ = some_state()
    tumbling = np.array([60.0, -50.0, 30.0])
    before = np.diag(state.P)[:3].sum()
    after, _, _ = predict(state, np.zeros((0, SIZE, SIZE)), tumbling, np.zeros(3), NONE, 0.3)
    by_gyro = 0.3**2 * np.sum(START[3:6] ** 2) + np.sum((0.3 * 0.01 * tumbling) ** 2) * 3.0
    assert np.diag(after.P)[:3].sum() < 1.5 * before + by_gyro


def test_a_covariance_that_rounding_has_spoiled_still_gives_finite_factors():
    spoiled = np.array([[1e-3, 2e-3, 0.0], [2e-3, 1e-3, 0.0], [0.0, 0.0, -1e-5]])  # is no covariance
    variance = (1e-6, 1e-6, 1e-6)
    factors = correction_factors(spoiled, variance, 0.5, np.full(3, 0.01), np.ones(3, bool))
    assert np.all(np.isfinite(factors))
