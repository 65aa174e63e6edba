"""Winds: what each does; what every one keeps is in `test_laws`, too."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from quadftc_model.parameters import build, parameters_of
from quadftc_sim.wind import winds

EVERY_WIND = pytest.mark.parametrize("name", winds.names())


def sized(name, **values):
    """A wind whose vectors have an amount that is not zero."""
    component = winds.get(name)
    amounts = {spec.name: (2.0, -3.0, 0.4) for spec in parameters_of(component) if spec.is_vector}
    return build(component, {**amounts, **values})


def dryden(**values):
    return build(winds.get("dryden"), {"wind_speed": 10.0, "height": 20.0, "airspeed": 8.0, **values})


@EVERY_WIND
def test_wind_is_continuous_within_its_window(name):
    law = sized(name)
    time = np.arange(1e-6, 20.0, 1e-3)
    step = np.abs(np.diff(law.at(time), axis=0)).max(axis=0)
    finer = np.abs(law.at(time + 1e-6) - law.at(time)).max(axis=0)
    assert np.all(step < 0.2)
    assert np.all(finer < 2e-4)


def test_constant_is_its_mean():
    law = build(winds.get("constant"), {"velocity_mean": [3.0, -2.0, 0.5]})
    assert law.at(7.0).tolist() == [3.0, -2.0, 0.5]


def test_gust_rises_holds_and_falls_by_half_a_cosine():
    law = build(winds.get("gust"), {"amplitude": [4.0, 0.0, -2.0], "rise": 2.0, "hold": 3.0, "start": 1.0})
    shares = np.array([law.at(time)[0] for time in (1.0, 1.5, 2.0, 3.0, 4.5, 6.0, 7.0, 8.0, 99.0)]) / 4.0
    quarter = 0.5 * (1.0 - math.cos(math.pi / 4.0))
    np.testing.assert_allclose(shares, [0.0, quarter, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(law.at(3.5), [4.0, 0.0, -2.0])


def test_gust_without_end_keeps_its_peak_as_the_specification_has_it():
    law = build(winds.get("gust"), {"amplitude": 3.0, "rise": 1.0, "hold": 1e9})
    np.testing.assert_allclose(law.at(np.array([1.0, 50.0, 1e6])), 3.0)


def test_dryden_has_the_lengths_and_intensities_of_the_specification():
    """At 20 ft: L_u = 20 / 0.19346^1.2 = 143.59 ft, sigma_u = sigma_w / 0.19346^0.4."""
    law = dryden(height=20.0 * 0.3048, wind_speed=15.0)
    np.testing.assert_allclose(law.scale_lengths / 0.3048, [143.59, 143.59, 20.0], rtol=1e-4)
    np.testing.assert_allclose(law.std_devs, [2.8938, 2.8938, 1.5], rtol=1e-4)


def test_at_1000_feet_dryden_is_isotropic():
    law = dryden(height=304.8)
    np.testing.assert_allclose(law.scale_lengths, 304.8, rtol=1e-12)
    np.testing.assert_allclose(law.std_devs, law.wind_speed / 10.0, rtol=1e-12)


def test_each_sine_of_dryden_stands_for_its_share_of_the_spectrum():
    """Integrals of the specification's spectra up to the frequencies are their quantiles."""
    law = dryden()
    spectra = (
        lambda x: 2.0 / math.pi / (1.0 + x**2),
        lambda x: (1.0 + 3.0 * x**2) / (1.0 + x**2) ** 2 / math.pi,
        lambda x: (1.0 + 3.0 * x**2) / (1.0 + x**2) ** 2 / math.pi,
    )
    for component, spectrum in enumerate(spectra):
        x = law.frequencies[:, component] * law.scale_lengths[component] / law.airspeed
        edges = np.concatenate([[0.0], x])
        powers = [quad(spectrum, *edge)[0] for edge in itertools.pairwise(edges)]
        place = np.cumsum(powers) * len(x) - np.arange(len(x))
        expected = ((np.arange(len(x)) + component) % 3 + 0.5) / 3.0
        np.testing.assert_allclose(place, expected, atol=1e-9)


def test_dryden_has_its_standard_deviations_and_autocorrelations():
    """R_u = exp(-s), R_v,w = (1 - s / 2) exp(-s) with s = V t / L, against a long record."""
    law = dryden(height=5.0, history=7)
    dt = 0.05
    wind = law.at(np.arange(0.0, 6000.0, dt))
    np.testing.assert_allclose(wind.std(axis=0), law.std_devs, rtol=0.03)
    np.testing.assert_allclose(wind.mean(axis=0), 0.0, atol=0.03 * law.std_devs[0])
    assert np.max(np.abs(np.corrcoef(wind.T) - np.eye(3))) < 0.03
    for component, length in enumerate(law.scale_lengths):
        for s in (0.25, 0.5, 1.0, 2.0):
            lag = round(s * length / law.airspeed / dt)
            ahead = lag * dt * law.airspeed / length
            expected = math.exp(-ahead) * (1.0 if component == 0 else 1.0 - 0.5 * ahead)
            column = wind[:, component]
            found = np.mean(column[:-lag] * column[lag:]) / np.var(column)
            assert found == pytest.approx(expected, abs=0.08), (component, s)


def test_dryden_has_its_standard_deviations_over_many_histories_from_the_start():
    winds_at_start = np.array([dryden(history=n).at(0.0) for n in range(1000)])
    np.testing.assert_allclose(winds_at_start.std(axis=0), dryden().std_devs, rtol=0.08)
    np.testing.assert_allclose(winds_at_start.mean(axis=0), 0.0, atol=0.15)


def test_dryden_is_near_gaussian():
    wind = dryden(height=5.0).at(np.arange(0.0, 6000.0, 0.05))
    kurtosis = np.mean(wind**4, axis=0) / np.var(wind, axis=0) ** 2
    np.testing.assert_allclose(kurtosis, 3.0, atol=0.2)


def test_dryden_turns_with_its_direction():
    along, turned = (dryden(history=3, direction=angle).at(4.0) for angle in (0.0, math.pi / 2.0))
    np.testing.assert_allclose(turned, [-along[1], along[0], along[2]], atol=1e-12)


def test_dryden_passes_with_the_airspeed():
    slow, fast = dryden(history=3, airspeed=4.0), dryden(history=3, airspeed=8.0)
    np.testing.assert_allclose(slow.at(10.0), fast.at(5.0), rtol=1e-9)


def test_dryden_of_another_history_is_another_and_of_the_same_the_same():
    first, again, other = (dryden(history=n).at(1.0) for n in (1, 1, 2))
    assert np.array_equal(first, again)
    assert np.all(first != other)


@pytest.mark.parametrize(("name", "value"), [("height", 2.0), ("height", 400.0), ("airspeed", 0.0)])
def test_dryden_outside_of_its_model_is_refused(name, value):
    with pytest.raises(ValueError, match=rf"{name} = {value:g}.*: must be within"):
        dryden(**{name: value})
