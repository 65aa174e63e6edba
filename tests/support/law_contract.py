"""What every law keeps: a state of one structure, and a step that is traced with all its numbers unknown."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadftc_model.numbers import numbers_of, with_numbers


def structure(tree: Any) -> Any:
    """Return kinds of tuples, shapes and types of nested tuples of arrays."""
    if tree is None:
        return None
    if isinstance(tree, tuple):
        return type(tree).__name__, *(structure(each) for each in tree)
    dtype = tree.dtype if hasattr(tree, "dtype") else np.asarray(tree).dtype
    return np.shape(tree), np.dtype(dtype).name


def states_of(law: Any, sequence: list[Any], dt: float = 0.004) -> list[Any]:
    """Return the states from `init` on over a sequence of inputs; the first step takes no time."""
    states = [law.init(sequence[0])]
    for index, inputs in enumerate(sequence):
        states.append(law.step(states[-1], inputs, dt if index else 0.0)[0])
    return states


def assert_state_keeps_its_structure(law: Any, sequence: list[Any]) -> None:
    """Assert that all states over a sequence of inputs have the structure of the first."""
    first, *others = map(structure, states_of(law, sequence))
    for other in others:
        assert other == first


def assert_step_is_traced(law: Any, inputs: Any) -> None:
    """Assert that JAX traces init and step, all numbers of the law unknown, to the structure NumPy gives."""
    import jax

    numbers = numbers_of(law)

    def traced(values: list[Any], state: Any, inputs: Any, dt: Any) -> Any:
        unknown = with_numbers(law, dict(zip(numbers, values, strict=True)))
        return unknown.init(inputs), unknown.step(state, inputs, dt)

    with jax.enable_x64(True):
        state = law.init(inputs)
        arguments = list(numbers.values()), state, inputs, 0.004
        _, (begun, after) = jax.make_jaxpr(traced, return_shape=True)(*arguments)
    assert structure(begun) == structure(state)
    assert structure(after) == structure(law.step(state, inputs, 0.004))
