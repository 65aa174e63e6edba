# pyright: basic
"""Sums, products of matrices and other reductions in C."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

from quadftc_compile.emit import Emitter, JoinedError, Storage, statement
from quadftc_compile.graph import VIEWS, Node
from quadftc_compile.operators import BITS, combine
from quadftc_compile.plan import FEW
from quadftc_compile.text import Expression, Index, Indices, binary, placed, variable

WRITTEN_OUT = 16  # terms of a sum that are written out in one expression
REDUCTIONS = {"reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min"}
REDUCTIONS |= {"reduce_and": "and", "reduce_or": "or", "reduce_xor": "xor"}
ROWS = 4  # parts of an array, of which one number each is tested at once
DENSE = 8  # times each number of a matrix is read, from which on it pays to copy it
CUMULATIVE = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}
NEUTRAL = {"add": 0, "mul": 1, "and": True, "or": False, "xor": False}

Term = Callable[[Indices, Indices], Expression]  # of the indices of the result, and of those summed over


@statement(*REDUCTIONS)
def reduce(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write a reduction over axes."""
    (x,), axes = node.operands, sorted(node.params["axes"])
    kept = [k for k in range(len(x.shape)) if k not in axes]

    def term(at: Indices, inner: Indices) -> Expression:
        place = dict(zip(kept, at, strict=True)) | dict(zip(axes, inner, strict=True))
        return emitter.at(x, [place[k] for k in range(len(x.shape))])

    fold(emitter, node, storage, REDUCTIONS[node.op], [x.shape[k] for k in axes], term)


@statement("dot_general")
def contract(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write a product of matrices, (batch, free of a, free of b), summed over what they share."""
    a, b = node.operands
    (over_a, over_b), (batch_a, batch_b) = node.params["dimension_numbers"]
    free_a = [k for k in range(len(a.shape)) if k not in (*over_a, *batch_a)]
    free_b = [k for k in range(len(b.shape)) if k not in (*over_b, *batch_b)]
    batch = len(batch_a)
    if node.size * math.prod(a.shape[k] for k in over_a) > DENSE * b.size:
        b = _beside(emitter, b, [*batch_b, *over_b, *free_b])

    def term(at: Indices, inner: Indices) -> Expression:
        of_a, of_b = at[batch : batch + len(free_a)], at[batch + len(free_a) :]
        place_a = _places((batch_a, at[:batch]), (free_a, of_a), (over_a, inner))
        place_b = _places((batch_b, at[:batch]), (free_b, of_b), (over_b, inner))
        return binary("*", emitter.at(a, place_a), emitter.at(b, place_b))

    fold(emitter, node, storage, "add", [a.shape[k] for k in over_a], term)


def _beside(emitter: Emitter, node: Node, order: Sequence[int]) -> Node:
    """Return an array with its axes in an order in which what is read in turn lies side by side."""
    if list(order) == sorted(order) and node.op not in VIEWS:
        return node
    shape = [node.shape[k] for k in order]
    copied = Node("transpose", (node,), {"permutation": tuple(order)}, tuple(shape), node.dtype, node.source)
    storage = emitter.declare(shape, node.dtype)
    emitter.copy(copied, storage)
    emitter.keep(copied, storage)
    back = tuple(list(order).index(k) for k in range(len(order)))
    return Node("transpose", (copied,), {"permutation": back}, node.shape, node.dtype, node.source)


def _places(*parts: tuple[Sequence[int], Indices]) -> list[Index]:
    """Return indices by axis."""
    found = {axis: index for axes, indices in parts for axis, index in zip(axes, indices, strict=True)}
    return [found[k] for k in range(len(found))]


def fold(emitter: Emitter, node: Node, storage: Storage, op: str, count: Sequence[int], term: Term) -> None:
    """Write a reduction by an operation: for each number of a node, its terms over inner indices."""
    terms, shape = math.prod(count), node.shape
    inner = [[Index(k) for k in place] for place in itertools.product(*(range(n) for n in count))]
    if terms == 0:
        neutral = float(NEUTRAL[op]) if node.dtype.kind == "f" else NEUTRAL[op]
        emitter.each(shape, lambda at: emitter.put(storage, shape, at, emitter.literal(neutral)))
    elif terms <= WRITTEN_OUT or node.size * terms <= 2 * FEW * WRITTEN_OUT:

        def whole(at: Indices) -> str:
            total = term(at, inner[0])
            for each in inner[1:]:
                total = combine(op, node.dtype, total, term(at, each))
            return emitter.put(storage, shape, at, total)

        emitter.each(shape, whole)
    elif node.size == 1 and node.dtype.kind == "b" and op in BITS:
        _fold_flags(emitter, node, storage, op, count, term)
    else:
        _fold_in_loops(emitter, node, storage, op, count, term)


def _fold_flags(
    emitter: Emitter, node: Node, storage: Storage, op: str, count: Sequence[int], term: Term
) -> None:
    """Write a reduction of flags to one: of all of them, with bits as wide as numbers, in vectors."""
    first, bits = [Index() for _ in node.shape], emitter.name("v")
    emitter.line(f"int64_t {bits} = {int(NEUTRAL[op])};")
    (flags,) = node.operands
    if op == "and" and flags.op == "is_finite" and emitter.lies(flags.operands[0]) and flags.size % ROWS == 0:
        # 0 x is 0 for every finite x, NaN for others, and so are sums of these: some tests at once
        zero, length = emitter.literal(0.0).text, flags.size // ROWS
        x = emitter.storage_of(flags.operands[0])

        def test(at: Indices) -> str:
            places = (emitter.place(x, [flags.size], [at[0] + k * length]) for k in range(ROWS))
            return f"{bits} &= {' + '.join(f'{zero} * {each}' for each in places)} == {zero};"

        emitter.each([length], test, loop=True)
    else:
        emitter.each(count, lambda inner: f"{bits} {BITS[op]}= {term(first, inner).text};", loop=True)
    emitter.line(emitter.put(storage, node.shape, first, Expression(f"{bits} != 0")))


def _fold_in_loops(
    emitter: Emitter,
    node: Node,
    storage: Storage,
    op: str,
    count: Sequence[int],
    term: Term,
    around: Mapping[int, Index] | None = None,
) -> None:
    """Write a reduction as loops over its terms, around one over the last axis of its result.

    So the numbers of a row lie side by side, and are in reach while their terms come. ``around`` are places
    along all other axes: of a loop, or one that is known.
    """
    shape = node.shape
    long = [k for k, n in enumerate(shape) if n != 1]
    if around is None:
        around = {k: variable(emitter.name("i")) for k in long[:-1]}
    place = [around.get(k, Index()) for k in range(len(shape))]
    try:
        term(place, [Index() for _ in count])
    except JoinedError as joined:
        axis = next((k for k, index in around.items() if index.factor_of(joined.variable)), None)
        if axis is None:
            raise
        for k in range(shape[axis]):
            _fold_in_loops(emitter, node, storage, op, count, term, {**around, axis: Index(k)})
        return
    loops = {k: name for k, index in around.items() for name, _ in index.terms}
    for k, name in loops.items():
        emitter.open(f"for (int {name} = 0; {name} < {shape[k]}; {name}++)")
    _fold_row(emitter, node, storage, op, count, term, place, long[-1] if long else -1)
    for _ in loops:
        emitter.close()


def _fold_row(
    emitter: Emitter,
    node: Node,
    storage: Storage,
    op: str,
    count: Sequence[int],
    term: Term,
    place: Indices,
    row: int,
) -> None:
    """Write reductions for all numbers along an axis of the result, ``row``, at a place along the others."""
    names = [emitter.name("j") for _ in count]
    first, inner = [Index() for _ in count], [variable(name) for name in names]
    shape = [n if k == row else 1 for k, n in enumerate(node.shape)]
    # a few sums are variables while their terms come, so that none waits for memory
    few = math.prod(shape) <= FEW
    sums = Node("input", (), {}, tuple(shape), node.dtype) if few else node
    if few:
        emitter.keep(sums, emitter.declare(shape, node.dtype, looped=False))

    def at_row(at: Indices) -> list[Index]:
        return [at[k] if k == row else index for k, index in enumerate(place)]

    def number(at: Indices) -> Expression:
        return emitter.at(sums, at if few else at_row(at))

    def more(at: Indices) -> str:
        return f"{number(at).text} = {combine(op, node.dtype, number(at), term(at_row(at), inner)).text};"

    # the first term begins the sum, the others are added in the order of their indices
    emitter.each(shape, lambda at: f"{number(at).text} = {term(at_row(at), first).text};")
    for k, name in enumerate(names):
        emitter.open(f"for (int {name} = {int(len(names) == 1)}; {name} < {count[k]}; {name}++)")
    if len(names) > 1:
        emitter.line(f"if ({' + '.join(names)} == 0) continue;")
    emitter.each(shape, more)
    for _ in names:
        emitter.close()
    if few:
        emitter.each(shape, lambda at: emitter.put(storage, node.shape, at_row(at), number(at)))


@statement(*CUMULATIVE)
def accumulate(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write sums of all elements up to each one along an axis."""
    (x,), axis, shape = node.operands, node.params["axis"], node.shape
    backwards, op = node.params["reverse"], CUMULATIVE[node.op]
    others = [n if k != axis else 1 for k, n in enumerate(shape)]
    first = shape[axis] - 1 if backwards else 0

    def start(at: Indices) -> str:
        place = placed(at, axis, Index(first))
        return emitter.put(storage, shape, place, emitter.at(x, place))

    emitter.each(others, start)
    name = emitter.name("j")
    emitter.open(f"for (int {name} = 1; {name} < {shape[axis]}; {name}++)")
    step = variable(name) * (-1 if backwards else 1) + first
    last = step + (1 if backwards else -1)

    def more(at: Indices) -> str:
        so_far = Expression(emitter.place(storage, shape, placed(at, axis, last)))
        place = placed(at, axis, step)
        return emitter.put(storage, shape, place, combine(op, node.dtype, so_far, emitter.at(x, place)))

    emitter.each(others, more)
    emitter.close()


@statement("argmax", "argmin", addressed=True)
def find_extreme(emitter: Emitter, node: Node, storage: Storage) -> None:
    """Write where the largest or smallest element along an axis is: the first, and NaN before all others."""
    (x,), (axis,) = node.operands, node.params["axes"]
    sign = ">" if node.op == "argmax" else "<"
    kept = [k for k in range(len(x.shape)) if k != axis]
    name = emitter.name("j")
    emitter.each(node.shape, lambda at: emitter.put(storage, node.shape, at, emitter.literal(0)))
    emitter.open(f"for (int {name} = 1; {name} < {x.shape[axis]}; {name}++)")
    source, step = emitter.storage_of(x), math.prod(x.shape[axis + 1 :])

    def better(at: Indices) -> str:
        place = dict(zip(kept, at, strict=True)) | {axis: Index()}
        base = [place[k] for k in range(len(x.shape))]
        best = emitter.place(storage, node.shape, at)
        old = f"{emitter.place(source, x.shape, base)[:-1]} + {step} * {best}]"
        new = emitter.at(x, placed(base, axis, variable(name))).text
        return f"if ({new} {sign} {old} || ({new} != {new} && {old} == {old})) {best} = {name};"

    emitter.each(node.shape, better)
    emitter.close()
