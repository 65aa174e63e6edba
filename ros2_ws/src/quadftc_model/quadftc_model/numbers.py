"""The numbers of a law, and its structure.

A law is a frozen dataclass, and so are its parts (a vehicle, another law). Their texts, whole numbers,
switches and shapes are the *structure*: a step is compiled for it. Their floats and arrays are *numbers*,
each with a path (``vehicle.inertia``): the compiled step takes them as arguments.

A property that is `prepared` has what follows from parameters alone and need not be traced: a validation, an
inverse, a set of facets. It is computed once, in NumPy; its results are numbers like any others.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np

from quadftc_model.arrays import AnyArray, alike

Numbers = AnyArray

prepared = functools.cached_property  # of a frozen dataclass: what follows from its parameters, once
LABEL = {"quadftc_label": True}  # metadata of a field that people read, and no law


def structure_of(part: object) -> Hashable:
    """Return what two parts must have in common to share a compiled step; hashable."""
    return tuple(
        (path, number.shape, number.dtype.kind)
        if number is not None
        else (path, type(node).__qualname__, None if _is_container(node) else node)
        for path, node, number in _walk(part)
    )


def numbers_of(part: object) -> dict[str, Numbers]:
    """Return the numbers of a part, by path."""
    return {path: number for path, _, number in _walk(part) if number is not None}


def number_at(part: object, path: str) -> Numbers:
    """Return the number of a part at a path."""
    found = part_at(part, path)
    number = _as_number(found)
    if number is None:
        raise ValueError(f"{path}: {found!r} is no number")
    return number


def part_at(part: Any, path: str) -> Any:
    """Return what a part has at a path, as it is: a tracer of JAX, say."""
    for name in path.split(".") if path else ():
        part = part[int(name)] if name.isdecimal() else getattr(part, name)
    return part


def with_numbers(part: Any, values: Mapping[str, object], path: str = "") -> Any:
    """Return the part at a path with other numbers, unchecked: they may be tracers of JAX."""
    if path in values:
        return values[path]
    start = f"{path}." if path else ""
    if not any(name.startswith(start) for name in values):
        return part
    inside = {name: with_numbers(each, values, f"{start}{name}") for name, each in _children(part)}
    if isinstance(part, tuple):
        return alike(cast("tuple[object, ...]", part), inside.values())
    changed = copy.copy(part)
    for name, value in inside.items():
        object.__setattr__(changed, name, value)
    return changed


def _walk(part: object, path: str = "") -> Iterator[tuple[str, object, Numbers | None]]:
    """Yield every part, the inner ones after those that they are in; with its numbers, if it is some."""
    number = _as_number(part)
    yield path, part, number
    if number is None:
        for name, inside in _children(part):
            yield from _walk(inside, f"{path}.{name}" if path else name)


def _as_number(part: object) -> Numbers | None:
    """Return a float, an array, or a tuple of floats, as an array; None for anything else."""
    if isinstance(part, (float, np.ndarray)):
        return np.asarray(part)
    if isinstance(part, tuple) and part and all(isinstance(each, float) for each in part):  # pyright: ignore
        return np.asarray(part, np.float64)
    return None


def _children(part: object) -> list[tuple[str, object]]:
    if isinstance(part, tuple):
        parts = cast("tuple[object, ...]", part)
        names: Sequence[object] = getattr(parts, "_fields", range(len(parts)))
        return [(str(name), each) for name, each in zip(names, parts, strict=True)]
    return [(name, getattr(part, name)) for name in _names(type(part))] if _is_container(part) else []  # pyright: ignore


def _is_container(part: object) -> bool:
    return isinstance(part, tuple) or dataclasses.is_dataclass(part)


@functools.cache
def _names(kind: type) -> list[str]:
    """Names of the fields of a part, but labels, and of what is prepared (a mixer, say)."""
    members = [(name, value) for each in kind.__mro__ for name, value in vars(each).items()]
    derived = [name for name, value in members if isinstance(value, functools.cached_property)]
    fields = [field.name for field in dataclasses.fields(kind) if not field.metadata.get("quadftc_label")]
    return [*fields, *dict.fromkeys(derived)]
