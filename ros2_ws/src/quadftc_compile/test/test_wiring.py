"""Laws that are wired to fly together in C: the numbers of the same laws called one by one."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_laws import Inputs, LowPass, Rotation

from quadftc_compile.build import build_library
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_compile.wiring import OneByOne, Wiring
from quadftc_model.arrays import Flag, Scalar, Vector
from quadftc_model.composition import RunnerCalls
from quadftc_model.stepper import NumpyRunner

RANDOM = np.random.default_rng(4)
COUNT = 50


class State(NamedTuple):
    slow: object
    fast: object
    spin: object
    last: Vector  # of the fast filter
    older: Vector
    empty: Vector


class Row(NamedTuple):
    value: Vector
    there: Flag
    dt: Scalar


@dataclasses.dataclass(frozen=True)
class Pair:
    """A filter of a filter, which sees only what is there, and the last of which comes back to the first."""

    slow: LowPass = dataclasses.field(default_factory=lambda: LowPass(time=0.3))
    fast: LowPass = dataclasses.field(default_factory=lambda: LowPass(time=0.05, order=2))
    spin: Rotation = dataclasses.field(default_factory=Rotation)

    @property
    def laws(self):
        return {"slow": self.slow, "fast": self.fast, "spin": self.spin}

    def init(self, calls):
        return State(
            calls.init("slow"),
            calls.init("fast"),
            calls.init("spin"),
            0.3 * np.array(self.slow.gain),
            np.zeros(3),
            np.zeros((0, 3)),
        )

    def step(self, calls, state, row):
        slow, first = calls.step("slow", state.slow, Inputs(row.value, row.there), row.dt)
        state = state._replace(slow=slow)

        def more():
            fast, second = calls.step("fast", state.fast, Inputs(first, np.True_), row.dt)
            spin, _ = calls.step("spin", state.spin, np.zeros(8), 0.5)
            return state._replace(fast=fast, spin=spin, last=second, older=state.last)

        after = calls.branch(row.there, more, lambda: state)
        return after, (first, state.last, after.older, after.last, None, np.float64(7.0))


def rows():
    dt = np.full(COUNT, 0.01)
    dt[[0, 20]] = 0.0  # both begin again at the second of them
    there = RANDOM.random(COUNT) < 0.7
    there[[0, 20]] = True
    return Row(RANDOM.normal(size=(COUNT, 3)), there, dt)


@pytest.fixture(scope="module")
def libraries():
    pair = Pair()
    return {name: build_library(recipe_of(law, law.example())) for name, law in pair.laws.items()}


def fly(composition, calls, given):
    state, outputs = composition.init(calls), []
    for k in range(COUNT):
        state, output = composition.step(calls, state, Row(*(each[k] for each in given)))
        outputs.append(output)
    return tuple(None if each[0] is None else np.array(each) for each in zip(*outputs, strict=True))


def test_wired_laws_give_the_numbers_of_laws_called_one_by_one(libraries):
    pair, given = Pair(), rows()
    found = dict(zip(pair.laws.values(), libraries.values(), strict=True))
    wanted = fly(pair, RunnerCalls(pair.laws, lambda law: CRunner(law, found[law])), given)
    numpy = fly(pair, RunnerCalls(pair.laws, NumpyRunner), given)
    wiring = Wiring(pair, libraries, Row(np.zeros(3), np.True_, 0.01), block=30)
    for _ in range(2):  # a flight leaves nothing behind
        parts = []
        for begin, count in ((0, 30), (30, 20)):
            told = wiring.run(Row(*(each[begin : begin + count] for each in given)), count)
            parts.append([None if each is None else each.copy() for each in told])
        for a, b, c, d in zip(*parts, wanted, numpy, strict=True):
            assert (a is None) == (c is None)
            if a is not None:
                assert np.array_equal(np.concatenate([a, b]), c)
                np.testing.assert_allclose(c, d, rtol=1e-12, atol=1e-14)
        wiring.begin()


def test_other_numbers_fly_in_the_same_wires_from_another_begin(libraries):
    given = rows()
    wiring = Wiring(Pair(), libraries, Row(np.zeros(3), np.True_, 0.01))
    wiring.run(given, COUNT)
    other = Pair(slow=LowPass(time=0.1, gain=(2.0, 1.0, 0.5)))
    one_by_one = OneByOne(Pair(), NumpyRunner, Row(np.zeros(3), np.True_, 0.01))
    for flown in (wiring, one_by_one):
        flown.configure(other)
    wanted = one_by_one.run(given, COUNT)
    for found, expected in zip(wiring.run(given, COUNT), wanted, strict=True):
        if expected is not None:
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
    for name in other.laws:
        state, expected = wiring.state_of(name), one_by_one.state_of(name)
        np.testing.assert_allclose(
            np.concatenate(leaves(state)), np.concatenate(leaves(expected)), rtol=1e-12
        )


def leaves(tree):
    return [leaf for each in tree for leaf in leaves(each)] if isinstance(tree, tuple) else [np.ravel(tree)]


class Deciding(Pair):
    def step(self, calls, state, row):
        return super().step(calls, state, row) if row.there else (state, row.value)


class Adding(Pair):
    def step(self, calls, state, row):
        return state, row.value + 1.0


class Swapping(Pair):
    def step(self, calls, state, row):
        return state._replace(slow=state.fast), row.value


@pytest.mark.parametrize(
    ("kind", "error", "words"),
    [
        (Deciding, TypeError, "cannot decide by a value"),
        (Adding, TypeError, "unsupported operand"),
        (Swapping, ValueError, "cannot become that of another"),
    ],
)
def test_a_composition_that_does_more_than_move_values_is_refused(libraries, kind, error, words):
    with pytest.raises(error, match=words):
        Wiring(kind(), libraries, Row(np.zeros(3), np.True_, 0.01))


def test_more_samples_than_a_block_are_refused(libraries):
    with pytest.raises(ValueError, match="at most 10"):
        Wiring(Pair(), libraries, Row(np.zeros(3), np.True_, 0.01), block=10).run(rows(), COUNT)
