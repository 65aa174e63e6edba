# pyright: basic
"""Steps of one vehicle, compiled by JAX: the same functions, many times as fast as under NumPy.

A step of a large law is a thousand operations on a few numbers each, and the interpreter takes a microsecond
for every one. Compiled, all of them are one call. What goes in and out lies in one vector of floats each, as
a call costs by the number of its arrays.

Compiled numbers differ from NumPy's by rounding. On one machine, they are the same in every process.
JAX is imported only by what is compiled.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Array
from quadftc_model.jax_settings import environment, keep_compiled_code, settle_precision

SETTLING = 5  # steps in which the structure of a state may still change
# what JAX raises where a law cannot be traced
UNTRACEABLE = (TypeError, AttributeError, NotImplementedError, ValueError)
PERIOD = 0.004  # s; of the steps that a law is prepared with

Step = Callable[[Any, Any, Any], tuple[Any, Any]]  # state, inputs, dt [s] -> state, output


def jax_on_cpu() -> Any:
    """Return JAX, set up for double precision and short calls; a ValueError if it is not installed."""
    if "jax" not in sys.modules:
        os.environ.update(environment())
    try:
        import jax
    except ModuleNotFoundError:
        raise ValueError("compiled: needs JAX, which is not installed (pip install jax)") from None
    settle_precision(float32=False)
    keep_compiled_code()
    # a second thread takes as long as a step
    jax.config.update("jax_cpu_enable_async_dispatch", False)  # pyright: ignore[reportUnknownMemberType]
    return jax


@dataclasses.dataclass(frozen=True)
class Packing:
    """How the numbers of nested tuples lie in one vector of floats."""

    structure: Any  # of the tuples, as JAX describes it
    parts: tuple[tuple[tuple[int, ...], np.dtype[Any]], ...]  # shape and type of each array or number

    @classmethod
    def of(cls, tree: Any) -> Packing:
        """Return the packing of nested tuples."""
        import jax

        leaves, structure = jax.tree.flatten(tree)
        shapes = [getattr(leaf, "shape", ()) for leaf in leaves]
        dtypes = [np.dtype(getattr(leaf, "dtype", type(leaf))) for leaf in leaves]
        return cls(structure, tuple(zip(shapes, dtypes, strict=True)))

    @functools.cached_property
    def places(self) -> list[Any]:
        """Where each part lies: an index of a single number, else a slice."""
        ends = np.cumsum([0, *(math.prod(shape) for shape, _ in self.parts)]).tolist()
        rows = zip(self.parts, ends, ends[1:], strict=False)
        return [slice(first, end) if shape else first for (shape, _), first, end in rows]

    @functools.cached_property
    def rows(self) -> list[Any]:
        """Type and place of each part."""
        return [(dtype, place) for (_, dtype), place in zip(self.parts, self.places, strict=True)]

    @functools.cached_property
    def dtypes(self) -> list[Any]:
        """Types that there are."""
        return list({dtype for _, dtype in self.parts})

    @functools.cached_property
    def matrices(self) -> list[tuple[int, tuple[int, ...]]]:
        """Numbers and shapes of the parts that have more than one axis."""
        return [(number, shape) for number, (shape, _) in enumerate(self.parts) if len(shape) > 1]

    @functools.cached_property
    def size(self) -> int:
        """Length of the vector."""
        return sum(math.prod(shape) for shape, _ in self.parts)

    def vector(self, tree: Any) -> Array | None:
        """Return the vector of nested tuples of NumPy; None if they have another structure."""
        import jax

        leaves, structure = jax.tree.flatten(tree)
        if structure != self.structure:
            return None
        for number, _ in self.matrices:
            leaves[number] = leaves[number].ravel()
        vector = np.empty(self.size)
        for place, leaf in zip(self.places, leaves, strict=True):
            vector[place] = leaf
        return vector

    def tree(self, vector: Array) -> Any:
        """Return the nested tuples of a vector, in NumPy or JAX."""
        import jax

        of_type = {dtype: vector.astype(dtype) for dtype in self.dtypes}
        leaves = [of_type[dtype][place] for dtype, place in self.rows]
        for number, shape in self.matrices:
            leaves[number] = leaves[number].reshape(shape)
        return jax.tree.unflatten(self.structure, leaves)


class CompiledStep:
    """A step, compiled for the structure of a state and inputs.

    A ValueError with the ``name`` of what it is a step of says why it cannot be compiled. The state must have
    numbers that change: else XLA makes more than one kernel of the step.
    """

    def __init__(self, name: str, step: Step, state: Any, inputs: Any) -> None:
        jax = jax_on_cpu()
        from quadftc_model.staged_step import StagedStep

        self.state, self.inputs = Packing.of(state), Packing.of((inputs, PERIOD))

        def join(tree: Any) -> Any:
            leaves = [jax.numpy.ravel(leaf).astype(float) for leaf in jax.tree.leaves(tree)]
            return jax.numpy.concatenate(leaves)

        def only_lane(tree: Any) -> Any:
            return jax.tree.map(lambda leaf: leaf[..., None], tree)

        def run(state: Any, inputs: Any) -> tuple[Any, Any]:
            def advance(_: int, carried: tuple[Any, Any]) -> tuple[Any, Any]:
                before = self.state.tree(carried[0])
                after = staged(only_lane(before), only_lane(self.inputs.tree(inputs)), ())
                return join(after[0]), join(after[1])

            # XLA makes one kernel of a loop (`jax_settings`); dt is positive, so it runs once
            steps = (inputs[-1] > 0.0).astype(int)
            return jax.lax.fori_loop(0, steps, advance, (state, jax.numpy.zeros(self.output.size)))

        first, seen = jax.tree.map(jax.numpy.asarray, (state, (inputs, PERIOD)))
        try:
            staged = StagedStep(lambda state, inputs, _: step(state, inputs[0], inputs[1]), first, seen, ())
            after, self.output = map(Packing.of, staged.shapes)
            if after != self.state:
                raise ValueError("the numbers of its state change their shape")
            vectors = np.zeros(self.state.size), np.zeros(self.inputs.size)
            self._run = jax.jit(run).lower(*vectors).compile()
        except UNTRACEABLE as error:
            words = str(error).splitlines()[0]
            raise ValueError(f"compiled: JAX cannot compile {name}: {words}") from error

    def __call__(self, state: Array, inputs: Any, dt: float) -> tuple[Array, Any] | None:
        """Step from a vector of the state to the next one and the output; None: the inputs do not fit."""
        vector = self.inputs.vector((inputs, dt))
        if vector is None:
            return None
        after, output = self._run(state, vector)
        return after, self.output.tree(np.asarray(output))


class Packed(NamedTuple):
    """A state of a compiled law."""

    vector: Array
    packing: Packing

    @property
    def tree(self) -> Any:
        """The state as the law knows it."""
        return self.packing.tree(np.asarray(self.vector))


class CompiledLaw:
    """A law whose steps are compiled for inputs like some; its first steps, and any others, run in NumPy."""

    def __init__(self, law: Any, inputs: Any) -> None:
        jax_on_cpu()
        self.law = law
        state, _ = law.step(law.init(inputs), inputs, 0.0)
        for _ in range(SETTLING):
            before, (state, _) = state, law.step(state, inputs, PERIOD)
            if Packing.of(before) == Packing.of(state):
                break
        self._step = CompiledStep(type(law).__name__, law.step, state, inputs)

    def step(self, state: Any, inputs: Any, dt: float) -> tuple[Any, Any]:
        """Advance as the law does; the state may be `Packed`, before and after."""
        packing = self._step.state
        if dt > 0.0:
            if not isinstance(state, Packed) and Packing.of(state) == packing:
                state = Packed(packing.vector(state), packing)
            if isinstance(state, Packed) and (stepped := self._step(state.vector, inputs, dt)) is not None:
                return Packed(stepped[0], packing), stepped[1]
        return self.law.step(state.tree if isinstance(state, Packed) else state, inputs, dt)
