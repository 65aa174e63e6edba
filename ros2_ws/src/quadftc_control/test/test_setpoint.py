"""Live setpoints: the filter makes a reference of angles that jump."""

import numpy as np
import pytest

from quadftc_control.reference import SetpointFilter

DT = 0.004


def flown(law, setpoint, count, start=None):
    """All references on the way to a setpoint."""
    state, out = law.init(np.zeros(3) if start is None else start), []
    for _ in range(count):
        state, reference = law.step(state, np.asarray(setpoint), DT)
        out.append(reference)
    return [np.array(column) for column in zip(*out, strict=True)]


def test_filter_starts_still_at_the_setpoint():
    angles, rates, accelerations = flown(SetpointFilter(), [0.1, 0.2, 0.3], 5, np.array([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(angles, np.broadcast_to([0.1, 0.2, 0.3], (5, 3)), rtol=1e-14)
    assert not np.any([rates, accelerations])


def test_filter_arrives_at_the_setpoint_without_overshoot():
    angles, _, _ = flown(SetpointFilter(), [0.1, -0.3, 0.5], 1500)
    np.testing.assert_allclose(angles[-1], [0.1, -0.3, 0.5], atol=1e-5)
    assert np.all(angles * [1.0, -1.0, 1.0] <= np.array([0.1, 0.3, 0.5]) + 1e-9)


def test_response_is_that_of_a_critically_damped_system():
    angles, _, _ = flown(SetpointFilter(bandwidth=3.0), [0.1, 0.1, 0.1], 500)
    time = DT * np.arange(1, 501)
    expected = 0.1 * (1.0 - (1.0 + 3.0 * time) * np.exp(-3.0 * time))
    np.testing.assert_allclose(angles[:, 0], expected, atol=1e-3)


def test_acceleration_is_bounded():
    _, rates, accelerations = flown(SetpointFilter(max_acceleration=2.0), [3.0, -3.0, 1.0], 500)
    assert np.max(np.abs(accelerations)) == 2.0
    assert np.max(np.abs(np.diff(rates, axis=0))) <= 2.0 * DT * (1.0 + 1e-9)


def test_rates_are_the_slope_of_the_angles():
    angles, rates, _ = flown(SetpointFilter(), [0.1, -0.3, 0.5], 500)
    mean = 0.5 * (rates[1:] + rates[:-1])
    np.testing.assert_allclose(np.diff(angles, axis=0) / DT, mean, atol=1e-10)


def test_filter_turns_the_short_way():
    angles, _, _ = flown(SetpointFilter(), [0.0, 0.0, -3.0], 2000, np.array([0.0, 0.0, 3.0]))
    assert np.min(angles[:, 2]) >= 3.0
    assert angles[-1, 2] == pytest.approx(2.0 * np.pi - 3.0, abs=1e-5)


def test_batch_equals_the_loop():
    setpoints = np.random.default_rng(11).uniform(-1.0, 1.0, (4, 3))
    batch = flown(SetpointFilter(), setpoints, 100, np.zeros((4, 3)))
    for one, setpoint in enumerate(setpoints):
        for many, single in zip(batch, flown(SetpointFilter(), setpoint, 100), strict=True):
            np.testing.assert_allclose(many[:, one], single, rtol=1e-12, atol=1e-15)
