"""A law on a stream of stamped samples."""

import pytest

from quadftc_model.stepper import Stepper, seconds

START = 1_000_000_000  # ns
PERIOD = 4_000_000  # ns


class Recorder:
    """A law that returns the time steps it was given since it started."""

    def init(self, _inputs):
        return ()

    def step(self, state, _inputs, dt):
        state = (*state, dt)
        return state, state


@pytest.fixture
def stepper():
    stepper = Stepper(Recorder())
    stepper.step(START, None)
    return stepper


def test_first_sample_has_no_time_step():
    assert Stepper(Recorder()).step(START, None) == (0.0,)


def test_time_step_is_the_difference_of_the_stamps(stepper):
    assert stepper.step(START + PERIOD, None) == (0.0, 0.004)


@pytest.mark.parametrize("offset", [0, -1, -PERIOD])
def test_sample_that_is_not_new_changes_nothing(stepper, offset):
    assert stepper.step(START + offset, None) is None
    assert stepper.step(START + PERIOD, None) == (0.0, 0.004)


@pytest.mark.parametrize(
    ("offset", "expected"),
    [
        (PERIOD, 0.004),
        (1_000_000_000, 1.0),
        (1_000_000_001, 0.0),
        (-1_000_000_001, 0.0),
        (0, None),
        (-PERIOD, None),
    ],
)
def test_time_step_says_what_a_stamp_is(stepper, offset, expected):
    assert stepper.time_step(START + offset) == expected


@pytest.mark.parametrize("offset", [2_000_000_000, -2_000_000_000])
def test_law_starts_anew_after_a_gap_or_jump(stepper, offset):
    stepper.step(START + PERIOD, None)
    assert stepper.step(START + offset, None) == (0.0,)


def test_reset_makes_the_next_sample_the_first(stepper):
    stepper.reset()
    assert stepper.step(START, None) == (0.0,)


def test_seconds_of_a_period_are_the_nearest_float():
    assert seconds(PERIOD) == 0.004
