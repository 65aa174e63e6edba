"""Disturbances: what each does; what every one keeps is in `test_laws`."""

import math

import numpy as np

from quadftc_model.parameters import build
from quadftc_sim.disturbance import disturbances


def test_constant_is_its_amplitude():
    law = build(disturbances.get("constant"), {"amplitude": [0.1, -0.2, 0.3]})
    assert law.at(7.0).tolist() == [0.1, -0.2, 0.3]


def test_ramp_grows_with_its_rate_and_is_held_after_its_rise():
    law = build(disturbances.get("ramp"), {"rate": [0.1, -0.2, 0.3], "start": 1.0, "rise": 2.0})
    np.testing.assert_allclose(law.at(2.5), [0.15, -0.3, 0.45], rtol=1e-15)
    np.testing.assert_allclose(law.at(50.0), [0.2, -0.4, 0.6], rtol=1e-15)


def test_sine_has_amplitude_frequency_and_phase():
    values = {
        "amplitude": [0.1, 0.2, 0.3],
        "frequency": [1, 2, 3],
        "phase": ["0 deg", "90 deg", "0"],
        "start": 1.0,
    }
    law = build(disturbances.get("sine"), values)
    expected = [0.1 * math.sin(0.7), 0.2 * math.cos(1.4), 0.3 * math.sin(2.1)]
    np.testing.assert_allclose(law.at(1.7), expected, rtol=1e-12)


def test_gusts_have_their_size_and_last_as_long_as_they_should():
    law = build(
        disturbances.get("gusts"), {"std_dev": [0.1, 0.2, 0.3], "correlation_time": 0.5, "history": 7}
    )
    torque = law.at(np.arange(0.0, 2000.0, 0.05))
    np.testing.assert_allclose(torque.std(axis=0), [0.1, 0.2, 0.3], rtol=0.02)
    after_one = np.mean(torque[:-10] * torque[10:], axis=0) / np.var(torque, axis=0)
    np.testing.assert_allclose(after_one, math.exp(-1.0), atol=0.08)
    assert np.max(np.abs(np.corrcoef(torque.T) - np.eye(3))) < 0.1


def test_gusts_of_another_history_are_others():
    first, second = (build(disturbances.get("gusts"), {"std_dev": 0.1, "history": n}) for n in (1, 2))
    assert np.all(first.at(1.0) != second.at(1.0))
