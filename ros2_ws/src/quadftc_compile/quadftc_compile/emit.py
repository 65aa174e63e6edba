# pyright: basic
"""C statements of a graph: a loop for an array, one statement for a number.

An operation is written where its result is used if that is once; else its result is kept in a variable. Views
(slices, transposes, broadcasts) are no statements: they only change indices. Arrays of up to `FEW` numbers are
written number by number, larger ones as loops, which a C compiler turns into vector instructions.

The order of sums is that of the indices, and nothing is rearranged: the same graph gives the same numbers
wherever it stands.
"""

from __future__ import annotations

import collections
import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from quadftc_compile.graph import VIEWS, Graph, Node, Untraceable

FEW = 4  # numbers of an array that is written number by number
WRITTEN_OUT = 8  # terms of a sum that are written out
LONGEST = 24  # operations in one statement

C_TYPES = {"f8": "double", "f4": "float", "b1": "bool", "u1": "uint8_t", "i4": "int32_t", "i8": "int64_t"}
C_TYPES |= {"u4": "uint32_t", "u8": "uint64_t", "i1": "int8_t", "i2": "int16_t", "u2": "uint16_t"}

# number by number: operands in braces
OPERATORS = {"add": "{} + {}", "sub": "{} - {}", "mul": "{} * {}", "neg": "-{}"}
OPERATORS |= {"eq": "{} == {}", "ne": "{} != {}", "lt": "{} < {}", "le": "{} <= {}", "gt": "{} > {}"}
OPERATORS |= {"ge": "{} >= {}"}
FUNCTIONS = ("sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan")
FUNCTIONS += ("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "floor", "ceil", "erf", "erfc")
TWO_ARGUMENTS = {"atan2": "atan2", "pow": "pow", "rem": "fmod", "nextafter": "nextafter"}
ELEMENTWISE = {*OPERATORS, *FUNCTIONS, *TWO_ARGUMENTS, "div", "max", "min", "abs", "sign", "and", "or", "xor", "not"}
ELEMENTWISE |= {"select_n", "convert_element_type", "is_finite", "round", "rsqrt", "logistic"}
REDUCTIONS = {"reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min"}
REDUCTIONS |= {"reduce_and": "and", "reduce_or": "or", "reduce_xor": "xor"}
CUMULATIVE = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}
MANY_RESULTS = ("scan", "while", "cond", "lu", "sort")

HELPERS = """\
static inline {real} larger({real} x, {real} y) {{ return x >= y || x != x ? x : y; }}
static inline {real} smaller({real} x, {real} y) {{ return x <= y || x != x ? x : y; }}
static inline int64_t whole({real} x) {{ return x > -9.2e18{f} && x < 9.2e18{f} ? (int64_t)x : INT64_MIN; }}
static inline int64_t within(int64_t k, int64_t most) {{ return k < 0 ? 0 : k > most ? most : k; }}
"""


@dataclasses.dataclass(frozen=True)
class Index:
    """A whole number that is linear in loop variables: ``constant + sum(factor * variable)``."""

    constant: int = 0
    terms: tuple[tuple[str, int], ...] = ()  # sorted by variable

    def __add__(self, other: Index | int) -> Index:
        if isinstance(other, int):
            return Index(self.constant + other, self.terms)
        total = collections.Counter(dict(self.terms))
        for name, factor in other.terms:
            total[name] += factor
        terms = tuple(sorted((name, factor) for name, factor in total.items() if factor))
        return Index(self.constant + other.constant, terms)

    def __mul__(self, factor: int) -> Index:
        if factor == 0:
            return Index()
        return Index(self.constant * factor, tuple((name, factor * each) for name, each in self.terms))

    def factor_of(self, variable: str) -> int:
        """How far it moves by a step of a variable."""
        return dict(self.terms).get(variable, 0)

    def without(self, merged: str, into: str) -> Index:
        """Return it where a loop variable has become part of another."""
        return Index(self.constant, tuple((name, factor) for name, factor in self.terms if name != merged))

    def __str__(self) -> str:
        parts = [name if factor == 1 else f"{factor} * {name}" for name, factor in self.terms]
        if self.constant or not parts:
            parts.append(str(self.constant))
        return " + ".join(parts).replace("+ -", "- ")


Indices = Sequence[Index]


@dataclasses.dataclass
class Storage:
    """Where the numbers of a node are kept."""

    name: str
    single: bool  # one variable, not an array
    separate: bool = False  # a variable for each number


@dataclasses.dataclass
class Loops:
    """A nest of loops that is being written."""

    axes: list[tuple[str, int]]  # variable and count, the outermost first
    places: list[Index] = dataclasses.field(default_factory=list)  # that are read or written inside


class Emitter:
    """Writes the statements of a graph.

    ``inputs`` says where the numbers of each input are, ``outputs`` where those of each output go: C texts such
    as ``before->rate``. A text of more than one number is that of an array.
    """

    def __init__(self, real: str = "double") -> None:
        self.real = real
        self.lines: list[str] = []
        self.tables: list[str] = []  # constants
        self.stack = 0  # bytes of local arrays
        self._table_names: dict[bytes, str] = {}
        self._names = itertools.count()
        self._depth = 1
        self._storage: dict[int, Storage] = {}
        self._inline: set[int] = set()
        self._loops: Loops | None = None
        self._used_inside: list[Any] = []

    # -- planning ----------------------------------------------------------------------------------------------

    def emit(self, graph: Graph, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        """Write the statements."""
        for node, text in zip(graph.inputs, inputs, strict=True):
            self._storage[id(node)] = Storage(text, node.shape == ())
        self._plan(graph)
        targets: dict[int, str] = {}
        for node, text in zip(graph.outputs, outputs, strict=True):
            if node.op not in ("input", "constant", "result", *VIEWS) and id(node) not in targets:
                targets[id(node)] = text  # computed right where it goes
                self._inline.discard(id(node))
        for node in graph.nodes:
            if id(node) not in self._inline:
                self._write_node(node, targets.get(id(node)))
        for node, text in zip(graph.outputs, outputs, strict=True):
            if targets.get(id(node)) != text:
                self._copy(node, text)

    def _plan(self, graph: Graph) -> None:
        """Decide which results are written where they are used."""
        demand: dict[int, float] = collections.defaultdict(float)  # how often each number is read
        looped: set[int] = set()  # read inside of loops
        for node in graph.outputs:
            demand[id(node)] += 1.0
            if node.size > FEW:
                looped.add(id(node))
        self._operations: dict[int, int] = {}
        for node in graph.nodes:
            own = 0 if node.op in VIEWS else 1
            self._operations[id(node)] = own + sum(
                self._operations.get(id(each), 0) for each in node.operands if each.op not in ("input", "constant")
            )
        kept: set[int] = set()  # read in another order of axes, so that it must lie in one piece
        for node in reversed(graph.nodes):
            read = demand[id(node)]
            inline = id(node) not in kept and self._is_inlined(node, read, id(node) in looped)
            if inline and node.op == "reshape" and id(node) in looped and not self._keeps_axes(node):
                kept.add(id(node.operands[0]))
            if inline:
                self._inline.add(id(node))
            loops = (id(node) in looped) if inline else node.size > FEW
            for operand, times in self._reads(node, read if inline else 1.0):
                demand[id(operand)] += times
                if loops or node.op in MANY_RESULTS or node.op not in {*VIEWS, *ELEMENTWISE}:
                    looped.add(id(operand))
        self._looped = looped
        # statements must not get too long: count again, from what is kept
        length: dict[int, int] = {}
        for node in graph.nodes:
            own = 0 if node.op in VIEWS else 1
            total = own + sum(length.get(id(each), 0) for each in node.operands)
            if id(node) in self._inline and node.op in ELEMENTWISE and total > LONGEST:
                self._inline.discard(id(node))
            length[id(node)] = total if id(node) in self._inline else 0

    def _is_inlined(self, node: Node, read: float, looped: bool) -> bool:
        if node.op == "concatenate":
            return not looped
        if node.op in VIEWS or node.op == "result":
            return True
        if node.op not in ELEMENTWISE:
            return False
        return read <= 1.0 + 1e-9

    def _keeps_axes(self, node: Node) -> bool:
        """Whether a reshape only adds and removes axes of length 1."""
        (x,) = node.operands
        return [n for n in x.shape if n != 1] == [n for n in node.shape if n != 1]

    def _reads(self, node: Node, read: float) -> Iterator[tuple[Node, float]]:
        """Yield how often each number of the operands is read, on average."""
        for operand in node.operands:
            if operand.op in ("constant", "input") or operand.size == 0:
                continue
            if node.op == "concatenate":
                yield operand, read
            elif node.op in VIEWS:
                yield operand, read * node.size / operand.size
            elif node.op in ELEMENTWISE:
                yield operand, read * node.size / operand.size
            elif node.op in REDUCTIONS or node.op in ("pad",):
                yield operand, 1.0
            else:
                yield operand, 2.0

    # -- statements --------------------------------------------------------------------------------------------

    def _line(self, text: str) -> None:
        self.lines.append("    " * self._depth + text)

    def _open(self, text: str) -> None:
        self._line(f"{text} {{")
        self._depth += 1

    def _close(self) -> None:
        self._depth -= 1
        self._line("}")

    def _type(self, node: Node) -> str:
        return self._type_of(node.dtype)

    def _type_of(self, dtype: np.dtype[Any]) -> str:
        if dtype.kind == "f":
            return self.real
        return C_TYPES[dtype.str[1:]]

    def _declare(self, node: Node) -> Storage:
        """Declare where the numbers of a node are kept."""
        name, kind = f"v{next(self._names)}", self._type(node)
        if node.size == 1:
            self._line(f"{kind} {name};")
            return Storage(name, single=True)
        if node.size <= FEW and id(node) not in self._looped:
            self._line(f"{kind} {', '.join(f'{name}_{k}' for k in range(node.size))};")
            return Storage(name, single=False, separate=True)
        self._line(f"{kind} {name}[{max(node.size, 1)}];")
        self.stack += node.size * (8 if kind in ("double", "int64_t") else 1 if kind == "bool" else 4)
        return Storage(name, single=False)

    def _write_node(self, node: Node, target: str | None) -> None:
        """Write the statements that compute a node."""
        if node.op in MANY_RESULTS:
            self._write_many(node)
            return
        if node.size == 0:
            self._storage[id(node)] = Storage("0", single=True)
            return
        storage = Storage(target, node.shape == ()) if target is not None else self._declare(node)
        self._storage[id(node)] = storage
        before = len(self.lines)
        self._used: set[str] = set()
        rule = _STATEMENTS.get(node.op)
        if rule is not None:
            rule(self, node, storage)
        elif node.op in VIEWS or node.op in ELEMENTWISE:
            self._fill(node, storage)
        else:
            raise Untraceable(_words(node, f"the operation '{node.op}' of JAX has no C"))
        sources = [str(node.source)] if node.source else []
        sources += sorted(self._used - set(sources))
        if sources and before < len(self.lines):
            self.lines[before] += f"  // {'; '.join(sources[:3])}"

    def _copy(self, node: Node, text: str) -> None:
        if node.size:
            self._used = set()
            self._fill(node, Storage(text, node.shape == ()), copied=True)

    def _fill(self, node: Node, storage: Storage, copied: bool = False) -> None:
        """Write all numbers of a node that is computed number by number."""
        if node.op == "concatenate" and not (copied and id(node) in self._storage):
            self._join(node, storage)
            return
        self._each(node.shape, lambda at: self._set(storage, node.shape, at, self._number(node, at, copied)))

    def _join(self, node: Node, storage: Storage) -> None:
        axis, offset = node.params["dimension"], 0
        for part in node.operands:

            def put(at: Indices, part: Node = part, offset: int = offset) -> str:
                place = [index + (offset if k == axis else 0) for k, index in enumerate(at)]
                return self._set(storage, node.shape, place, self.at(part, at))

            self._each(part.shape, put)
            offset += part.shape[axis]

    def _number(self, node: Node, at: Indices, copied: bool) -> str:
        if copied or node.op in VIEWS and node.op != "concatenate":
            return self.at(node, at) if copied else self._seen(node, at)
        return self._operation(node, at)

    def _each(self, shape: Sequence[int], statement: Callable[[Indices], str], always_loop: bool = False) -> None:
        """Write a statement for each index of a shape: one by one if they are few, else in loops."""
        if math.prod(shape) <= FEW and not always_loop:
            for place in itertools.product(*(range(n) for n in shape)):
                self._line(statement([Index(k) for k in place]))
            return
        outer, names = self._loops, [f"i{next(self._names)}" for _ in shape]
        axes = [(name, n) for name, n in zip(names, shape, strict=True) if n != 1]
        self._loops = Loops(axes)
        at = [Index(0, ((name, 1),)) if n != 1 else Index() for name, n in zip(names, shape, strict=True)]
        text = statement(at)
        text = self._nest(text)
        self._loops = outer

    def _nest(self, text: str) -> str:
        """Write loops around a statement; axes that lie behind each other everywhere become one."""
        loops = self._loops
        assert loops is not None
        axes, places = list(loops.axes), list(loops.places)
        k = len(axes) - 2
        while k >= 0:
            (a, n), (b, m) = axes[k], axes[k + 1]
            if all(each.factor_of(a) == m * each.factor_of(b) for each in places):
                axes[k : k + 2] = [(b, n * m)]
                places = [each.without(a, b) for each in places]
            k -= 1
        for number, each in enumerate(places):
            text = text.replace(f"\0{number}\0", str(each))
        for name, count in axes:
            self._open(f"for (int {name} = 0; {name} < {count}; {name}++)")
        self._line(text)
        for _ in axes:
            self._close()
        return text

    def _place(self, index: Index) -> str:
        """Write an index; inside of loops its text follows when they are known."""
        if self._loops is None or not index.terms:
            return str(index)
        self._loops.places.append(index)
        return f"\0{len(self._loops.places) - 1}\0"

    def _set(self, storage: Storage, shape: Sequence[int], at: Indices, value: str) -> str:
        return f"{self._lvalue(storage, shape, at)} = {value};"

    def _lvalue(self, storage: Storage, shape: Sequence[int], at: Indices) -> str:
        if storage.single:
            return storage.name
        flat = _flat(shape, at)
        if storage.separate:
            assert not flat.terms
            return f"{storage.name}_{flat.constant}"
        return f"{storage.name}[{self._place(flat)}]"

    # -- numbers -----------------------------------------------------------------------------------------------

    def at(self, node: Node, at: Indices) -> str:
        """Return the text of one number of a node."""
        if node.value is not None:
            return self._constant(node, at)
        storage = self._storage.get(id(node))
        if storage is not None:
            if node.size == 1:
                at = [Index()] * len(node.shape)
                if not storage.single and not storage.separate:
                    return f"{storage.name}[0]"
            return self._lvalue(storage, node.shape, at)
        if node.op in VIEWS:
            return self._seen(node, at)
        assert id(node) in self._inline, node.op
        if node.source is not None:
            self._used.add(str(node.source))
        text = self._operation(node, at)
        return text if _is_atom(text) else f"({text})"

    def _constant(self, node: Node, at: Indices) -> str:
        value = node.value
        assert value is not None
        flat = _flat(node.shape, at)
        if value.size == 1 or bool(np.all(value == value.flat[0])):
            return self.literal(value.flat[0])
        if not flat.terms:
            return self.literal(value.flat[flat.constant])
        return f"{self._table(value)}[{self._place(flat)}]"

    def _table(self, value: Any) -> str:
        key = value.tobytes() + value.dtype.str.encode() + b"%d" % value.size
        if key not in self._table_names:
            self._table_names[key] = name = f"k{len(self._table_names)}"
            numbers = ", ".join(self.literal(each) for each in value.flat)
            self.tables.append(f"static const {self._type_of(value.dtype)} {name}[{value.size}] = {{{numbers}}};")
        return self._table_names[key]

    def literal(self, value: Any) -> str:
        """Return a number in C."""
        if isinstance(value, (bool, np.bool_)):
            return "true" if value else "false"
        if isinstance(value, (int, np.integer)):
            return str(int(value)) if abs(int(value)) < 2**31 else f"INT64_C({int(value)})"
        number = float(value)
        if math.isnan(number):
            return "NAN"
        if math.isinf(number):
            return "INFINITY" if number > 0 else "(-INFINITY)"
        if self.real == "float":
            single = float(np.float32(number))
            if math.isinf(single):
                return "INFINITY" if single > 0 else "(-INFINITY)"
            text = f"{single!r}f" if single == number else f"{np.float32(number)!s}f"
            if "." not in text and "e" not in text:
                text = f"{text[:-1]}.0f"
        else:
            text = repr(number)
        return f"({text})" if number < 0 or text.startswith("-") else text

    def _seen(self, node: Node, at: Indices) -> str:
        """Return the text of one number of a view."""
        (x, *_), params = node.operands, node.params
        if node.op == "transpose":
            inner: list[Index] = [Index()] * len(at)
            for axis, place in enumerate(params["permutation"]):
                inner[place] = at[axis]
            return self.at(x, inner)
        if node.op == "broadcast_in_dim":
            places = params["broadcast_dimensions"]
            return self.at(x, [at[p] if n != 1 else Index() for p, n in zip(places, x.shape, strict=True)])
        if node.op == "slice":
            strides = params["strides"] or (1,) * len(at)
            starts = params["start_indices"]
            return self.at(x, [k * s + int(b) for k, s, b in zip(at, strides, starts, strict=True)])
        if node.op == "rev":
            turned = params["dimensions"]
            return self.at(x, [k * -1 + (n - 1) if a in turned else k for a, (k, n) in enumerate(zip(at, x.shape, strict=True))])
        if node.op == "concatenate":
            return self._part(node, at)
        return self._reshaped(node, at)

    def _part(self, node: Node, at: Indices) -> str:
        axis = node.params["dimension"]
        if at[axis].terms:
            raise AssertionError("a joined array is read in a loop, and has no place")
        rest = at[axis].constant
        for part in node.operands:
            if rest < part.shape[axis]:
                return self.at(part, [Index(rest) if k == axis else index for k, index in enumerate(at)])
            rest -= part.shape[axis]
        raise AssertionError("index out of range")

    def _reshaped(self, node: Node, at: Indices) -> str:
        (x,) = node.operands
        if self._keeps_axes(node):
            long = iter([index for index, n in zip(at, node.shape, strict=True) if n != 1])
            return self.at(x, [next(long) if n != 1 else Index() for n in x.shape])
        flat = _flat(node.shape, at)
        if not flat.terms:
            place = np.unravel_index(flat.constant, x.shape)
            return self.at(x, [Index(int(k)) for k in place])
        storage = self._storage.get(id(x))
        if storage is not None and not storage.separate:
            return f"{storage.name}[{self._place(flat)}]"
        if x.value is not None:
            return f"{self._table(x.value)}[{self._place(flat)}]"
        if x.op == "reshape":
            return self._reshaped(dataclasses.replace(node, operands=x.operands), at)
        raise AssertionError("reshape of what is not kept")

    def _operation(self, node: Node, at: Indices) -> str:
        """Return the text of one number of an operation that is done number by number."""
        op = node.op

        def term(operand: Node) -> str:
            if not operand.shape:
                return self.at(operand, [])
            return self.at(operand, [k if n != 1 else Index() for k, n in zip(at, operand.shape, strict=True)])

        x = [term(each) for each in node.operands]
        floating = node.operands[0].dtype.kind == "f"
        f = "f" if self.real == "float" else ""
        if op in OPERATORS:
            text = OPERATORS[op].format(*x)
            return _unsigned(text, node) if not floating and op in ("add", "sub", "mul", "neg") else text
        if op == "div":
            return f"{x[0]} / {x[1]}" if floating else f"({x[1]} == 0 ? -1 : {x[0]} / {x[1]})"
        if op in ("max", "min"):
            if floating:
                return f"{'larger' if op == 'max' else 'smaller'}({x[0]}, {x[1]})"
            return f"{x[0]} {'>' if op == 'max' else '<'} {x[1]} ? {x[0]} : {x[1]}"
        if op == "abs":
            return f"fabs{f}({x[0]})" if floating else f"{x[0]} < 0 ? -{x[0]} : {x[0]}"
        if op == "sign":
            return f"{x[0]} > 0 ? 1 : {x[0]} < 0 ? -1 : {x[0]}"
        if op in FUNCTIONS:
            return f"{op}{f}({x[0]})"
        if op == "rem" and not floating:
            return f"({x[1]} == 0 ? {x[0]} : {x[0]} % {x[1]})"
        if op in TWO_ARGUMENTS:
            return f"{TWO_ARGUMENTS[op]}{f}({x[0]}, {x[1]})"
        if op == "rsqrt":
            return f"{self.literal(1.0)} / sqrt{f}({x[0]})"
        if op == "logistic":
            return f"{self.literal(1.0)} / ({self.literal(1.0)} + exp{f}(-{x[0]}))"
        if op == "round":
            return f"{'rint' if int(node.params['rounding_method']) == 1 else 'round'}{f}({x[0]})"
        if op == "is_finite":
            return f"isfinite({x[0]}) != 0" if floating else "true"
        if op in ("and", "or", "xor", "not"):
            if node.dtype.kind == "b":
                return {"and": "{} && {}", "or": "{} || {}", "xor": "{} != {}", "not": "!{}"}[op].format(*x)
            return {"and": "{} & {}", "or": "{} | {}", "xor": "{} ^ {}", "not": "~{}"}[op].format(*x)
        if op == "select_n":
            text = x[1]
            if node.operands[0].dtype.kind == "b":
                return f"{x[0]} ? {x[2]} : {x[1]}"
            for k in range(2, len(x)):
                text = f"{x[0]} == {k - 1} ? {x[k]} : ({text})"
            return text
        if op == "convert_element_type":
            return self._converted(node, node.operands[0], x[0])
        raise AssertionError(op)

    def _converted(self, node: Node, operand: Node, text: str) -> str:
        kind = node.dtype.kind
        if kind == "b":
            return f"{text} != 0"
        if operand.dtype.kind == "f" and kind in "iu":
            return f"({self._type(node)})whole({text})"
        return text if kind == "f" and operand.dtype.kind == "f" else f"({self._type(node)}){text}"

    # -- sums, products, loops ---------------------------------------------------------------------------------

    def _combine(self, op: str, node: Node, x: str, y: str) -> str:
        """Return the text of one operation of a reduction."""
        if op in ("max", "min"):
            if node.dtype.kind == "f":
                return f"{'larger' if op == 'max' else 'smaller'}({x}, {y})"
            return f"{x} {'>' if op == 'max' else '<'} {y} ? {x} : {y}"
        return {"add": "{} + {}", "mul": "{} * {}", "and": "{} && {}", "or": "{} || {}", "xor": "{} != {}"}[op].format(x, y)

    def _fold(self, node: Node, storage: Storage, op: str, count: Sequence[int], term: Callable[[Indices, Indices], str]) -> None:
        """Write a reduction: of each number, terms over some inner indices."""
        terms = math.prod(count)
        inner = list(itertools.product(*(range(n) for n in count)))
        if terms <= WRITTEN_OUT or node.size * terms <= FEW * 2 * WRITTEN_OUT:

            def whole(at: Indices) -> str:
                text = term(at, [Index(k) for k in inner[0]])
                for place in inner[1:]:
                    text = self._combine(op, node, text if op in ("add", "mul") or _is_atom(text) else f"({text})", term(at, [Index(k) for k in place]))
                return self._set(storage, node.shape, at, text)

            self._each(node.shape, whole)
            return
        first = [Index(0)] * len(count)
        if node.size == 1:
            at = [Index()] * len(node.shape)
            target = self._lvalue(storage, node.shape, at)
            start = {"add": 0, "mul": 1, "and": True, "or": False, "xor": False}.get(op)
            self._line(f"{target} = {term(at, first) if start is None else self.literal(float(start) if node.dtype.kind == 'f' else start)};")
            self._each(count, lambda k: f"{target} = {self._combine(op, node, target, term(at, k))};", always_loop=True)
            return
        self._each(node.shape, lambda at: self._set(storage, node.shape, at, term(at, first)), always_loop=True)
        for place in inner[1:] if terms <= 2 * WRITTEN_OUT else []:
            at_k = [Index(k) for k in place]
            self._each(node.shape, lambda at, at_k=at_k: self._set(storage, node.shape, at, self._combine(op, node, self._lvalue(storage, node.shape, at), term(at, at_k))), always_loop=True)
        if terms > 2 * WRITTEN_OUT:
            self._accumulate(node, storage, op, count, term)

    def _accumulate(self, node: Node, storage: Storage, op: str, count: Sequence[int], term: Callable[[Indices, Indices], str]) -> None:
        """Write the terms after the first in loops around those of the result."""
        names = [f"j{next(self._names)}" for _ in count]
        axes = [(name, n) for name, n in zip(names, count, strict=True) if n != 1]
        for number, (name, n) in enumerate(axes):
            self._open(f"for (int {name} = 0; {name} < {n}; {name}++)")
        self._line(f"if ({' && '.join(f'{name} == 0' for name, _ in axes)}) continue;")
        at_k = [Index(0, ((name, 1),)) if n != 1 else Index() for name, n in zip(names, count, strict=True)]
        self._each(node.shape, lambda at: self._set(storage, node.shape, at, self._combine(op, node, self._lvalue(storage, node.shape, at), term(at, at_k))), always_loop=True)
        for _ in axes:
            self._close()

    def reduce(self, node: Node, storage: Storage) -> None:
        """Write a reduction over axes."""
        (x,), axes = node.operands, tuple(node.params["axes"])
        kept = [k for k in range(len(x.shape)) if k not in axes]

        def term(at: Indices, inner: Indices) -> str:
            place: list[Index] = [Index()] * len(x.shape)
            for k, index in zip(kept, at, strict=True):
                place[k] = index
            for k, index in zip(axes, inner, strict=True):
                place[k] = index
            return self.at(x, place)

        self._fold(node, storage, REDUCTIONS[node.op], [x.shape[k] for k in axes], term)

    def contract(self, node: Node, storage: Storage) -> None:
        """Write a product of matrices: dot_general."""
        a, b = node.operands
        (over_a, over_b), (batch_a, batch_b) = node.params["dimension_numbers"]
        free_a = [k for k in range(len(a.shape)) if k not in (*over_a, *batch_a)]
        free_b = [k for k in range(len(b.shape)) if k not in (*over_b, *batch_b)]

        def term(at: Indices, inner: Indices) -> str:
            at_a: list[Index] = [Index()] * len(a.shape)
            at_b: list[Index] = [Index()] * len(b.shape)
            for k, index in zip(batch_a, at, strict=False):
                at_a[k] = index
            for k, index in zip(batch_b, at, strict=False):
                at_b[k] = index
            rest = at[len(batch_a) :]
            for k, index in zip(free_a, rest, strict=False):
                at_a[k] = index
            for k, index in zip(free_b, rest[len(free_a) :], strict=True):
                at_b[k] = index
            for k, index in zip(over_a, inner, strict=True):
                at_a[k] = index
            for k, index in zip(over_b, inner, strict=True):
                at_b[k] = index
            return f"{self.at(a, at_a)} * {self.at(b, at_b)}"

        self._fold(node, storage, "add", [a.shape[k] for k in over_a], term)

    def _write_many(self, node: Node) -> None:
        raise Untraceable(_words(node, f"'{node.op}' is not there yet"))


def _flat(shape: Sequence[int], at: Indices) -> Index:
    """Return where an element lies among all of an array."""
    place, step = Index(), 1
    for n, index in zip(reversed(shape), reversed(at), strict=True):
        place = place + (index * step if n != 1 else Index())
        step *= n
    return place


def _is_stored(node: Node) -> bool:
    return node.op in ("input", "constant")


def _is_atom(text: str) -> bool:
    """Whether a text needs no parentheses around it."""
    if text.startswith("(") and text.endswith(")"):
        depth = 0
        for place, letter in enumerate(text):
            depth += {"(": 1, ")": -1}.get(letter, 0)
            if depth == 0:
                return place == len(text) - 1
    return not any(letter in text for letter in " -!~?") or (text.count("(") == 1 and text.endswith(")") and text[0].isalpha() and not any(c in text.split("(")[0] for c in " -!~?"))


def _unsigned(text: str, node: Node) -> str:
    return text


def _words(node: Node, what: str) -> str:
    return f"{node.source}: {what}" if node.source else what


_STATEMENTS: dict[str, Callable[[Emitter, Node, Storage], None]] = {
    **dict.fromkeys(REDUCTIONS, Emitter.reduce),
    "dot_general": Emitter.contract,
}
