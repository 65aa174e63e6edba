"""A guarded law: what it says where the law cannot be used, and when it starts again."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import where
from quadftc_model.guarded import Guarded
from quadftc_model.stepper import NumpyRunner


class Inputs(NamedTuple):
    value: Any
    there: Any


@dataclasses.dataclass(frozen=True)
class Sum:
    """The integral of a value, which starts at 100 and says half of it; -1 is its fallback."""

    def init(self, inputs):
        return (where(inputs.there, inputs.value * 0.0 + 100.0, np.nan), np.int64(3))

    def step(self, state, inputs, dt):
        total = state[0] + inputs.value * dt
        return (total, state[1]), 0.5 * total

    def resumed(self, inputs, words):
        return (words, np.int64(3))

    def ready(self, inputs):
        return inputs.there

    def usable(self, output):
        return abs(output) < 1e3

    def fallback(self, inputs, output):
        return where(inputs.there, -1.0, -1.0)


def run(values, there=None):
    runner, said = NumpyRunner(Guarded(Sum())), []
    there = [True] * len(values) if there is None else there
    given = [Inputs(np.float64(v), np.bool_(t)) for v, t in zip(values, there, strict=True)]
    state, output = runner.first(given[0])
    said.append(output)
    for each in given[1:]:
        state, output = runner.step(state, each, 1.0)
        said.append(output)
    return [(float(each.said), bool(each.failed), bool(each.starts)) for each in said]


def test_a_law_that_can_be_used_is_left_alone():
    assert run([5.0, 2.0, 4.0]) == [(50.0, False, False), (51.0, False, False), (53.0, False, False)]


def test_after_an_output_that_cannot_be_used_it_starts_at_the_next_sample():
    assert run([5.0, 1e4, 2.0, 2.0])[1:] == [(-1.0, True, True), (50.0, False, False), (51.0, False, False)]


def test_a_state_that_is_not_finite_is_noticed():
    class Hidden(Sum):
        def step(self, state, inputs, dt):
            state, _ = super().step(state, inputs, dt)
            return state, np.float64(1.0)

    law = Guarded(Hidden())
    one = Inputs(np.float64(np.inf), np.True_)
    _, output = law.step(law.init(Inputs(np.float64(1.0), np.True_)), one, 1.0)
    assert (output.said, output.failed, output.starts) == (-1.0, True, True)


def test_it_waits_for_a_sample_to_start_with_and_that_is_no_failure():
    assert run([5.0, 2.0, 2.0, 2.0], [False, False, True, True]) == [
        (-1.0, False, True),
        (-1.0, False, True),
        (50.0, False, False),
        (51.0, False, False),
    ]


def test_it_resumes_by_last_words():
    law, inputs = Guarded(Sum()), Inputs(np.float64(2.0), np.True_)
    _, output = law.step(law.resumed(inputs, np.float64(30.0)), inputs, 0.0)
    assert output.said == 15.0
    assert not output.starts


def test_many_flights_are_guarded_each_by_itself():
    law = Guarded(Sum())
    first = Inputs(np.array([1.0, 1.0, 1.0]), np.array([True, True, False]))
    state = law.init(first)
    state, output = law.step(state, first, np.zeros(3))
    assert output.starts.tolist() == [False, False, True]
    state, output = law.step(state, Inputs(np.array([2.0, 1e9, 4.0]), np.full(3, True)), np.ones(3))
    assert output.said.tolist() == [51.0, -1.0, 50.0]
    assert output.failed.tolist() == [False, True, False]
