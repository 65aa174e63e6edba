# pyright: basic
"""Elements at places that are found while running: gather, scatter, slices that move; and padding."""

from __future__ import annotations

import math
from collections.abc import Sequence

from quadftc_compile.emit import Emitter, Storage, statement
from quadftc_compile.graph import Node, UntraceableError
from quadftc_compile.text import Expression, Index, Indices, binary, call, choice, flat, variable

FILLED = "FILL_OR_DROP"  # mode of JAX: beyond the end there is nothing


def clamped(emitter: Emitter, node: Node, most: int) -> Index:
    """Declare an index that is a number of the law, within 0 and ``most``; return it."""
    name = emitter.name("d")
    number = call("within", emitter.at(node, [Index()] * len(node.shape)), Expression(str(most)))
    emitter.line(f"const int {name} = (int){number.text};")
    return variable(name)


@statement("dynamic_slice", addressed=True)
def slice_at(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write a slice that begins where numbers say."""
    x, *starts = node.operands
    offsets = [
        clamped(emitter, start, n - size)
        for start, n, size in zip(starts, x.shape, node.params["slice_sizes"], strict=True)
    ]

    def put(at: Indices) -> str:
        place = [k + offset for k, offset in zip(at, offsets, strict=True)]
        return emitter.put(storage, node.shape, at, emitter.at(x, place))

    emitter.each(node.shape, put)


@statement("dynamic_update_slice", addressed=True)
def update_at(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write an array with a part exchanged that begins where numbers say."""
    x, update, *starts = node.operands
    emitter.copy(x, storage)
    offsets = [
        clamped(emitter, start, n - size)
        for start, n, size in zip(starts, x.shape, update.shape, strict=True)
    ]

    def put(at: Indices) -> str:
        place = [k + offset for k, offset in zip(at, offsets, strict=True)]
        return emitter.put(storage, x.shape, place, emitter.at(update, at))

    emitter.each(update.shape, put)


@statement("pad")
def pad(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write an array with something around it, and between its elements."""
    x, filling = node.operands
    config = node.params["config"]
    if any(low < 0 or high < 0 for low, high, _ in config):
        raise UntraceableError(f"{node.source or 'it'}: padding by less than nothing is not known in C")
    emitter.each(node.shape, lambda at: emitter.put(storage, node.shape, at, emitter.at(filling, [])))

    def put(at: Indices) -> str:
        place = [k * (1 + between) + low for k, (low, _, between) in zip(at, config, strict=True)]
        return emitter.put(storage, node.shape, place, emitter.at(x, at))

    emitter.each(x.shape, put)


@statement("gather", addressed=True)
def gather(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write what is at indices (XLA's gather)."""
    x, indices = node.operands
    numbers, sizes = node.params["dimension_numbers"], node.params["slice_sizes"]
    batch = [k for k in range(len(node.shape)) if k not in numbers.offset_dims]
    free = [
        k
        for k in range(len(x.shape))
        if k not in (*numbers.collapsed_slice_dims, *numbers.operand_batching_dims)
    ]
    filled = FILLED in str(node.params["mode"])

    def put(at: Indices) -> str:
        group = [at[k] for k in batch]
        place = [Index() for _ in x.shape]
        for k, offset in zip(free, numbers.offset_dims, strict=True):
            place[k] = at[offset]
        for k, axis in zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True):
            place[k] = group[axis]
        where, inside = _moved(emitter, x, indices, numbers.start_index_map, sizes, group, filled)
        value = Expression(f"{emitter.storage_of(x).name}[{emitter.index(flat(x.shape, place))}{where}]")
        if inside is not None:
            nothing = float("nan") if node.dtype.kind == "f" else node.params["fill_value"] or 0
            value = choice(inside, value, emitter.literal(nothing))
        return emitter.put(storage, node.shape, at, value)

    emitter.each(node.shape, put)


def _moved(
    emitter: Emitter,
    x: Node,
    indices: Node,
    axes: Sequence[int],
    sizes: Sequence[int],
    group: Indices,
    checked: bool,
) -> tuple[str, Expression | None]:
    """Return what indices add to a place among all of an array, and a test whether they are inside of it."""
    added, inside = "", None
    for number, axis in enumerate(axes):
        index, most = emitter.at(indices, [*group, Index(number)]), x.shape[axis] - sizes[axis]
        step = math.prod(x.shape[axis + 1 :])
        added += f" + {step} * (int){call('within', index, Expression(str(most))).text}"
        if checked:
            low = binary(">=", index, Expression("0"))
            test = binary("&&", low, binary("<=", index, Expression(str(most))))
            inside = test if inside is None else binary("&&", inside, test)
    return added, inside


@statement("scatter", "scatter-add", addressed=True)
def scatter(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write an array with what is at indices exchanged, or added to (XLA's scatter)."""
    x, indices, update = node.operands
    numbers = node.params["dimension_numbers"]
    emitter.copy(x, storage)
    batch = [k for k in range(len(update.shape)) if k not in numbers.update_window_dims]
    free = [
        k
        for k in range(len(x.shape))
        if k not in (*numbers.inserted_window_dims, *numbers.operand_batching_dims)
    ]
    sizes = [1] * len(x.shape)
    for k, axis in zip(free, numbers.update_window_dims, strict=True):
        sizes[k] = update.shape[axis]
    sign = "+=" if node.op == "scatter-add" else "="

    def put(at: Indices) -> str:
        group = [at[k] for k in batch]
        place = [Index() for _ in x.shape]
        for k, axis in zip(free, numbers.update_window_dims, strict=True):
            place[k] = at[axis]
        for k, axis in zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True):
            place[k] = group[axis]
        where, inside = _moved(emitter, x, indices, numbers.scatter_dims_to_operand_dims, sizes, group, True)
        target = f"{storage.name}[{emitter.index(flat(x.shape, place))}{where}]"
        change = f"{target} {sign} {emitter.at(update, at).text};"
        return change if inside is None else f"if ({inside.text}) {change}"

    emitter.each(update.shape, put)
