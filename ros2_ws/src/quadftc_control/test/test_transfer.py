"""Going over from one IMU to another in flight: what is flown on is continuous, and so is the torque."""

import numpy as np
import pytest

from quadftc_control.controllers.ismc import Ismc
from quadftc_control.input_monitor import InputMonitor, Patience
from quadftc_control.transfer import TORQUE_JUMP, Transfer
from quadftc_model.rotations import (
    body_rates,
    euler_from_quaternion,
    quaternion_from_euler,
    quaternion_from_rotation_vector,
    rotation_between,
)
from quadftc_model.samples import AttitudeReference, ControllerInputs, level_sample
from quadftc_model.stepper import Stepper
from quadftc_model.vehicle import load_vehicle

DT, PERIOD_NS = 0.004, 4_000_000
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
FAULT = np.radians([2.0, -3.0, 4.0])
BIAS = np.radians([1.0, -0.5, 0.7])  # rad/s
SAMPLES = 2000  # 8 s
LOST, BACK = 500, 1500  # samples between which imu/corrected is missing


def sample(angles, rate):
    return level_sample()._replace(q_xyzw=quaternion_from_euler(angles), body_rate=rate)


def flight(disturbance, estimated=True):
    """Fly small angles on imu/corrected, then on imu/data with a fault and a bias, then back.

    Returns the torques and the true angles, (N, 3) each.
    """
    vehicle = load_vehicle("qball_x4")
    patience = Patience(correction_hold=1.0)
    law = Ismc(vehicle=vehicle)
    stepper, transfer, monitor = Stepper(law), Transfer(patience), InputMonitor(patience)
    still = AttitudeReference(*(np.zeros(3),) * 3)
    angles, rate, torques, path = np.zeros(3), np.zeros(3), [], []
    for k in range(SAMPLES):
        stamp_ns = 1_000_000_000 + k * PERIOD_NS
        raw = LOST <= k < BACK
        read = sample(angles + FAULT * raw, rate + BIAS * raw)
        if k == LOST:
            transfer.expect(-BIAS, FAULT)
        if not raw or estimated:
            monitor.estimate = stamp_ns, disturbance
        used = transfer.used(stamp_ns, read, raw)
        estimate, share, _ = monitor.disturbance_at(stamp_ns)
        stepper.law = law.without_estimate(1.0 - share)
        torque = stepper.step(stamp_ns, ControllerInputs(used, still, estimate)).torque
        rate = rate + DT * (torque / vehicle.inertia + disturbance)
        angles = angles + DT * rate
        torques.append(torque)
        path.append(angles)
    return np.array(torques), np.array(path)


@pytest.mark.parametrize("estimated", [True, False])
def test_torque_does_not_jump_when_the_imu_or_the_estimate_is_another(estimated):
    disturbance = np.array([3.0, -2.0, 1.0])
    torques, angles = flight(disturbance, estimated)
    jumps = np.abs(np.diff(torques, axis=0)) / load_vehicle("qball_x4").authority
    assert np.max(jumps[50:]) < 0.1 * TORQUE_JUMP  # nothing else acts here: no noise
    # still on the attitude without fault when it is held, on the one with it when it was given up
    held, given_up = LOST + round(0.9 / DT), BACK - 10
    assert np.max(np.abs(np.degrees(angles[held]))) < 0.6
    np.testing.assert_allclose(np.degrees(angles[given_up]), -np.degrees(FAULT), atol=0.6)
    assert np.max(np.abs(np.degrees(angles[-1]))) < 0.3


@pytest.mark.parametrize("begins", [False, True])
def test_fault_that_ends_or_begins_meanwhile_is_noticed_by_its_step(begins):
    transfer = Transfer(Patience())
    level, off = sample(np.zeros(3), np.zeros(3)), sample(FAULT, np.zeros(3))
    before, after = (level, off) if begins else (off, level)
    transfer.used(1, level, raw=False)
    transfer.expect(np.zeros(3), None if begins else FAULT)
    for k in range(1, 400):
        used = transfer.used(1 + k * PERIOD_NS, before if k < 200 else after, raw=True)
        np.testing.assert_allclose(euler_from_quaternion(used.q_xyzw), 0.0, atol=1e-12)


@pytest.mark.parametrize("faulty", [True, False])
def test_attitude_that_was_faulty_is_carried_on_by_the_body_rate(faulty):
    patience = Patience(correction_hold=4.0, correction_fade=1.0)
    transfer = Transfer(patience)
    swing = np.radians([8.0, -5.0, 3.0])  # of a vehicle that moves
    far, off = [], []
    for k in range(1600):
        time = k * DT
        angles, rates = swing * np.sin(time), swing * np.cos(time)
        fault = FAULT * (1.0 + np.sin(2.0 * time))  # by up to 6 deg/s
        truth = sample(angles, body_rates(angles, rates))
        raw = sample(angles + fault, truth.body_rate + BIAS)
        lost = k >= 250
        if k == 250:
            transfer.expect(-BIAS, FAULT if faulty else None)
        used = transfer.used(1 + k * PERIOD_NS, raw if lost else truth, raw=lost)
        error = euler_from_quaternion(used.q_xyzw) - angles
        far.append(np.max(np.abs(error)))
        off.append(np.max(np.abs(error - fault)))
        if lost:
            assert transfer.known == (faulty and k <= 250 + 4.0 / DT)
        np.testing.assert_allclose(used.body_rate, truth.body_rate, atol=1e-12)
    held, given_up = slice(250, 250 + round(4.0 / DT)), slice(250 + round(5.0 / DT), None)
    assert (np.degrees(np.max(far[held])) < 0.1) == faulty
    assert np.max(off[given_up]) < 1e-12


def test_sensor_that_jumps_all_the_time_does_not_keep_the_attitude_on_the_body_rate_for_ever():
    transfer = Transfer(Patience(correction_hold=0.5, correction_fade=0.1))
    level, drift = sample(np.zeros(3), np.zeros(3)), np.radians([1.0, 0.0, 0.0])  # rad/s
    transfer.used(1, level, raw=False)
    transfer.expect(np.zeros(3), FAULT)
    for k in range(1, 2500):
        shaken = sample(FAULT * (k // 50 % 2), drift)
        used = transfer.used(1 + k * PERIOD_NS, shaken, raw=True)
    assert abs(np.degrees(euler_from_quaternion(used.q_xyzw)[0])) < 3.0  # and not the 10 deg of the rate


def test_without_a_transfer_samples_are_used_as_they_are():
    transfer = Transfer(Patience())
    given = sample(FAULT, BIAS)
    for k in range(5):
        assert transfer.used(k * PERIOD_NS + 1, given, raw=False) is given


def test_weight_is_held_fades_and_ends():
    transfer = Transfer(Patience(correction_hold=1.0, correction_fade=2.0))
    good, bad = sample(np.zeros(3), np.zeros(3)), sample(FAULT, np.zeros(3))
    transfer.used(1, good, raw=False)
    transfer.expect(None, FAULT)
    seen = {}
    for k in range(1, 1000):
        used = transfer.used(1 + k * PERIOD_NS, bad, raw=True)
        seen[k] = euler_from_quaternion(used.q_xyzw)
    np.testing.assert_allclose(seen[1], 0.0, atol=1e-12)
    np.testing.assert_allclose(seen[250], 0.0, atol=1e-12)
    np.testing.assert_allclose(seen[501], 0.5 * FAULT, atol=2e-3)
    np.testing.assert_array_equal(seen[999], euler_from_quaternion(bad.q_xyzw))


def test_after_a_long_silence_the_sample_is_taken_as_it_is():
    transfer = Transfer(Patience())
    transfer.used(1, sample(np.zeros(3), np.zeros(3)), raw=False)
    given = sample(FAULT, BIAS)
    assert transfer.used(200_000_001, given, raw=True) is given


def test_after_a_gap_the_fault_as_last_known_is_taken_off():
    transfer = Transfer(Patience())
    transfer.used(1, sample(np.zeros(3), np.zeros(3)), raw=False)
    transfer.expect(-BIAS, FAULT)
    angles = np.radians([1.0, 2.0, -3.0])  # to which it has turned in the gap
    for k in range(10):
        used = transfer.used(500_000_001 + k * PERIOD_NS, sample(angles + FAULT, BIAS), raw=True)
        np.testing.assert_allclose(euler_from_quaternion(used.q_xyzw), angles, atol=1e-12)
        np.testing.assert_allclose(used.body_rate, 0.0, atol=1e-12)


def test_imu_that_was_healthy_is_used_as_it_is_at_once_but_for_its_gyro_bias():
    transfer = Transfer(Patience(blend=0.2))
    transfer.used(1, sample(np.zeros(3), np.zeros(3)), raw=False)
    transfer.expect(-BIAS, None)
    off = np.radians([0.3, -0.2, 0.1])  # by noise
    seen = [transfer.used(1 + k * PERIOD_NS, sample(off, BIAS), raw=True) for k in range(1, 500)]
    angles = np.array([euler_from_quaternion(each.q_xyzw) for each in seen])
    np.testing.assert_allclose(angles[0], 0.0, atol=1e-12)
    assert np.max(np.abs(np.diff(angles, axis=0))) < np.max(np.abs(off)) / 40
    np.testing.assert_allclose(angles[60:], np.tile(off, (439, 1)), atol=1e-12)
    np.testing.assert_allclose([each.body_rate for each in seen], 0.0, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 3.0])
def test_rotation_vector_is_the_inverse_of_the_quaternion(angle):
    vector = angle * np.array([0.6, 0.0, -0.8])
    q_xyzw = quaternion_from_rotation_vector(vector)
    np.testing.assert_allclose(rotation_between(LEVEL, q_xyzw), vector, atol=1e-12)
    np.testing.assert_allclose(rotation_between(LEVEL, -q_xyzw), vector, atol=1e-12)


def test_switching_gain_takes_over_with_its_layer_in_proportion():
    law = Ismc(vehicle=load_vehicle("qball_x4"))
    assert law.without_estimate(0.0) is law
    alone = law.without_estimate(1.0)
    np.testing.assert_allclose(alone.k_c3, law.k_c3_alone)
    np.testing.assert_allclose(np.divide(alone.k_c3, alone.phi), np.divide(law.k_c3, law.phi))
    np.testing.assert_allclose(law.without_estimate(0.5).k_c3, 0.5 * np.add(law.k_c3, alone.k_c3))
