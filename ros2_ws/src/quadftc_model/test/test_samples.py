"""Cleaning of IMU samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import UNUSABLE, ImuSample, is_usable, sanitised, usable

TRUE = np.bool_(True)
CHANNELS = {"q_xyzw": "attitude_valid", "body_rate": "rate_valid", "specific_force": "force_valid"}


def sample():
    attitude = quaternion_from_euler(np.array([0.1, 0.2, 0.3]))
    return ImuSample(attitude, np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 9.8]), TRUE, TRUE, TRUE)


def test_good_sample_is_unchanged_bit_for_bit():
    for before, after in zip(sample(), sanitised(sample()), strict=True):
        assert np.array_equal(before, after)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(("channel", "flag"), CHANNELS.items())
def test_channel_with_a_number_that_is_none_is_absent(channel, flag, number):
    dirty = sample()
    dirty = dirty._replace(**{channel: np.where(np.arange(len(getattr(dirty, channel))) == 1, number, 0.5)})
    clean = sanitised(dirty)
    assert not getattr(clean, flag)
    assert np.all(np.isfinite(getattr(clean, channel)))


@pytest.mark.parametrize("flag", CHANNELS.values())
def test_other_channels_stay_when_one_is_absent(flag):
    clean = sanitised(sample()._replace(**{flag: np.bool_(False)}))
    assert [name for name in CHANNELS.values() if not getattr(clean, name)] == [flag]


@pytest.mark.parametrize(
    ("length", "good"), [(0.0, False), (0.98, False), (0.995, True), (1.005, True), (1.02, False)]
)
def test_quaternion_off_unit_length_is_no_attitude(length, good):
    dirty = sample()
    assert bool(sanitised(dirty._replace(q_xyzw=length * dirty.q_xyzw)).attitude_valid) is good


def test_batch_is_cleaned_vehicle_by_vehicle():
    good, bad = sample(), sample()._replace(body_rate=np.array([np.nan, 0.0, 0.0]))
    batch = ImuSample(*(np.stack(pair) for pair in zip(good, bad, strict=True)))
    assert sanitised(batch).rate_valid.tolist() == [True, False]


@given(arrays(np.float64, 3, elements=st.one_of(st.floats(), st.floats(-2e6, 2e6))))
def test_a_vector_is_usable_if_it_is_finite_and_not_absurd(vector):
    assert is_usable(vector) == bool(np.all(np.isfinite(vector)) and np.max(np.abs(vector)) < UNUSABLE)
    assert is_usable(np.zeros(3), vector) == is_usable(vector)
    assert usable(np.zeros((2, 3)), np.stack([vector, np.zeros(3)])).tolist() == [is_usable(vector), True]
