"""Dead reckoning and the kinematics' matrices; the observers that use them across 90 deg of pitch."""

import math

import numpy as np
import pytest

from quadftc_fdi.fault_observer import MAX_PITCH, comparable, dead_reckon
from quadftc_fdi.fault_observers.augmented_kalman import AugmentedKalman, kinematic_matrices
from quadftc_fdi.fault_observers.edwards_spurgeon import EdwardsSpurgeon
from quadftc_fdi.fault_observers.threshold import Threshold
from quadftc_model.rotations import euler_rates, quaternion_from_euler
from quadftc_model.samples import FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

TRUE = np.bool_(True)


def test_kinematic_matrices_are_those_of_the_euler_rates():
    rng = np.random.default_rng(1)
    angles, rate = rng.uniform(-1.2, 1.2, (20, 3)), rng.normal(size=(20, 3))
    E, J = kinematic_matrices(angles, rate)
    np.testing.assert_allclose((E @ rate[..., None])[..., 0], euler_rates(angles, rate), rtol=1e-12)
    step = 1e-6
    columns = [
        (euler_rates(angles + step * axis, rate) - euler_rates(angles - step * axis, rate)) / (2.0 * step)
        for axis in np.eye(3)
    ]
    np.testing.assert_allclose(J, np.stack(columns, axis=-1), atol=1e-7)


def test_kinematic_matrices_are_bounded_at_90_deg():
    E, J = kinematic_matrices(np.array([0.3, math.pi / 2.0, 1.0]), np.array([1.0, 1.0, 1.0]))
    assert np.max(np.abs(E)) < 6.0
    assert np.max(np.abs(J)) < 60.0


def test_attitudes_are_compared_only_if_neither_is_steep():
    steep, flat = np.array([0.0, MAX_PITCH + 0.01, 0.0]), np.zeros(3)
    assert comparable(flat, -0.9 * steep)
    assert not comparable(steep, flat)
    assert not comparable(flat, -steep)


def test_dead_reckoning_is_of_order_2():
    """About one axis, at a rate that is quadratic in time: the trapezoidal rule's own error."""

    def error(steps):
        dt = 1.0 / steps
        q_xyzw = np.array([0.0, 0.0, 0.0, 1.0])
        for k in range(steps):
            start, end = (np.array([0.0, 0.0, (dt * (k + i)) ** 2]) for i in (0, 1))
            q_xyzw = dead_reckon(q_xyzw, start, end, dt)
        return abs(2.0 * math.atan2(q_xyzw[2], q_xyzw[3]) - 1.0 / 3.0)

    assert error(20) / error(40) == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("law", [AugmentedKalman, EdwardsSpurgeon, Threshold])
def test_attitude_is_right_and_finite_over_the_top_of_a_looping(law):
    observer, rate, dt = law(vehicle=load_vehicle("qball_x4")), 2.0, 0.004  # rad/s, s
    heading = quaternion_from_euler(np.array([0.0, 0.0, 0.5]))
    state = None
    for k in range(round(2.0 * math.pi / rate / dt)):
        turn = 0.5 * rate * dt * k
        c, s = math.cos(turn), math.sin(turn)
        q_xyzw = np.array([-heading[2] * s, heading[3] * s, heading[2] * c, heading[3] * c])
        imu = ImuSample(q_xyzw, np.array([0.0, rate, 0.0]), np.zeros(3), TRUE, TRUE, TRUE)
        inputs = FaultObserverInputs(imu, np.zeros(3))
        start = state is None
        state, estimate = observer.step(
            observer.init(inputs) if start else state, inputs, 0.0 if start else dt
        )
        assert abs(estimate.corrected.q_xyzw @ q_xyzw) > math.cos(0.5 * math.radians(0.05))
        assert np.max(np.abs(estimate.fault)) < math.radians(0.05)
