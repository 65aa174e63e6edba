"""Delay lines: the values of the last samples, of a fixed number, oldest first.

A line holds NamedTuples of arrays and None, nested or not, with any leading axes. Its own axis is behind
those: a vector (..., 3) becomes (..., count, 3), a flag (...) becomes (..., count).
"""

from __future__ import annotations

import dataclasses
from typing import TypeVar, cast

from quadftc_model.arrays import Array, Components, alike, namespace

T = TypeVar("T")


def fill_line(value: T, count: int, leading: int) -> T:
    """Return a line of ``count`` values that are all alike, with so many ``leading`` axes."""
    if isinstance(value, tuple):
        parts = cast("tuple[object, ...]", value)
        return alike(parts, [fill_line(each, count, leading) for each in parts])
    if value is None:
        return value
    xp = namespace(value)
    array = xp.expand_dims(xp.asarray(value), leading)
    return xp.broadcast_to(array, (*array.shape[:leading], count, *array.shape[leading + 1 :]))


def shift_line(line: T, value: T, leading: int) -> tuple[T, T]:
    """Put a value at the end of a line; return the line, and the value that leaves it at its beginning."""
    if isinstance(line, tuple):
        lines, values = cast("tuple[object, ...]", line), cast("tuple[object, ...]", value)
        parts = [shift_line(a, b, leading) for a, b in zip(lines, values, strict=True)]
        return alike(lines, [kept for kept, _ in parts]), alike(lines, [out for _, out in parts])
    if value is None:
        return line, value
    array: Array = line
    xp, before = namespace(line, value), (slice(None),) * leading
    if array.shape[leading] == 0:
        return line, value
    longer = xp.concatenate([array, xp.expand_dims(xp.asarray(value), leading)], axis=leading)
    return longer[(*before, slice(1, None))], longer[(*before, 0)]


@dataclasses.dataclass(frozen=True, eq=False)
class DelayLine:
    """A law that says what its input (..., n) was ``count`` samples before; at first, what it was first."""

    like: Components  # an input (n,), for the compiler
    count: int

    def example(self) -> Components:
        """Return an input."""
        return self.like

    def init(self, inputs: Components) -> Components:
        """Return the line (..., count, n) before the first sample."""
        return fill_line(inputs, self.count, inputs.ndim - 1)

    def step(self, state: Components, inputs: Components, dt: float) -> tuple[Components, Components]:
        """Put an input into the line; return the one that leaves it."""
        return shift_line(state, inputs, inputs.ndim - 1)
