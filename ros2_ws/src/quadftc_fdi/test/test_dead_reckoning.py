"""Dead reckoning, and an observer that uses it across 90 deg of pitch."""

import math

import numpy as np
import pytest

from quadftc_fdi.fault_observer import MAX_PITCH, comparable, dead_reckon
from quadftc_fdi.fault_observers.threshold import Threshold
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

TRUE = np.bool_(True)


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


def test_attitude_is_right_and_finite_over_the_top_of_a_looping():
    observer, rate, dt = Threshold(vehicle=load_vehicle("qball_x4")), 2.0, 0.004  # rad/s, s
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
