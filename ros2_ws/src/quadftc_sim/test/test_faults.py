"""Fault laws: what every one keeps, and what each does to a channel."""

import math

import numpy as np
import pytest

from quadftc_model.parameters import build, parameters_of
from quadftc_sim.fault import FaultInputs, faults

EVERY_FAULT = pytest.mark.parametrize("name", faults.names())
UNITS = {"channel": "rad", "channel_rate": "rad/s"}
VALUE = np.array([1.0, 2.0, 3.0])
DT = 0.004


def sized(name, **values):
    """A fault whose numbers in the unit of the channel are not zero."""
    component = faults.get(name)
    vectors = [spec.name for spec in parameters_of(component) if spec.is_vector]
    return build(component, {**dict.fromkeys(vectors, 0.3), **values}, units=UNITS).for_period(DT)


def inputs(value=VALUE, elapsed=0.0, normal=0.0, uniform=0.5):
    like = np.asarray(value)
    return FaultInputs(like, elapsed, np.full(like.shape, normal), np.full(like.shape, uniform))


def once(law, **values):
    """The channel after one step at the onset."""
    return law.step(law.init(VALUE), inputs(**values), DT)[1].value


def flown(law, values, generator):
    """Outputs of a law over a sequence of values (steps, ..., 3); the onset is at step 3."""
    state, outputs = law.init(values[0]), []
    for index, value in enumerate(values):
        normal, uniform = generator.standard_normal(value.shape), generator.random(value.shape)
        for array in (value, normal, uniform):
            array.setflags(write=False)
        sample = FaultInputs(value, (index - 3) * DT, normal, uniform)
        state, output = law.step(state, sample, 0.0 if index == 0 else DT)
        outputs.append(output)
    return outputs


@EVERY_FAULT
@pytest.mark.parametrize("shape", [(3,), (5, 3)])
def test_output_has_the_shape_of_the_channel_and_is_a_number(name, shape):
    values = np.random.default_rng(6).standard_normal((8, *shape))
    for output in flown(sized(name), values, np.random.default_rng(7)):
        assert output.value.shape == shape
        assert output.value.dtype == np.float64
        assert np.shape(output.valid) == shape[:-1]
        assert np.asarray(output.valid).dtype == bool
        assert name == "nan" or np.all(np.isfinite(output.value))


def test_bias_adds_its_value():
    assert once(sized("bias", value=[0.1, -0.2, 0.3])).tolist() == [1.1, 1.8, 3.3]


def test_drift_grows_with_its_rate_and_is_held_after_its_rise():
    law = sized("drift", rate=[0.1, 0.2, 0.3], rise=2.0)
    np.testing.assert_allclose(once(law, elapsed=1.5), VALUE + np.array([0.15, 0.3, 0.45]), rtol=1e-15)
    np.testing.assert_allclose(once(law, elapsed=9.0), VALUE + np.array([0.2, 0.4, 0.6]), rtol=1e-15)


def test_sine_has_amplitude_frequency_and_phase():
    law = sized("sine", amplitude=[0.1, 0.2, 0.3], frequency=[1, 2, 3], phase=["0", "90 deg", "0"])
    expected = VALUE + np.array([0.1 * math.sin(0.7), 0.2 * math.cos(1.4), 0.3 * math.sin(2.1)])
    np.testing.assert_allclose(once(law, elapsed=0.7), expected, rtol=1e-14)


def test_scale_multiplies():
    np.testing.assert_allclose(once(sized("scale", factor=[0.1, 0.0, -1.0])), [1.1, 2.0, 0.0], rtol=1e-15)


def test_saturation_ends_readings_at_its_limit():
    law = sized("saturation", limit=2.0)
    assert once(law, value=[1.0, 3.0, -4.0]).tolist() == [1.0, 2.0, -2.0]


def test_noise_adds_its_standard_deviation_times_the_normal_numbers():
    np.testing.assert_allclose(
        once(sized("noise", sigma=[0.1, 0.2, 0.3]), normal=-2.0), VALUE - np.array([0.2, 0.4, 0.6])
    )


def test_nan_leaves_no_number():
    assert np.all(np.isnan(once(sized("nan"))))


def test_stuck_repeats_the_value_at_the_onset():
    values = np.arange(24.0).reshape(8, 3)
    outputs = [output.value for output in flown(sized("stuck"), values, np.random.default_rng(0))]
    np.testing.assert_array_equal(outputs, values[[0, 1, 2, 3, 3, 3, 3, 3]])


def test_stuck_between_samples_repeats_the_last_good_value():
    law = sized("stuck")
    state, _ = law.step(law.init(VALUE), inputs(elapsed=-0.001), DT)
    _, output = law.step(state, inputs(VALUE + 1.0, elapsed=0.003), DT)
    assert output.value.tolist() == VALUE.tolist()


@pytest.mark.parametrize(("delay", "samples"), [(0.0, 0), (0.008, 2), (0.009, 2), (0.011, 3)])
def test_delay_gives_the_value_of_whole_samples_ago(delay, samples):
    values = np.arange(24.0).reshape(8, 3)
    outputs = [
        output.value for output in flown(sized("delay", delay=delay), values, np.random.default_rng(0))
    ]
    np.testing.assert_array_equal(outputs, values[[max(0, index - samples) for index in range(8)]])


def test_spikes_have_one_size_and_both_signs():
    law = sized("spikes", amplitude=[0.1, 0.2, 0.3], rate=1.0 / DT)
    np.testing.assert_allclose(once(law, normal=1.0), VALUE + np.array([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(once(law, normal=-1.0), VALUE - np.array([0.1, 0.2, 0.3]))


def test_spikes_come_at_their_rate():
    law = sized("spikes", amplitude=1.0, rate=5.0)
    generator = np.random.default_rng(9)
    many = np.zeros((100_000, 3))
    sample = FaultInputs(many, 0.0, generator.standard_normal(many.shape), generator.random(many.shape))
    hit = law.step((), sample, DT)[1].value != 0.0
    assert np.mean(hit) == pytest.approx(5.0 * DT, rel=0.05)


def test_dropout_misses_samples_with_its_probability():
    law = sized("dropout", probability=0.3)
    many = np.zeros((100_000, 3))
    uniform = np.random.default_rng(10).random(many.shape)
    output = law.step((), FaultInputs(many, 0.0, many, uniform), DT)[1]
    assert np.mean(output.valid) == pytest.approx(0.7, abs=0.01)


def test_dropout_by_default_misses_every_sample():
    law = sized("dropout")
    assert not any(law.step((), inputs(uniform=number), DT)[1].valid for number in (0.0, 0.5, 1.0 - 2.0**-53))


def test_dropout_with_probability_zero_misses_no_sample():
    law = sized("dropout", probability=0.0)
    assert all(law.step((), inputs(uniform=number), DT)[1].valid for number in (0.0, 0.5))
