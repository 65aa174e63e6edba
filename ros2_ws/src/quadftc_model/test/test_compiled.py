"""Compiled steps: the numbers of NumPy, for inputs of one structure."""

import sys
from typing import Any, NamedTuple

import numpy as np
import pytest

from quadftc_model.arrays import namespace
from quadftc_model.compiled import CompiledLaw, Packed
from quadftc_model.stepper import Stepper

PERIOD = 4_000_000  # ns


class State(NamedTuple):
    """Everything that the state of a law may consist of."""

    matrix: Any  # (3, 3)
    vector: Any  # (3,)
    elapsed: Any
    above: Any  # bool
    kind: Any  # (3,) uint8


class Mixed:
    """A law with all of it, that remembers the last input once it has one."""

    def init(self, inputs):
        return State(np.eye(3), np.zeros(3), 0.0, np.bool_(False), np.zeros(3, np.uint8)), ()

    def step(self, state, inputs, dt):
        (matrix, vector, elapsed, _, _), last = state
        push, extra = inputs
        xp = namespace(push)
        vector = vector + dt * (matrix @ xp.sin(push)) + (last[0] if last else 0.0)
        matrix = matrix + dt * vector[:, None] * push
        kind = xp.where(vector > 0.0, 3, 1).astype(xp.uint8)
        after = State(matrix, vector, elapsed + dt, xp.any(vector > 1.0), kind), (0.1 * push,)
        return after, (vector if extra is None else vector + extra, after[0].above, kind)


class Stateless:
    """A law that remembers nothing."""

    def init(self, inputs):
        return ()

    def step(self, state, inputs, dt):
        return state, 2.0 * inputs


class Branching(Mixed):
    """A law that decides by data."""

    def step(self, state, inputs, dt):
        return super().step(state, inputs, dt if inputs[0].sum() > -9.0 else 0.0)


def test_compiled_law_gives_the_numbers_of_numpy_whatever_the_inputs():
    plain, compiled = Stepper(Mixed()), Stepper(Mixed())
    compiled.compile((np.zeros(3), None))
    rng = np.random.default_rng(1)
    for index in range(1, 20):
        # in between one that it was not compiled for
        inputs = rng.normal(size=3), np.ones(3) if index == 9 else None
        expected, actual = plain.step(index * PERIOD, inputs), compiled.step(index * PERIOD, inputs)
        for a, b in zip((*actual, *compiled.state[0]), (*expected, *plain.state[0]), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)
            assert np.result_type(a) == np.result_type(b)
    assert isinstance(compiled._state, Packed)
    assert plain.state[0].matrix[0, 1] != 0.0


def test_law_without_a_state_is_run_in_numpy():
    stepper = Stepper(Stateless())
    stepper.compile(np.zeros(3))
    for index in range(1, 4):
        assert stepper.step(index * PERIOD, np.full(3, float(index))).tolist() == [2.0 * index] * 3


def test_law_that_decides_by_data_is_refused_by_name():
    with pytest.raises(ValueError, match=r"^compiled: JAX cannot compile Branching: "):
        CompiledLaw(Branching(), (np.zeros(3), None))


def test_missing_jax_is_said_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(ValueError, match=r"^compiled: needs JAX, which is not installed"):
        CompiledLaw(Mixed(), (np.zeros(3), None))
