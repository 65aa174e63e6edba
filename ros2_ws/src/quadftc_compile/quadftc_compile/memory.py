"""Nested tuples in and out of memory that C reads and writes, in few operations of the interpreter."""

from __future__ import annotations

import collections
import math
from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from quadftc_compile.layout import Layout, Leaf, flatten, kind_of, leaves_of, numpy_type, unflatten
from quadftc_model.arrays import AnyArray

Bytes = NDArray[np.uint8]
TAKEN = 4  # arrays of one shape and type that are copied at once, and then told apart


class Memory:
    """The memory of one struct."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._leaves = leaves_of(layout)
        size = max(numpy_type(layout).itemsize, 1)
        whole = np.zeros(-(-size // 8), np.float64)  # so that it is aligned
        self.bytes: Bytes = whole.view(np.uint8)[:size]
        self.address: int = whole.ctypes.data
        self._views = [_view(self.bytes, leaf) for leaf in self._leaves]

    def write(self, tree: object) -> None:
        """Write nested tuples; ValueError if they have another structure."""
        for view, leaf in zip(self._views, flatten(self.layout, tree), strict=True):
            view[...] = leaf

    def read(self) -> Any:
        """Return nested tuples of copies."""
        return unflatten(self.layout, iter([view.copy()[()] for view in self._views]))

    def leaves(self) -> list[AnyArray]:
        """Return views of all arrays, in the order of the layout."""
        return self._views

    def view(self) -> Any:
        """Return nested tuples of views, which change with the memory."""
        return unflatten(self.layout, iter(self._views))


class Rows:
    """The memory of many structs, one after the other."""

    def __init__(self, layout: Layout, count: int) -> None:
        self.layout = layout
        self.size = max(numpy_type(layout).itemsize, 1)  # bytes of one
        whole = np.zeros(-(-count * self.size // 8) + 1, np.float64)
        self._bytes: Bytes = whole.view(np.uint8)[: count * self.size].reshape(count, self.size)
        self.address: int = whole.ctypes.data
        self._columns = [self._column(leaf) for leaf in leaves_of(layout)]

    def _column(self, leaf: Leaf) -> AnyArray:
        end = leaf.offset + leaf.size * leaf.dtype.itemsize
        column = self._bytes[:, leaf.offset : end].view(leaf.dtype)
        return column.reshape(-1, *leaf.shape) if leaf.shape else column[:, 0]

    def write(self, tree: object, count: int | None = None) -> None:
        """Write nested tuples of arrays (count, ...), or (...) where all rows are alike."""
        for column, leaf in zip(self._columns, flatten(self.layout, tree, shapes=False), strict=True):
            column[:count] = leaf

    def row(self, row: int) -> Any:
        """Return the nested tuples of one row."""
        return unflatten(self.layout, iter([each[row] for each in self._columns]))

    def write_row(self, row: int, tree: object) -> None:
        """Write the nested tuples of one row."""
        for column, leaf in zip(self._columns, flatten(self.layout, tree), strict=True):
            column[row] = leaf

    def view(self, count: int | None = None) -> Any:
        """Return nested tuples of views (count, ...), which change with the memory."""
        return unflatten(self.layout, iter([each[:count] for each in self._columns]))

    def read(self) -> Any:
        """Return nested tuples of arrays (count, ...)."""
        return unflatten(self.layout, iter([np.ascontiguousarray(each) for each in self._columns]))


def _view(memory: Bytes, leaf: Leaf) -> AnyArray:
    end = leaf.offset + leaf.size * leaf.dtype.itemsize
    return memory[leaf.offset : end].view(leaf.dtype).reshape(leaf.shape)


def make_writer(layout: Layout, memory: Memory) -> Callable[[object], None]:
    """Return a function that writes nested tuples, as `Memory.write`, but without a check of each shape."""
    names: dict[str, Any] = {}
    lines = ["def write(x):"]
    for number, leaf in enumerate(leaves_of(layout)):
        source = _access(layout, leaf.path)
        if leaf.shape:
            names[f"v{number}"] = _view(memory.bytes, leaf)
            lines.append(f"    v{number}[...] = {source}")
        else:
            kind = leaf.dtype.name
            names[kind] = memory.bytes[: len(memory.bytes) // leaf.dtype.itemsize * leaf.dtype.itemsize].view(
                leaf.dtype
            )
            lines.append(f"    {kind}[{leaf.offset // leaf.dtype.itemsize}] = {source}")
    lines.append("    return")
    exec("\n".join(lines), names)
    return names["write"]


def _access(layout: Layout, path: tuple[str, ...]) -> str:
    """Return the text of what is at a path of nested tuples."""
    found = "x"
    for name in path:
        fields = [field for field, _ in layout[2]]
        found += f".{name}" if layout[1] else f"[{fields.index(name)}]"
        layout = layout[2][fields.index(name)][1]
    return found


def make_reader(layout: Layout, memory: Memory) -> Callable[[], Any]:
    """Return a function that reads nested tuples as `Memory.read`: arrays of one shape and type at a time."""
    leaves = leaves_of(layout)
    groups: dict[tuple[str, tuple[int, ...]], list[int]] = collections.defaultdict(list)
    for number, leaf in enumerate(leaves):
        groups[leaf.dtype.name, leaf.shape].append(number)
    names: dict[str, Any] = {"new": cast("Any", tuple).__new__}  # a third of the time of a NamedTuple's own
    lines = ["def read():"]
    for (kind, shape), members in groups.items():
        dtype, size = np.dtype(kind), leaves[members[0]].size
        source = memory.bytes[: len(memory.bytes) // dtype.itemsize * dtype.itemsize].view(dtype)
        starts = np.array([leaves[k].offset // dtype.itemsize for k in members])
        if not shape:
            names[kind] = source
            lines += [f"    r{k} = {kind}[{start}]" for k, start in zip(members, starts, strict=True)]
        elif len(members) < TAKEN:
            names |= {f"copy{k}": _view(memory.bytes, leaves[k]).copy for k in members}
            lines += [f"    r{k} = copy{k}()" for k in members]
        else:
            group = f"_{kind}_{'_'.join(map(str, shape))}"
            names[f"take{group}"] = source.take
            names[f"where{group}"] = (starts[:, None] + np.arange(size)).reshape(len(members), *shape)
            lines.append(f"    g = take{group}(where{group})")
            lines += [f"    r{k} = g[{place}]" for place, k in enumerate(members)]

    def build(inside: Layout, numbers: Iterator[int]) -> str:
        if inside[0] == "none":
            return "None"
        if inside[0] == "array":
            if math.prod(inside[2]):
                return f"r{next(numbers)}"
            names[name := f"k{len(names)}"] = np.zeros(inside[2], inside[1])
            return name
        parts = [build(each, numbers) for _, each in inside[2]]
        content = f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"
        if not inside[1]:
            return content
        name = f"k{len(names)}"
        names[name] = kind_of(inside[1])
        return f"new({name}, {content})"

    lines.append(f"    return {build(layout, iter(range(len(leaves))))}")
    exec("\n".join(lines), names)
    return names["read"]
