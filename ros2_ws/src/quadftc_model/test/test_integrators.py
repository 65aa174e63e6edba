"""The integrator against its declared order."""

import numpy as np
import pytest

from quadftc_model.rigid_body import rk4


def error(steps):
    """Error at the end of a nonlinear, time-dependent equation: x' = -x² (1 + t), x = 1 / (1 + t + t²/2)."""
    dt, state = 1.0 / steps, (np.array([1.0]),)
    for index in range(steps):
        state = rk4(lambda t, x: (-x[0] * x[0] * (1.0 + t),), index * dt, state, dt)
    return abs(state[0][0] - 1.0 / 2.5)


@pytest.mark.parametrize("steps", [20, 40, 80])
def test_rk4_error_falls_by_sixteen_at_half_the_step(steps):
    assert np.log2(error(steps) / error(2 * steps)) == pytest.approx(4.0, abs=0.1)


def test_rk4_steps_every_array_of_the_state():
    first, second = rk4(lambda _t, x: (x[1], -x[0]), 0.0, (np.zeros((2, 3)), np.ones(3)), 0.1)
    np.testing.assert_allclose(first, np.full((2, 3), np.sin(0.1)), atol=1e-7)
    np.testing.assert_allclose(second, np.full((2, 3), np.cos(0.1)), atol=1e-7)
