"""What every law keeps: a state of one structure, batches of vehicles, the same in JAX, inputs unchanged."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadftc_model.numbers import numbers_of, with_numbers

DT = 0.004  # s, between two samples


def structure(tree: Any) -> Any:
    """Return kinds of tuples, shapes and types of nested tuples of arrays."""
    if tree is None:
        return None
    if isinstance(tree, tuple):
        return type(tree).__name__, *(structure(each) for each in tree)
    dtype = tree.dtype if hasattr(tree, "dtype") else np.asarray(tree).dtype
    return np.shape(tree), np.dtype(dtype).name


def stacked(trees: list[Any]) -> Any:
    """Return nested tuples with a leading axis for several, read-only."""
    first = trees[0]
    if isinstance(first, tuple):
        parts = [stacked(list(each)) for each in zip(*trees, strict=True)]
        return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)
    if first is None:
        return None
    array = np.stack([np.asarray(each) for each in trees])
    array.setflags(write=False)
    return array


def flown(law: Any, sequence: list[Any], init: Any = None, step: Any = None) -> list[Any]:
    """Return state and output after each of a sequence of inputs; the first step takes no time."""
    state, found = (init or law.init)(sequence[0]), []
    for index, inputs in enumerate(sequence):
        state, output = (step or law.step)(state, inputs, DT if index else 0.0)
        found.append((state, output))
    return found


def outputs_of(law: Any, sequence: list[Any]) -> list[Any]:
    """Return the output at each of a sequence of inputs; the first step takes no time."""
    return [output for _, output in flown(law, sequence)]


def flown_in_jax(law: Any, sequence: list[Any]) -> list[Any]:
    """The same, compiled with the numbers of the law as arguments."""
    import jax

    numbers = numbers_of(law)
    init = jax.jit(lambda values, inputs: with_numbers(law, values).init(inputs))
    step = jax.jit(lambda values, *given: with_numbers(law, values).step(*given))
    with jax.enable_x64(True):
        found = flown(law, sequence, lambda inputs: init(numbers, inputs), lambda *args: step(numbers, *args))
        return [jax.tree.map(np.asarray, each) for each in found]


def assert_alike(found: Any, expected: Any, lane: Any = (), rtol: float = 1e-12, atol: float = 1e-13) -> None:
    """Assert that nested tuples have the same arrays; of the found ones, in a ``lane``.

    ``atol`` is for entries up to 1, and grows with the largest of an array.
    """
    if isinstance(expected, tuple):
        for a, b in zip(found, expected, strict=True):
            assert_alike(a, b, lane, rtol, atol)
    elif expected is None:
        assert found is None
    else:
        array, wanted = np.asarray(found)[lane], np.asarray(expected)
        assert array.dtype == wanted.dtype
        size = np.max(np.abs(wanted), initial=1.0, where=np.isfinite(wanted))
        np.testing.assert_allclose(array, wanted, rtol, atol * size)


def assert_step_is_traced(law: Any, inputs: Any) -> None:
    """Assert that JAX traces init and step, all numbers of the law unknown, to the structure NumPy gives."""
    import jax

    numbers = numbers_of(law)

    def traced(values: list[Any], state: Any, inputs: Any, dt: Any) -> Any:
        unknown = with_numbers(law, dict(zip(numbers, values, strict=True)))
        return unknown.init(inputs), unknown.step(state, inputs, dt)

    with jax.enable_x64(True):
        state = law.init(inputs)
        arguments = list(numbers.values()), state, inputs, DT
        _, (begun, after) = jax.make_jaxpr(traced, return_shape=True)(*arguments)
    assert structure(begun) == structure(state)
    assert structure(after) == structure(law.step(state, inputs, DT))


def assert_contract(law: Any, lanes: list[list[Any]], compiled: bool = True, **tolerances: float) -> None:
    """Assert what every law keeps, on the sequences of inputs of some vehicles.

    If not ``compiled``, without what a compiler of JAX takes long for: the same numbers.
    """
    first, others = structure(law.init(lanes[0][0])), [flown(law, sequence) for sequence in lanes]
    assert all(structure(state) == first for state, _ in others[0])
    together = [stacked(list(each)) for each in zip(*lanes, strict=True)]
    assert_step_is_traced(law, lanes[0][1])
    assert_step_is_traced(law, together[1])
    batch = flown(law, together)
    for lane, alone in enumerate(others):
        for many, one in zip(batch, alone, strict=True):
            assert_alike(many, one, lane, **tolerances)
    for here, there in zip(flown_in_jax(law, lanes[0]) if compiled else others[0], others[0], strict=True):
        assert_alike(here, there, **tolerances)
