"""References: rates and accelerations are derivatives, and every one is smooth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadftc_control.reference import combined, references, smooth_rise
from quadftc_model.numbers import numbers_of, with_numbers
from quadftc_model.parameters import build, parameters_of

EVERY_REFERENCE = pytest.mark.parametrize("name", references.names())
TIMES = np.linspace(0.05, 11.95, 60)  # no corner among them


def sized(name, **values):
    """A reference whose vectors have an amount that is not zero, over a window where it has one."""
    component = references.get(name)
    own = {spec.name for spec in parameters_of(component)}
    amounts = {
        spec.name: (0.2, -0.3, 0.4) for spec in parameters_of(component) if spec.is_vector and spec.low < 0.0
    }
    others = {"start": 1.0, "stop": 7.0, "frequency": 2.0}
    return build(component, {**amounts, **{key: others[key] for key in others if key in own}, **values})


@EVERY_REFERENCE
def test_many_times_and_jax_with_all_of_the_law_unknown_equal_the_loop(name):
    jax = pytest.importorskip("jax")
    law, column = sized(name), TIMES[:, None].copy()
    column.setflags(write=False)
    with jax.enable_x64(True):
        unknown = jax.jit(lambda values, times: with_numbers(law, values).sample(times))
        compiled = unknown(numbers_of(law), column)
    for index, time in enumerate(TIMES):
        for single, *many in zip(law.sample(float(time)), law.sample(column), compiled, strict=True):
            assert (single.shape, single.dtype) == ((3,), np.float64)
            assert np.all(np.isfinite(single))
            for each in many:
                np.testing.assert_allclose(each[index], single, rtol=1e-11, atol=1e-13)


@EVERY_REFERENCE
def test_rates_and_accelerations_are_the_derivatives(name):
    step = 1e-5
    for time in TIMES:
        before, now, after = (sized(name).sample(float(time) + offset) for offset in (-step, 0.0, step))
        np.testing.assert_allclose(now.rates, (after.angles - before.angles) / (2 * step), atol=1e-8)
        np.testing.assert_allclose(now.accelerations, (after.rates - before.rates) / (2 * step), atol=1e-8)


@EVERY_REFERENCE
def test_reference_has_no_jumps(name):
    times = np.linspace(0.0, 12.0, 12001)[:, None]
    for array in sized(name).sample(times):
        assert np.max(np.abs(np.diff(array, axis=0))) < 0.01  # in 1 ms


@pytest.mark.parametrize("name", ["step", "sine"])
@pytest.mark.parametrize("stop", [1.0, 0.5])
def test_window_that_ends_before_it_starts_is_refused(name, stop):
    with pytest.raises(ValueError, match=f"stop = {stop:g} s: must be later than start = 1 s"):
        sized(name, stop=stop)


def test_step_reaches_its_plateau_and_returns():
    law = sized("step", angles=[0.1, 0.2, 0.3], rise=2.0)
    times = (0.5, 2.0, 3.0, 7.0, 8.0, 9.0)
    shares = [law.sample(time).angles[0] / 0.1 for time in times]
    np.testing.assert_allclose(shares, [0.0, 0.5, 1.0, 1.0, 0.5, 0.0], atol=1e-12)


def test_sine_has_its_amplitude_between_the_fades():
    law = sized("sine", amplitude=0.2, frequency=3.0, phase="30 deg", fade=1.0)
    expected = 0.2 * np.sin(3.0 * 3.5 + np.pi / 6)
    np.testing.assert_allclose(law.sample(4.5).angles, expected, rtol=1e-12)
    assert law.sample(8.5).angles.tolist() == [0.0, 0.0, 0.0]


def test_references_add_up():
    parts = [sized("hold"), sized("sine")]
    total = combined(parts, 3.3)
    for field in total._fields:
        expected = getattr(parts[0].sample(3.3), field) + getattr(parts[1].sample(3.3), field)
        np.testing.assert_allclose(getattr(total, field), expected, rtol=1e-15)


def test_no_reference_means_level_and_still():
    assert [array.tolist() for array in combined([], 1.0)] == [[0.0, 0.0, 0.0]] * 3


@pytest.mark.parametrize(("fraction", "value"), [(-1.0, 0.0), (0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (2.0, 1.0)])
def test_smooth_rise_goes_from_zero_to_one(fraction, value):
    assert smooth_rise(np.array(fraction))[0] == pytest.approx(value, abs=1e-15)


@pytest.mark.parametrize("fraction", [-1.0, 0.0, 1.0, 2.0, -np.inf])
def test_smooth_rise_has_no_slope_or_curvature_at_its_ends(fraction):
    assert [float(part) for part in smooth_rise(np.array(fraction))[1:]] == [0.0, 0.0]


@given(st.floats(0.0, 1.0))
def test_smooth_rise_never_falls(fraction):
    assert smooth_rise(np.array(fraction))[1] >= 0.0
