# pyright: basic
"""C statements of a graph: a loop for an array, one statement for a number.

An operation is written where its result is used if that is once; else its result is kept in a variable.
Views (slices, transposes, broadcasts) are no statements: they only change indices. Arrays of up to `FEW`
numbers are written number by number, larger ones as loops, which a C compiler turns into vector instructions.

The order of sums is that of the indices, and nothing is rearranged: the same graph gives the same numbers
wherever it stands.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from quadftc_compile import text
from quadftc_compile.graph import VIEWS, Graph, Node, UntraceableError
from quadftc_compile.layout import C_TYPES
from quadftc_compile.operators import ELEMENTWISE, operate
from quadftc_compile.plan import ADDRESSED, FEW, MANY, Plan, keeps_axes
from quadftc_compile.text import Expression, Index, Indices, flat, placed, variable
from quadftc_model.arrays import AnyArray

HELPERS = """\
static inline {real} larger({real} x, {real} y) {{ return x >= y || x != x ? x : y; }}
static inline {real} smaller({real} x, {real} y) {{ return x <= y || x != x ? x : y; }}
static inline {real} either(bool flag, {real} x, {real} y) {{ return flag ? x : y; }}
static inline int64_t whole({real} x) {{ return x > -9.2e18{f} && x < 9.2e18{f} ? (int64_t)x : INT64_MIN; }}
static inline int64_t within(int64_t k, int64_t most) {{ return k < 0 ? 0 : k > most ? most : k; }}
"""


@dataclasses.dataclass(frozen=True)
class Storage:
    """Where the numbers of a node are kept."""

    name: str
    single: bool = False  # one variable, not an array
    separate: bool = False  # a variable for each number
    fixed: bool = False  # nothing is written there while the function runs
    behind: str = ""  # the array that it may point to

    def shifted(self, place: str) -> Storage:
        """Return the array that begins at a place of this one."""
        return Storage(f"({self.name} + {place})")


class JoinedError(Exception):
    """A loop goes over arrays that are joined, and has to be written part by part."""

    def __init__(self, node: Node, variable: str) -> None:
        super().__init__(variable)
        self.node, self.variable = node, variable


Statement = Callable[["Emitter", Node, Storage], None]
STATEMENTS: dict[str, Statement] = {}  # operations that are not done number by number
# those with several results, some of which go to places that are known
WHOLE: dict[str, Callable[[Emitter, Node, Mapping[int, Storage]], None]] = {}


def statement(*names: str, addressed: bool = False) -> Callable[[Statement], Statement]:
    """Register what writes some operations; ``addressed`` ones read their operands as arrays in one piece."""

    def add(rule: Statement) -> Statement:
        STATEMENTS.update(dict.fromkeys(names, rule))
        ADDRESSED.update(names if addressed else ())
        return rule

    return add


@dataclasses.dataclass
class Loops:
    """A nest of loops that is being written."""

    axes: list[tuple[str, int]]  # variable and count, the outermost first
    places: list[Index] = dataclasses.field(default_factory=list)  # that are read or written inside


class Emitter:
    """Writes the statements of graphs."""

    def __init__(self, real: str = "double", tables: list[str] | None = None) -> None:
        self.real = real
        self.lines: list[str] = []
        self.tables: list[str] = [] if tables is None else tables  # constants, of the whole file
        self.statements = 0
        self._work: list[tuple[str, int, bool]] = []  # arrays for results: type, numbers, in use
        self._numbers = itertools.count()
        self._depth = 1
        self._storage: dict[int, Storage] = {}
        self._noted: list[Node] = []  # these live on, as another node would get the identity of a dead one
        self._plan = Plan(Graph([], [], []))
        self._loops: Loops | None = None
        self._sources: dict[str, None] = {}
        self._unread: dict[str, int] = {}  # variables that nothing reads, and the lines that declare them

    def emit(self, graph: Graph, inputs: Sequence[Storage], outputs: Sequence[Storage | None]) -> None:
        """Write the statements of a graph; inputs and outputs do not overlap. None: nobody wants it."""
        outer, self._plan = self._plan, Plan(graph)
        self._storage |= {id(node): where for node, where in zip(graph.inputs, inputs, strict=True)}
        targets: dict[int, Storage] = {}
        for node, where in zip(graph.outputs, outputs, strict=True):
            if where and node.op not in ("input", "constant", *VIEWS) and id(node) not in targets:
                targets[id(node)] = where  # computed right where it goes
                if where not in inputs:
                    self._begin_there(node, where, targets)
        for node in graph.nodes:
            if id(node) not in self._plan.inlined and node.op != "result":
                self._release(self._plan.over[id(node)], targets)  # may be overwritten number by number
                self._write_all(node, targets)
                self._release(self._plan.last[id(node)], targets)
        for node, where in zip(graph.outputs, outputs, strict=True):
            there = targets.get(id(node)) or self._storage.get(id(node))
            if where and there != where and node.size:
                self.copy(node, where)
        self._plan = outer

    def _begin_there(self, node: Node, where: Storage, targets: dict[int, Storage]) -> None:
        """Have what a node is made of, number by number, computed where the node goes."""
        for each in self._plan.over[id(node)] if node.op != "result" else self._plan.taken_over(node):
            known = id(each) in targets or each.op in ("result", "input")
            if each.size >= MANY and each.dtype.kind == "f" and not known:
                targets[id(each)] = where
                return self._begin_there(each, where, targets)
        return None

    def mark_unread(self) -> None:
        """Tell compilers of variables that nothing reads, so that they do not warn; call it at the end."""
        for name, line in reversed(self._unread.items()):
            indent = " " * (len(self.lines[line]) - len(self.lines[line].lstrip()))
            self.lines.insert(line + 1, f"{indent}(void){name};")

    # -- statements ------------------------------------------------------------

    def line(self, content: str) -> None:
        """Write a line."""
        self.lines.append("    " * self._depth + content)

    def open(self, head: str) -> None:
        """Begin a block."""
        self.line(f"{head} {{")
        self._depth += 1

    def go_on(self, head: str) -> None:
        """End a block and begin the next of the same statement."""
        self._depth -= 1
        self.open(f"}} {head}")

    def close(self) -> None:
        """End a block."""
        self._depth -= 1
        self.line("}")

    def name(self, letter: str) -> str:
        """Return a name that is not in use."""
        return f"{letter}{next(self._numbers)}"

    def type_of(self, dtype: np.dtype) -> str:
        """Return the C type of numbers."""
        return self.real if dtype.kind == "f" else C_TYPES[dtype.str[1:]]

    def declare(self, shape: Sequence[int], dtype: np.dtype, looped: bool = True) -> Storage:
        """Declare where numbers are kept."""
        name, kind, size = self.name("v"), self.type_of(dtype), math.prod(shape)
        if size == 1:
            self.line(f"{kind} {name};")
            return Storage(name, single=True)
        if size <= FEW and not looped:
            variables = [f"{name}_{k}" for k in range(size)]
            self._unread |= dict.fromkeys(variables, len(self.lines))
            self.line(f"{kind} {', '.join(variables)};")
            return Storage(name, separate=True)
        if dtype.kind == "b":  # as wide as the numbers, so that a loop of both becomes vector instructions
            kind = "int64_t" if self.real == "double" else "int32_t"
        return Storage(self._take(kind, max(size, 1)))

    def point(self, node: Node, storage: Storage) -> Storage:
        """Declare a pointer to where the numbers of a node are: this array, or what stays as it is."""
        pointer = Storage(self.name("p"), behind=storage.name)
        self.line(f"const {self.type_of(node.dtype)} *{pointer.name};")
        self.keep(node, pointer)
        return pointer

    def _take(self, kind: str, size: int) -> str:
        """Return the name of an array for results; one that nobody reads any more is used again."""
        free = [(n, k) for k, (type_, n, used) in enumerate(self._work) if type_ == kind and not used]
        fitting = [(n, k) for n, k in free if size <= n]
        if fitting:
            n, place = min(fitting)
        elif free:
            (_, place), n = max(free), size
        else:
            place, n = len(self._work), size
            self._work.append((kind, size, True))
        self._work[place] = (kind, n, True)
        return f"w{place}"

    def _release(self, nodes: Iterable[Node], targets: Mapping[int, Storage]) -> None:
        """Give the arrays of results back that nobody reads any more; those of ``targets`` are others'."""
        for storage in (self._storage.get(id(node)) for node in nodes if id(node) not in targets):
            name = "" if storage is None else storage.behind or storage.name
            if re.fullmatch(r"w\d+", name):
                kind, size, _ = self._work[int(name[1:])]
                self._work[int(name[1:])] = (kind, size, False)

    @property
    def arrays(self) -> list[str]:
        """Declarations of the arrays for results, which come first."""
        return [f"    {kind} w{k}[{size}];" for k, (kind, size, _) in enumerate(self._work)]

    @property
    def stack(self) -> int:
        """Bytes of these arrays."""
        sizes = {"double": 8, "int64_t": 8, "uint64_t": 8, "float": 4, "int32_t": 4, "uint32_t": 4}
        return sum(size * sizes.get(kind, 1) for kind, size, _ in self._work)

    def keep(self, node: Node, storage: Storage) -> None:
        """Note where a node is kept."""
        self._storage[id(node)] = storage
        self._noted.append(node)

    def _write_all(self, node: Node, targets: Mapping[int, Storage]) -> None:
        """Write a node, after a joined array that it cannot read part by part, if there is one."""
        lines, depth, unread = len(self.lines), self._depth, dict(self._unread)
        try:
            self._write(node, targets)
        except JoinedError as joined:
            del self.lines[lines:]
            self._depth, self._unread = depth, unread
            self._plan.inlined.discard(id(joined.node))
            self._write_all(joined.node, targets)
            self._write_all(node, targets)

    def _write(self, node: Node, targets: Mapping[int, Storage]) -> None:
        """Write the statements that compute a node; ``targets`` say where some go."""
        before, target, self._sources = len(self.lines), targets.get(id(node)), {}
        if node.source is not None:
            self._sources[str(node.source)] = None
        if node.op in WHOLE:
            WHOLE[node.op](self, node, targets)
            for each in node.params["results"]:
                if id(each) not in targets:
                    self.line(f"(void){self._storage[id(each)].name};")
        elif node.size:
            by_number = node.op in ELEMENTWISE or (node.op in VIEWS and node.op != "concatenate")
            if target is None and node.size == 1 and by_number:
                self._define(node)
                self._note_sources(before)
                return
            storage = target or self.declare(node.shape, node.dtype, id(node) in self._plan.looped)
            self.keep(node, storage)
            if node.op in STATEMENTS:
                STATEMENTS[node.op](self, node, storage)
            elif node.op in VIEWS or node.op in ELEMENTWISE:
                self._fill(node, storage)
            else:
                raise UntraceableError(f"{node.source or 'it'}: '{node.op}' of JAX is not known in C")
        self._note_sources(before)

    def _note_sources(self, line: int) -> None:
        """Write behind a line where in the law it comes from."""
        if self._sources and len(self.lines) > line:
            self.lines[line] += f"  // {'; '.join([*self._sources][:3])}"

    def _define(self, node: Node) -> None:
        """Write one number that is computed as such."""
        at = [Index()] * len(node.shape)
        value = self._seen(node, at) if node.op in VIEWS else self._operation(node, at)
        storage = Storage(self.name("v"), single=True)
        self.statements += 1
        self.line(f"const {self.type_of(node.dtype)} {storage.name} = {value.text};")
        self.keep(node, storage)

    def copy(self, node: Node, storage: Storage) -> None:
        """Write the numbers of a node, kept or not, into a place."""
        self.each(node.shape, lambda at: self.put(storage, node.shape, at, self.at(node, at)))

    def _fill(self, node: Node, storage: Storage) -> None:
        """Write all numbers of a node that is computed number by number."""
        if node.op == "concatenate":
            axis, offset = node.params["dimension"], 0
            for part in node.operands:
                self.copy_into(part, storage, node.shape, axis, offset)
                offset += part.shape[axis]
            return
        number = self._seen if node.op in VIEWS else self._operation
        self.each(node.shape, lambda at: self.put(storage, node.shape, at, number(node, at)))

    def copy_into(self, part: Node, storage: Storage, shape: Sequence[int], axis: int, offset: int) -> None:
        """Write a part of an array, from an offset along an axis on."""

        def put(at: Indices) -> str:
            place = placed(at, axis, at[axis] + offset)
            return self.put(storage, shape, place, self.at(part, at))

        self.each(part.shape, put)

    def put(self, storage: Storage, shape: Sequence[int], at: Indices, value: Expression) -> str:
        """Return the assignment of one number of an array."""
        return f"{self.place(storage, shape, at)} = {value.text};"

    def each(self, shape: Sequence[int], statement: Callable[[Indices], str], loop: bool = False) -> None:
        """Write a statement for each index of a shape: one by one if they are few, else in loops."""
        if math.prod(shape) <= FEW and not loop:
            for place in itertools.product(*(range(n) for n in shape)):
                self.statements += 1
                self.line(statement([Index(k) for k in place]))
            return
        outer, names = self._loops, [self.name("i") for _ in shape]
        self._loops = Loops([(name, n) for name, n in zip(names, shape, strict=True) if n != 1])
        at = [variable(name) if n != 1 else Index() for name, n in zip(names, shape, strict=True)]
        try:
            self._nest(statement(at))
        except JoinedError as joined:
            if joined.variable not in names:
                raise
            axis = names.index(joined.variable)
            for k in range(shape[axis]):
                part = [*shape[:axis], 1, *shape[axis + 1 :]]
                self.each(part, lambda at, k=k: statement(placed(at, axis, Index(k))), True)
        finally:
            self._loops = outer

    def _nest(self, content: str) -> None:
        """Write loops around a statement; axes that lie behind each other everywhere become one."""
        assert self._loops is not None
        axes, places = list(self._loops.axes), list(self._loops.places)
        for k in range(len(axes) - 2, -1, -1):
            (a, n), (b, m) = axes[k], axes[k + 1]
            if all(each.factor_of(a) == m * each.factor_of(b) for each in places):
                axes[k : k + 2] = [(b, n * m)]
                places = [each.without(a) for each in places]
        for number, each in reversed([*enumerate(places)]):  # an index may have one within
            content = content.replace(f"\0{number}\0", str(each))
        for name, count in axes:
            self.open(f"for (int {name} = 0; {name} < {count}; {name}++)")
        self.statements += 1
        self.line(content)
        for _ in axes:
            self.close()

    # -- numbers ------------------------------------------------------------

    def place(self, storage: Storage, shape: Sequence[int], at: Indices) -> str:
        """Return the text of one number that is kept."""
        if storage.single:
            return storage.name
        where = flat(shape, at)
        if storage.separate:
            assert not where.terms
            return f"{storage.name}_{where.constant}"
        return f"{storage.name}[{self.index(where)}]"

    def index(self, where: Index) -> str:
        """Return the text of an index; inside of loops its text follows when they are known."""
        if self._loops is None or not where.terms:
            return str(where)
        self._loops.places.append(where)
        return f"\0{len(self._loops.places) - 1}\0"

    def lies(self, node: Node) -> bool:
        """Whether a node of numbers with a fraction is kept as an array."""
        return id(node) in self._storage and node.dtype.kind == "f"

    def storage_of(self, node: Node) -> Storage:
        """Return where a node is kept as an array in one piece."""
        if node.value is not None:
            return Storage(self.table(node.value))
        if node.op == "reshape" and id(node) not in self._storage:
            return self.storage_of(node.operands[0])
        return self._storage[id(node)]

    def at(self, node: Node, at: Indices) -> Expression:
        """Return one number of a node."""
        if node.value is not None:
            return self._constant(node, at)
        storage = self._storage.get(id(node))
        if storage is not None:
            place = self.place(storage, node.shape, at)
            self._unread.pop(place, None)
            return Expression(place)
        if node.op in VIEWS:
            return self._seen(node, at)
        assert id(node) in self._plan.inlined, node.op
        if node.source is not None:
            self._sources[str(node.source)] = None
        return self._operation(node, at)

    def literal(self, value: float | np.number | np.bool_) -> Expression:
        """Return a number that is known."""
        return text.literal(value, self.real)

    def _constant(self, node: Node, at: Indices) -> Expression:
        value = node.value
        assert value is not None
        where = flat(node.shape, at)
        first = value.flat[0]
        if bool(np.all(value == first)) or value.size == 1:
            return self.literal(first)
        if not where.terms:
            return self.literal(value.flat[where.constant])
        return Expression(f"{self.table(value)}[{self.index(where)}]")

    def table(self, value: AnyArray) -> str:
        """Return the name of a table of numbers that are known."""
        numbers = ", ".join(self.literal(each).text for each in value.flat)
        content = f"[{max(value.size, 1)}] = {{{numbers or 0}}};"
        kind = self.type_of(value.dtype)
        for number, each in enumerate(self.tables):
            if each == f"static const {kind} k{number}{content}":
                return f"k{number}"
        self.tables.append(f"static const {kind} k{len(self.tables)}{content}")
        return f"k{len(self.tables) - 1}"

    def _seen(self, node: Node, at: Indices) -> Expression:
        """Return one number of a view."""
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
            strides, starts = params["strides"] or (1,) * len(at), params["start_indices"]
            return self.at(x, [k * s + int(b) for k, s, b in zip(at, strides, starts, strict=True)])
        if node.op == "take":
            axis = params["axis"]
            return self.at(x, placed(at, axis, self._taken(at[axis], params["places"])))
        if node.op == "rev":
            turned = enumerate(zip(at, x.shape, strict=True))
            return self.at(x, [k * -1 + (n - 1) if a in params["dimensions"] else k for a, (k, n) in turned])
        return self._part(node, at) if node.op == "concatenate" else self._reshaped(node, at)

    def _taken(self, at: Index, places: Sequence[int]) -> Index:
        """Return which of the places, which are known, is meant."""
        if not at.terms:
            return Index(places[at.constant])
        return variable(f"{self.table(np.array(places, np.int32))}[{self.index(at)}]")

    def _part(self, node: Node, at: Indices) -> Expression:
        axis = node.params["dimension"]
        for name, _ in at[axis].terms:
            raise JoinedError(node, name)
        rest = at[axis].constant
        for part in node.operands:
            if rest < part.shape[axis]:
                return self.at(part, placed(at, axis, Index(rest)))
            rest -= part.shape[axis]
        raise AssertionError("index out of range")

    def _reshaped(self, node: Node, at: Indices) -> Expression:
        (x,) = node.operands
        if keeps_axes(node):
            long = iter([index for index, n in zip(at, node.shape, strict=True) if n != 1])
            return self.at(x, [next(long) if n != 1 else Index() for n in x.shape])
        where = flat(node.shape, at)
        if not where.terms:
            return self.at(x, [Index(int(k)) for k in np.unravel_index(where.constant, x.shape)])
        return Expression(f"{self.storage_of(x).name}[{self.index(where)}]")

    def _operation(self, node: Node, at: Indices) -> Expression:
        """Return one number of an operation that is done number by number."""

        def operand(x: Node) -> Expression:
            inner = zip(at[len(at) - len(x.shape) :], x.shape, strict=True)
            return self.at(x, [k if n != 1 else Index() for k, n in inner])

        return operate(node, [operand(x) for x in node.operands], self.real)
