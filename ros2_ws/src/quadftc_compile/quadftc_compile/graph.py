# pyright: basic
"""A traced function as a graph of operations on arrays.

JAX traces a function to a jaxpr. Here the functions that it calls are put in their places. Equal operations
are done once, operations whose results nobody reads are left out, and constants are folded.

Nothing is simplified that would change a number. ``0 * x`` stays, as x may be NaN, and so does ``x + 0``, as
x may be -0. ``1 * x``, ``x / 1`` and ``x - 0`` are x for every x.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from quadftc_model.arrays import AnyArray

# functions that a jaxpr calls, with the name of the parameter that holds them
CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "remat": "jaxpr",
    "checkpoint": "jaxpr",
}
SAME = ("copy", "copy_p", "stop_gradient", "optimization_barrier", "reduce_precision")
# which elements an array has, not what they are: no arithmetic
VIEWS = ("reshape", "transpose", "broadcast_in_dim", "slice", "rev", "take", "concatenate")
# operations that NumPy does exactly as C: correctly rounded, or not rounded at all
EXACT: dict[str, np.ufunc] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "max": np.maximum,
    "min": np.minimum,
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
}
LARGEST_POWER = 8  # x^n is written as products up to this n

Params = dict[str, Any]  # of a primitive of JAX, or of an operation here


class UntraceableError(ValueError):
    """A function that cannot be compiled: where, what it does, and how to write it."""


class Shaped(Protocol):
    """What has the shape and the type of an array."""

    @property
    def shape(self) -> tuple[int, ...]:
        """How long it is along each axis."""
        ...

    @property
    def dtype(self) -> np.dtype:
        """The type of its numbers."""
        ...


Shapes = Sequence[Shaped]


@dataclasses.dataclass(frozen=True)
class Source:
    """Where in the law an operation stands."""

    file: str
    line: int
    function: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.function}"


@dataclasses.dataclass(eq=False, slots=True)
class Node:
    """One array: the result of an operation on others, an input (no operands), or a constant (``value``)."""

    op: str
    operands: tuple[Node, ...]
    params: Params
    shape: tuple[int, ...]
    dtype: np.dtype
    source: Source | None = None
    value: AnyArray | None = None

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return math.prod(self.shape)

    @property
    def is_constant(self) -> bool:
        """Whether its numbers are known."""
        return self.value is not None


@dataclasses.dataclass
class Graph:
    """Operations in an order in which they can be done."""

    inputs: list[Node]
    outputs: list[Node]
    nodes: list[Node]  # what the outputs need, without constants and inputs

    @property
    def operations(self) -> int:
        """How many operations on numbers there are, those of loops and branches counted once."""
        inside = [graph for node in self.nodes for graph in node.params.get("graphs", ())]
        own = sum(node.size for node in self.nodes if node.op not in VIEWS)
        return own + sum(graph.operations for graph in inside)


def graph_of(closed: Any, source_of: Callable[[Any], Source | None]) -> Graph:
    """Return the graph of a closed jaxpr; ``source_of`` says where an equation stands in the law."""
    return _Builder(source_of).build(closed.jaxpr, closed.consts)


class _Builder:
    """Turns equations into nodes."""

    def __init__(self, source_of: Callable[[Any], Source | None]) -> None:
        self._source_of = source_of
        self._known: dict[tuple[object, ...], Node] = {}  # by what is computed: equal ones are one
        self._nodes: list[Node] = []

    def build(self, jaxpr: Any, constants: Sequence[ArrayLike]) -> Graph:
        """Return the graph of a jaxpr."""
        inputs = [Node("input", (), {}, tuple(v.aval.shape), np.dtype(v.aval.dtype)) for v in jaxpr.invars]
        outputs = self._run(jaxpr, [self.constant(each) for each in constants], inputs, None)
        return Graph(inputs, outputs, _needed(self._nodes, outputs))

    def constant(self, value: ArrayLike, dtype: DTypeLike | None = None) -> Node:
        """Return a constant."""
        array = np.asarray(value, dtype)
        key = ("constant", array.shape, array.dtype.str, array.tobytes())
        if key not in self._known:
            self._known[key] = Node("constant", (), {}, array.shape, array.dtype, value=array)
        return self._known[key]

    def add(
        self, op: str, operands: Sequence[Node], like: Shaped, source: Source | None, **params: Any
    ) -> Node:
        """Return the result of an operation, of the shape and type of ``like``."""
        shape, dtype = tuple(like.shape), np.dtype(like.dtype)
        simple = self._simplified(op, operands, shape, dtype, params)
        if simple is not None:
            return simple
        known = repr(sorted((key, repr(value)) for key, value in params.items()))
        key = (op, *(id(each) for each in operands), shape, dtype.str, known)
        if key not in self._known:
            node = Node(op, tuple(operands), params, shape, dtype, source)
            self._known[key] = node
            self._nodes.append(node)
        return self._known[key]

    def _run(
        self, jaxpr: Any, constants: Sequence[Node], inputs: Sequence[Node], outer: Source | None
    ) -> list[Node]:
        """Put the equations of a jaxpr in; those of a function that is called stand where the call does."""
        values: dict[object, Node] = dict(zip(jaxpr.constvars, constants, strict=True))
        values |= zip(jaxpr.invars, inputs, strict=True)

        def value_of(atom: Any) -> Node:
            return self.constant(atom.val, atom.aval.dtype) if hasattr(atom, "val") else values[atom]

        for equation in jaxpr.eqns:
            operands = [value_of(atom) for atom in equation.invars]
            source = outer or self._source_of(equation)
            results = self._apply(equation, operands, source, outer)
            values |= zip(equation.outvars, results, strict=True)
        return [value_of(atom) for atom in jaxpr.outvars]

    def _apply(
        self, equation: Any, operands: list[Node], source: Source | None, outer: Source | None
    ) -> list[Node]:
        """Return the results of an equation; ``outer`` is where the function is called that it stands in."""
        name, params, out = equation.primitive.name, equation.params, [v.aval for v in equation.outvars]
        if name in CALLS:
            closed = params[CALLS[name]]
            jaxpr = getattr(closed, "jaxpr", closed)
            constants = [self.constant(each) for each in getattr(closed, "consts", ())]
            return self._run(jaxpr, constants, operands, source)
        if name in ("scan", "cond"):
            return self._control(name, params, operands, out, source, outer)
        rule = _RULES.get(name)
        if rule is not None:
            results = rule(self, operands, out, source, params)
            return results if isinstance(results, list) else [results]
        if len(out) > 1:
            return self._whole(name, operands, out, source, dict(params))
        return [self.add(name, operands, out[0], source, **params)]

    def _whole(
        self, name: str, operands: Sequence[Node], out: Shapes, source: Source | None, params: Params
    ) -> list[Node]:
        """Return the results of what has several."""
        whole = Node(name, tuple(operands), params, (), np.dtype(float), source)
        self._nodes.append(whole)
        results = [self.add("result", [whole], each, source, index=k) for k, each in enumerate(out)]
        params["results"] = results
        return results

    def _control(
        self,
        name: str,
        params: Params,
        operands: list[Node],
        out: Shapes,
        source: Source | None,
        outer: Source | None,
    ) -> list[Node]:
        """Keep a loop or a branch, with graphs of their own for what is inside."""
        if name == "cond" and operands[0].op == "platform_index":
            closed = params["branches"][operands[0].params["index"]]
            constants = [self.constant(each) for each in closed.consts]
            return self._run(closed.jaxpr, constants, operands[1:], source)
        parts = [params["jaxpr"]] if name == "scan" else list(params["branches"])
        graphs = [graph_of(each, lambda equation: outer or self._source_of(equation)) for each in parts]
        kept = {key: params[key] for key in _COUNTS if key in params}
        return self._whole(name, operands, out, source, {**kept, "graphs": graphs})

    def _simplified(
        self, op: str, operands: Sequence[Node], shape: tuple[int, ...], dtype: np.dtype, params: Params
    ) -> Node | None:
        """Return what an operation comes to without being done; None if it has to be done."""
        if not operands:
            return None
        if op in VIEWS:
            return self._simplified_view(op, operands, shape, dtype, params)
        if op == "convert_element_type" and operands[0].dtype == dtype:
            return operands[0]
        if all(each.is_constant for each in operands):
            known = _evaluated(op, [each.value for each in operands], dtype)
            if known is not None:
                return self.constant(known, dtype)
        if op == "select_n":
            return _selected(operands, shape)
        if dtype.kind == "f" and len(operands) == 2:
            return _neutral(op, operands, shape)
        if dtype.kind == "b" and len(operands) == 2 and op in ("and", "or"):
            return _logical(op, operands, shape)
        return None

    def _simplified_view(
        self, op: str, operands: Sequence[Node], shape: tuple[int, ...], dtype: np.dtype, params: Params
    ) -> Node | None:
        first = operands[0]
        if op != "concatenate" and first.shape == shape and _is_identity(op, params, shape):
            return first
        if all(each.is_constant for each in operands):
            return self.constant(view(op, [each.value for each in operands], params), dtype)
        if op == "concatenate" and len(operands) == 1:
            return first
        if op == "reshape" and first.op == "reshape":
            return self.add("reshape", first.operands, _Like(shape, dtype), first.source, shape=shape)
        return None


def _evaluated(op: str, values: Sequence[Any], dtype: np.dtype) -> AnyArray | None:
    """Return what an operation on constants is; None if a library might give another number."""
    if op == "convert_element_type":
        return values[0].astype(dtype)
    exact = {**EXACT, **(LOGICAL if dtype.kind == "b" else {"div": np.divide} if dtype.kind == "f" else {})}
    with np.errstate(all="ignore"):
        return exact[op](*values) if op in exact else None


def _selected(operands: Sequence[Node], shape: tuple[int, ...]) -> Node | None:
    """Return what a choice of two comes to where it is known, or both are the same."""
    which, *cases = operands
    if len(cases) != 2:
        return None
    if cases[0] is cases[1]:
        return cases[0]
    picks = np.unique(which.value.astype(int)) if which.value is not None else ()
    return cases[int(picks[0])] if len(picks) == 1 and cases[int(picks[0])].shape == shape else None


LOGICAL = {"and": np.logical_and, "or": np.logical_or, "xor": np.logical_xor, "not": np.logical_not}


@dataclasses.dataclass(frozen=True)
class _Like:
    """A shape and a type."""

    shape: tuple[int, ...]
    dtype: np.dtype


_COUNTS = ("num_consts", "num_carry", "length", "reverse")  # of scan


def _neutral(op: str, operands: Sequence[Node], shape: tuple[int, ...]) -> Node | None:
    """Return x for 1 x, x 1, x / 1 and x - 0."""
    x, y = operands
    if op in ("mul", "div") and _is_all(y, 1.0) and x.shape == shape:
        return x
    if op == "mul" and _is_all(x, 1.0) and y.shape == shape:
        return y
    if op == "sub" and _is_all(y, 0.0) and x.shape == shape and not np.any(np.signbit(y.value)):  # type: ignore[arg-type]
        return x
    return None


def _logical(op: str, operands: Sequence[Node], shape: tuple[int, ...]) -> Node | None:
    """Return what `and` and `or` come to where one side is known, or both are the same."""
    x, y = operands
    if x is y:
        return x
    for known, other in ((x, y), (y, x)):
        if _is_all(known, op == "and") and other.shape == shape:
            return other
        if _is_all(known, op == "or") and known.shape == shape:
            return known
    return None


def _is_all(node: Node, number: float) -> bool:
    return node.value is not None and bool(np.all(node.value == number))


def _is_identity(op: str, params: Params, shape: tuple[int, ...]) -> bool:
    """Whether a view of an array of the same shape is the array."""
    if op == "transpose":
        return tuple(params["permutation"]) == tuple(range(len(shape)))
    if op == "rev":
        return not params["dimensions"]
    return op != "take" or params["places"] == tuple(range(shape[params["axis"]]))


def view(op: str, values: Sequence[Any], params: Params) -> AnyArray:
    """Return a view of arrays."""
    x = values[0]
    if op == "reshape":
        return x.reshape(params["shape"])
    if op == "transpose":
        return x.transpose(params["permutation"])
    if op == "slice":
        strides = params["strides"] or (1,) * x.ndim
        ends = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
        return x[tuple(slice(*each) for each in ends)]
    if op == "rev":
        return np.flip(x, params["dimensions"])
    if op == "take":
        return np.take(x, params["places"], axis=params["axis"])
    if op == "concatenate":
        return np.concatenate(values, axis=params["dimension"])
    shape, places = params["shape"], params["broadcast_dimensions"]
    whole = [1] * len(shape)
    for axis, place in enumerate(places):
        whole[place] = x.shape[axis]
    return np.broadcast_to(x.reshape(whole), shape)


def _needed(nodes: Sequence[Node], outputs: Iterable[Node]) -> list[Node]:
    """Return the nodes that the outputs need, in their order."""
    wanted = {id(each) for each in outputs}
    kept: list[Node] = []
    for node in reversed(nodes):
        if id(node) in wanted:
            kept.append(node)
            wanted.update(id(each) for each in node.operands)
    return kept[::-1]


# what a primitive of JAX is here; other names stay as they are
Rule = Callable[[_Builder, list[Node], Shapes, "Source | None", Params], "Node | list[Node]"]
_RULES: dict[str, Rule] = {}


def _rule(*names: str) -> Callable[[Rule], Rule]:
    def add(rule: Rule) -> Rule:
        _RULES.update(dict.fromkeys(names, rule))
        return rule

    return add


@_rule(*SAME)
def _same(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> list[Node]:
    return x


@_rule("squeeze", "expand_dims", "reshape")
def _reshape(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    return b.add("reshape", x, out[0], source, shape=tuple(out[0].shape))


@_rule("broadcast_in_dim")
def _broadcast(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    places = tuple(int(each) for each in params["broadcast_dimensions"])
    shape = tuple(out[0].shape)
    if x[0].size == math.prod(shape):  # axes of length 1 come in
        return b.add("reshape", x, out[0], source, shape=shape)
    return b.add("broadcast_in_dim", x, out[0], source, shape=shape, broadcast_dimensions=places)


@_rule("gather")
def _gather(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    """Return rows at places that are known along one axis, but the last, as a view."""
    numbers, rest = params["dimension_numbers"], list(x[0].shape)
    axis, places = numbers.start_index_map[0], x[1].value
    others = tuple(k for k in range(len(rest)) if k != axis)
    along = numbers.collapsed_slice_dims == (axis,) == numbers.start_index_map
    if along and numbers.offset_dims == others and axis < len(rest) - 1 and places is not None:
        inside = places.ndim == 2 and bool(np.all((places >= 0) & (places < rest[axis])))
        rest[axis] = 1
        if inside and list(params["slice_sizes"]) == rest:
            return b.add("take", x[:1], out[0], source, axis=axis, places=tuple(map(int, places[:, 0])))
    return b.add("gather", x, out[0], source, **params)


@_rule("concatenate")
def _concatenate(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    parts = [each for each in x if each.size] or x[:1]
    return b.add("concatenate", parts, out[0], source, dimension=int(params["dimension"]))


@_rule("stack")
def _stack(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    axis, shape = int(params["axis"]) % len(out[0].shape), list(out[0].shape)
    shape[axis] = 1
    like = _Like(tuple(shape), out[0].dtype)
    parts = [b.add("reshape", [each], like, source, shape=tuple(shape)) for each in x]
    return b.add("concatenate", parts, out[0], source, dimension=axis)


@_rule("tile")
def _tile(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    times, dtype = [int(n) for n in params["reps"]], out[0].dtype
    apart = tuple(n for each in x[0].shape for n in (1, each))
    spread = tuple(n for r, each in zip(times, x[0].shape, strict=True) for n in (r, each))
    one = b.add("reshape", x, _Like(apart, dtype), source, shape=apart)
    places = tuple(range(len(spread)))
    many = b.add(
        "broadcast_in_dim", [one], _Like(spread, dtype), source, shape=spread, broadcast_dimensions=places
    )
    return b.add("reshape", [many], out[0], source, shape=tuple(out[0].shape))


@_rule("split")
def _split(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> list[Node]:
    axis, at, parts = params["axis"], 0, list[Node]()
    for each in out:
        start, limit = [0] * len(each.shape), list(x[0].shape)
        start[axis], limit[axis] = at, at + each.shape[axis]
        at = limit[axis]
        where = {"start_indices": tuple(start), "limit_indices": tuple(limit), "strides": None}
        parts.append(b.add("slice", x, each, source, **where))
    return parts


@_rule("convert_element_type")
def _convert(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    return b.add("convert_element_type", x, out[0], source)


@_rule("integer_pow")
def _power(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    exponent = int(params["y"])
    if not 0 < abs(exponent) <= LARGEST_POWER:
        return b.add("pow", [*x, b.constant(float(exponent))], out[0], source)
    found, square = None, x[0]
    left = abs(exponent)
    while left:  # by repeated squaring
        if left % 2:
            found = square if found is None else b.add("mul", [found, square], out[0], source)
        left //= 2
        if left:
            square = b.add("mul", [square, square], out[0], source)
    assert found is not None
    if exponent > 0:
        return found
    one = b.constant(np.ones((), out[0].dtype))
    return b.add("div", [_spread(b, one, out[0]), found], out[0], source)


@_rule("add_any")
def _add(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    """Add two slopes."""
    return b.add("add", x, out[0], source)


@_rule("square")
def _square(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    return b.add("mul", [x[0], x[0]], out[0], source)


@_rule("clamp")
def _clamp(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    low, value, high = (_spread(b, each, out[0]) for each in x)
    return b.add("min", [b.add("max", [value, low], out[0], source), high], out[0], source)


@_rule("iota")
def _iota(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    shape, axis = tuple(out[0].shape), params["dimension"]
    count = np.arange(shape[axis], dtype=out[0].dtype)
    order = [1] * len(shape)
    order[axis] = -1
    return b.constant(np.broadcast_to(count.reshape(order), shape).copy())


@_rule("platform_index")
def _platform(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    platforms = params["platforms"]
    index = next(
        (k for k, names in enumerate(platforms) if names is None or "cpu" in names), len(platforms) - 1
    )
    return Node("platform_index", (), {"index": index}, (), np.dtype(np.int32))


@_rule("pad")
def _pad(b: _Builder, x: list[Node], out: Shapes, source: Source | None, params: Params) -> Node:
    return b.add(
        "pad", x, out[0], source, config=tuple(tuple(map(int, each)) for each in params["padding_config"])
    )


def _spread(b: _Builder, node: Node, like: Shaped) -> Node:
    """Return a node, of one number perhaps, with the shape of another."""
    if node.shape == tuple(like.shape):
        return node
    shape = tuple(like.shape)
    if node.value is not None:
        return b.constant(np.broadcast_to(node.value, shape).copy())
    typed = _Like(shape, node.dtype)
    return b.add("broadcast_in_dim", [node], typed, node.source, shape=shape, broadcast_dimensions=())
