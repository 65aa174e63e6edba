"""Logs of a Crazyflie: the lag of its rotors, and which rows are in flight."""

import numpy as np
import pytest

from quadftc_tools.study.crazyflie_logs import BEFORE, STALE, TAKE_OFF, in_flight, lagged_torque


def test_lagged_torque_is_the_exact_response_to_a_held_command():
    torque = np.array([[0.0] * 3, [1.0] * 3, [1.0] * 3])
    means = lagged_torque(np.array([0.0, 0.01, 0.05]), torque, 0.02)
    expected = 1.0 - 0.02 / 0.04 * (1.0 - np.exp(-0.04 / 0.02))  # of 1 - exp(-t / T) over 0.04 s
    np.testing.assert_allclose(means, [[0.0] * 3, [expected] * 3], atol=1e-12)


def test_flight_is_between_take_off_and_crash():
    time = np.arange(0.0, 10.0, 0.01)
    motors = np.tile(np.where((time > 2.0) & (time < 9.0), 0.6, 0.0)[:, None], (1, 4))
    rate = np.zeros((len(time), 3))
    rate[time > 8.0, 1] = 3.0
    inside = time[in_flight(time, rate, motors)]
    assert inside[0] == pytest.approx(2.0 + TAKE_OFF, abs=0.03)
    assert inside[-1] == pytest.approx(8.0 - BEFORE, abs=0.03)
    assert not in_flight(time, rate, None)[:STALE].any()
