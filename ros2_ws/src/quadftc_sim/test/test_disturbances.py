"""Disturbances: what every one keeps, and what each does."""

import math

import numpy as np
import pytest

from quadftc_model.parameters import build, parameters_of
from quadftc_sim.disturbance import disturbances

EVERY_DISTURBANCE = pytest.mark.parametrize("name", disturbances.names())
TIMES = np.linspace(0.0, 6.0, 25)


def sized(name, **values):
    """A disturbance whose vectors have an amount that is not zero."""
    component = disturbances.get(name)
    vectors = [spec for spec in parameters_of(component) if spec.is_vector]
    amounts = {spec.name: (0.2, 0.3, 0.4) for spec in vectors}
    return build(component, {**amounts, **values})


@EVERY_DISTURBANCE
def test_torque_acts_from_start_inclusive_to_stop_exclusive(name):
    law = sized(name, start=2.0, stop=3.0)
    acting = [bool(np.any(law.torque(time) != 0.0)) for time in (1.999, 2.001, 2.999, 3.0, 9.0)]
    assert acting == [False, True, True, False, False]
    np.testing.assert_array_equal(law.torque(2.0), law.shape(np.zeros(1)))


@EVERY_DISTURBANCE
def test_torque_is_three_finite_numbers_and_the_same_every_time(name):
    law = sized(name, start=2.0)
    for time in TIMES:
        torque = law.torque(float(time))
        assert torque.shape == (3,)
        assert torque.dtype == np.float64
        assert np.all(np.isfinite(torque))
        np.testing.assert_array_equal(torque, law.torque(float(time)))


@EVERY_DISTURBANCE
def test_batch_of_times_equals_the_loop(name):
    law = sized(name, start=2.0, stop=5.0)
    times = TIMES.copy()
    times.setflags(write=False)
    loop = np.array([law.torque(float(time)) for time in TIMES])
    np.testing.assert_allclose(law.torque(times), loop, rtol=1e-12, atol=1e-15)


@EVERY_DISTURBANCE
@pytest.mark.parametrize(("start", "stop"), [(2.0, 2.0), (2.0, 1.0)])
def test_window_that_ends_before_it_starts_is_refused(name, start, stop):
    with pytest.raises(ValueError, match=f"stop = {stop:g} s: must be later than start = {start:g} s"):
        build(disturbances.get(name), {"start": start, "stop": stop})


def test_constant_is_its_amplitude():
    law = build(disturbances.get("constant"), {"amplitude": [0.1, -0.2, 0.3]})
    assert law.torque(7.0).tolist() == [0.1, -0.2, 0.3]


def test_ramp_grows_with_its_rate_and_is_held_after_its_rise():
    law = build(disturbances.get("ramp"), {"rate": [0.1, -0.2, 0.3], "start": 1.0, "rise": 2.0})
    np.testing.assert_allclose(law.torque(2.5), [0.15, -0.3, 0.45], rtol=1e-15)
    np.testing.assert_allclose(law.torque(50.0), [0.2, -0.4, 0.6], rtol=1e-15)


def test_sine_has_amplitude_frequency_and_phase():
    values = {
        "amplitude": [0.1, 0.2, 0.3],
        "frequency": [1, 2, 3],
        "phase": ["0 deg", "90 deg", "0"],
        "start": 1.0,
    }
    law = build(disturbances.get("sine"), values)
    expected = [0.1 * math.sin(0.7), 0.2 * math.cos(1.4), 0.3 * math.sin(2.1)]
    np.testing.assert_allclose(law.torque(1.7), expected, rtol=1e-12)


def test_gusts_have_their_size_and_last_as_long_as_they_should():
    law = build(
        disturbances.get("gusts"), {"std_dev": [0.1, 0.2, 0.3], "correlation_time": 0.5, "history": 7}
    )
    torque = law.torque(np.arange(0.0, 2000.0, 0.05))
    np.testing.assert_allclose(torque.std(axis=0), [0.1, 0.2, 0.3], rtol=0.02)
    after_one = np.mean(torque[:-10] * torque[10:], axis=0) / np.var(torque, axis=0)
    np.testing.assert_allclose(after_one, math.exp(-1.0), atol=0.08)
    assert np.max(np.abs(np.corrcoef(torque.T) - np.eye(3))) < 0.1


def test_gusts_of_another_history_are_others():
    first, second = (build(disturbances.get("gusts"), {"std_dev": 0.1, "history": n}) for n in (1, 2))
    assert np.all(first.torque(1.0) != second.torque(1.0))
