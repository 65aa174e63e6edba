"""Runs a compiled law for one vehicle: states stay in C, inputs and outputs are nested tuples of NumPy."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from quadftc_compile.build import Entry, Library
from quadftc_compile.layout import Layout, flatten, leaves_of
from quadftc_compile.memory import Memory, Rows, make_reader, make_writer
from quadftc_model.numbers import number_at


class Call:
    """A function of a library with the memory of its arguments and results."""

    def __init__(self, entry: Entry, numbers: Memory, shared: dict[str, Memory]) -> None:
        # states have memory of their own; that of all else is made here
        self._memories = {
            name: Memory(layout) for name, layout in entry.arguments.items() if name not in shared
        }
        self.outputs = {name: Memory(layout) for name, layout in entry.results.items() if name not in shared}
        self.writers = {name: make_writer(each.layout, each) for name, each in self._memories.items()}
        self.readers = {name: make_reader(each.layout, each) for name, each in self.outputs.items()}
        self._entry, self._numbers = entry, numbers

    def bound(self, **states: Memory) -> Callable[[], None]:
        """Return the function on some states, without arguments."""
        places = {**self._memories, **self.outputs, **states}
        order = [*self._entry.arguments, *self._entry.results]
        return functools.partial(
            self._entry.call, self._numbers.address, *(places[name].address for name in order)
        )


class CRunner:
    """Runs a compiled law; a `quadftc_model.stepper.Runner`.

    A state is memory of C, good for the next step; the one after that takes it.
    """

    def __init__(self, law: object, library: Library) -> None:
        self._library, self._numbers = library, Memory(library.numbers_layout)
        entries = library.entries
        layout = entries["step"].arguments["before"]
        one, other = Memory(layout), Memory(layout)
        self._states = one, other
        shared = {"before": one, "after": other}
        self._init = Call(entries["init"], self._numbers, shared)
        self._step = Call(entries["step"], self._numbers, shared)
        self._resumed = Call(entries["resumed"], self._numbers, shared) if "resumed" in entries else None
        self._write_inputs, self._write_dt = self._step.writers["inputs"], self._step.writers["dt"]
        self._read_output = self._step.readers["output"]
        self._there = self._step.bound(before=one, after=other)
        self._back = self._step.bound(before=other, after=one)
        self.configure(law)

    def configure(self, law: object) -> bool:
        """Go on with the numbers of another law, which must be of the same structure."""
        self.law: Any = law
        write_numbers(self._library, law, self._numbers)
        return True

    def first(self, inputs: object) -> tuple[Memory, Any]:
        """Return state and output at the first sample."""
        return self._begin(self._init, inputs)

    def resumed(self, inputs: object, words: object) -> tuple[Memory, Any]:
        """Return state and output at a sample from which the law resumes by last words."""
        if self._resumed is None:
            raise ValueError(f"{self._library.path.name}: this law does not resume")
        self._resumed.writers["words"](words)
        return self._begin(self._resumed, inputs)

    def _begin(self, call: Call, inputs: object) -> tuple[Memory, Any]:
        call.writers["inputs"](inputs)
        call.bound(after=self._states[0])()
        return self.step(self._states[0], inputs, 0.0)

    def step(self, state: object, inputs: object, dt: float) -> tuple[Memory, Any]:
        """Advance by ``dt`` [s] to a sample; a state may also be nested tuples."""
        one, other = self._states
        if state is not one and state is not other:
            one.write(self.tree(state))
            state = one
        self._write_inputs(inputs)
        self._write_dt(dt)
        if state is one:
            self._there()
            return other, self._read_output()
        self._back()
        return one, self._read_output()

    def run(self, state: object, inputs: object, dt: ArrayLike) -> tuple[Memory, Any]:
        """Advance over many samples: inputs are nested tuples of arrays (count, ...); ``dt`` [s], too.

        An array without the first axis is the same at all samples. Return the state, outputs (count, ...).
        """
        entry, (one, other) = self._library.entries["step"], self._states
        if state is not one:
            one.write(self.tree(state))
        count = max(np.shape(dt)[0] if np.ndim(dt) else 0, *(_rows(inputs, entry.arguments["inputs"])), 0)
        given, times = Rows(entry.arguments["inputs"], count), Rows(entry.arguments["dt"], count)
        given.write(inputs)
        times.write(dt)
        made = Rows(entry.results["output"], count)
        memories = (self._numbers, one, other, given, times, made)
        entry.run(*(each.address for each in memories), count)
        return one, made.read()

    def tree(self, state: object) -> Any:
        """Return the nested tuples of a state: copies."""
        return state.read() if isinstance(state, Memory) else state


def _rows(tree: object, layout: Layout) -> list[int]:
    """Return how many rows each array has that has one more axis than in the layout."""
    leaves = zip(flatten(layout, tree, shapes=False), leaves_of(layout), strict=True)
    return [np.shape(each)[0] for each, leaf in leaves if np.ndim(each) > len(leaf.shape)]


def numbers_in(library: Library, law: object) -> Memory:
    """Return the memory of the numbers of a law."""
    memory = Memory(library.numbers_layout)
    write_numbers(library, law, memory)
    return memory


def write_numbers(library: Library, law: object, memory: Memory) -> None:
    """Write the numbers of a law of the structure that a library is for."""
    for path, view in zip(library.numbers, memory.leaves(), strict=True):
        view[...] = number_at(law, path)
