# pyright: basic
"""A program: functions of one law, traced by JAX and written in C.

The numbers of the law, and each argument and result, are structs. A function takes pointers to them:

    void isolating_step(const isolating_numbers *numbers, const isolating_state *before,
                        const isolating_inputs *inputs, const double *dt, isolating_state *after, ...)
"""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from quadftc_compile import control as _control  # noqa: F401  (these know how to write what they are called)
from quadftc_compile import emit
from quadftc_compile import places as _places  # noqa: F401
from quadftc_compile import sums as _sums  # noqa: F401
from quadftc_compile.emit import Storage
from quadftc_compile.graph import Graph, Node, Source, UntraceableError, graph_of
from quadftc_compile.layout import C_TYPES, Layout, Structs, c_name, layout_of, leaves_of, member, with_real
from quadftc_compile.recipe import Function
from quadftc_model.numbers import Numbers, numbers_of, with_numbers
from quadftc_model.parameters import parameters_of

if TYPE_CHECKING:
    import jax

HERE = str(Path(__file__).parent)
# what JAX raises where a function does something that it cannot trace, and how to write it instead
ADVICE = {
    "TracerBoolConversionError": "it branches on data: write it with `where`",
    "ConcretizationTypeError": "it needs a number before there is one: keep to array operations",
    "TracerArrayConversionError": "it turns an array into NumPy's: take functions from `namespace(array)`",
    "TracerIntegerConversionError": "it takes data for an index: use known whole numbers, or `where`",
    "NonConcreteBooleanIndexError": "it picks elements by data: write it with `where`",
    "UnexpectedTracerError": "it keeps a value from another trace: a law has no memory but its state",
    "TypeError": "it does with an array what only a number can do",
}


@dataclasses.dataclass(frozen=True)
class Compiled:
    """A function in C."""

    name: str
    arguments: dict[str, Layout]
    results: dict[str, Layout]
    statements: int
    operations: int
    stack: int  # bytes


@dataclasses.dataclass(frozen=True)
class Program:
    """The C of a law."""

    header: str
    source: str
    numbers: list[str]  # paths of the law's numbers that it takes
    numbers_layout: Layout
    functions: dict[str, Compiled]
    structs: dict[str, str]  # names by layout, as JSON


def write_program(name: str, law: object, functions: Mapping[str, Function], real: str = "double") -> Program:
    """Trace the functions of a law and write them in C; UntraceableError says where one cannot be traced."""
    numbers = numbers_of(law)
    with _in_double():  # whatever this process computes in
        traced = {key: _trace(f"{name}.{key}", law, numbers, each) for key, each in functions.items()}
    used = [
        path
        for k, (path, number) in enumerate(numbers.items())
        if number.size and any(each.reads(k) for each in traced.values())
    ]
    return _Writer(name, law, numbers, used, real).write(traced)


def _in_double() -> contextlib.AbstractContextManager[object]:
    """Return a context in which JAX traces in double precision; its name has changed in JAX 0.8."""
    import jax

    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(True)
    import jax.experimental

    return getattr(jax.experimental, "enable_x64")()  # noqa: B009 - no other name on Python 3.10


@dataclasses.dataclass(frozen=True)
class _Traced:
    """A function as a graph; its first inputs are the numbers of the law."""

    function: Function
    graph: Graph
    results: tuple[object, ...]  # shapes and types

    def reads(self, number: int) -> bool:
        """Whether it reads one of the law's numbers."""
        node = self.graph.inputs[number]
        return node in self.graph.outputs or any(node in each.operands for each in self.graph.nodes)


def _trace(name: str, law: object, numbers: Mapping[str, Numbers], function: Function) -> _Traced:
    import jax

    arguments = list(function.arguments.values())
    shapes = jax.tree.map(_shape_of, arguments)

    def run(values: Sequence[object], *given: object) -> tuple[object, ...]:
        return function.call(with_numbers(law, dict(zip(numbers, values, strict=True))), *given)

    try:
        closed, results = jax.make_jaxpr(run, return_shape=True)(
            [_shape_of(each) for each in numbers.values()], *shapes
        )
        _check_state(function, results)
        return _Traced(function, graph_of(closed, source_of), results)
    except UntraceableError as error:
        raise UntraceableError(f"{name}: {error}") from None
    except Exception as error:
        raise UntraceableError(f"{name}: {_explain(error)}") from error


def _check_state(function: Function, results: tuple[object, ...]) -> None:
    """Raise an UntraceableError where a step changes the structure of a state."""
    made = dict(zip(function.results, results, strict=True))
    if "before" not in function.arguments or "after" not in made:
        return
    before, after = (layout_of(each) for each in (function.arguments["before"], made["after"]))
    if before != after:
        parts = {".".join(each.path): f"{each.dtype} {each.shape}" for each in leaves_of(before)}
        others = {".".join(each.path): f"{each.dtype} {each.shape}" for each in leaves_of(after)}
        path = next((p for p in {**parts, **others} if parts.get(p) != others.get(p)), "state")
        raise UntraceableError(
            f"state.{path}: {parts.get(path, 'absent')} by init, {others.get(path, 'absent')} after a step: "
            "a state has one structure"
        )


def _shape_of(value: ArrayLike) -> jax.ShapeDtypeStruct:
    import jax

    array = np.asarray(value)
    return jax.ShapeDtypeStruct(array.shape, array.dtype)


def _explain(error: Exception) -> str:
    """Say where in the law an error comes from, and how to write it instead."""
    place = ""
    trace = error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if _is_law(file):
            code = trace.tb_frame.f_code
            place = f"{Path(file).name}:{trace.tb_lineno} {code.co_name}: "
        trace = trace.tb_next
    kinds = [kind.__name__ for kind in type(error).__mro__]
    advice = next((ADVICE[kind] for kind in kinds if kind in ADVICE), "")
    words = str(error).splitlines()[0] if str(error) else kinds[0]
    return f"{place}{advice or words}{f' ({words})' if advice else ''}"


def source_of(equation: Any) -> Source | None:
    """Return where in a law an equation of a jaxpr stands."""
    traceback = equation.source_info.traceback
    for frame in traceback.frames if traceback is not None else ():
        if _is_law(frame.file_name):
            return Source(Path(frame.file_name).name, frame.line_num, frame.function_name)
    return None


def _is_law(file: str) -> bool:
    """Whether a file is one of a law, and not of a library or of what traces it."""
    ours = file.startswith(HERE) or file.endswith("quadftc_model/arrays.py")
    return not ours and "/jax/" not in file and "/numpy/" not in file and not file.startswith("<")


class _Writer:
    """Writes a program."""

    def __init__(
        self, name: str, law: object, numbers: Mapping[str, Numbers], used: Sequence[str], real: str
    ) -> None:
        self._name, self._law, self._real = name, law, real
        self._places = {path: k for k, path in enumerate(numbers)}
        self._used = list(used)
        self._layout = with_real(_layout_of_part(nested({path: numbers[path] for path in used})), self._code)
        self._structs = Structs(name)
        self._declarations: list[str] = []
        self._bodies: list[str] = []
        self._tables: list[str] = []
        self._compiled: dict[str, Compiled] = {}

    @property
    def _code(self) -> str:
        return "f4" if self._real == "float" else "f8"

    def write(self, traced: Mapping[str, _Traced]) -> Program:
        """Return the program."""
        self._name_numbers()
        for key, each in traced.items():
            self._write_function(key, each)
        guard = f"{self._name.upper()}_H"
        about, kind = _summary_of(self._law)
        header = "\n".join(
            [
                f"/* {about} Generated from the law {kind}: do not change it here. */",
                f"#ifndef {guard}\n#define {guard}\n\n#include <stdbool.h>\n#include <stdint.h>\n",
                *self._structs.definitions,
                '#ifdef __cplusplus\nextern "C" {\n#endif\n',
                *(f"{each.replace('*restrict ', '*')};\n" for each in self._declarations),  # no word of C++
                "#ifdef __cplusplus\n}\n#endif\n",
                f"#endif /* {guard} */\n",
            ]
        )
        f = "f" if self._real == "float" else ""
        source = "\n".join(
            [
                "#include <math.h>\n",
                emit.HELPERS.format(real=self._real, f=f),
                *(table for table in self._tables if self._is_read(table)),
                "",
                *self._bodies,
            ]
        )
        return Program(header, source, self._used, self._layout, self._compiled, self._structs.names)

    def _is_read(self, table: str) -> bool:
        """Whether a function reads a table of constants; one may be left over from what is not written."""
        name = table.partition("[")[0].split()[-1]
        return any(re.search(rf"\b{name}\b", body) for body in self._bodies)

    def _name_numbers(self) -> None:
        def name(layout: Layout, path: str, wanted: str) -> None:
            for field, inside in layout[2]:
                if inside[0] == "tuple":
                    name(inside, f"{path}.{field}" if path else field, f"{wanted}_{field}")
            self._structs.name_of(
                layout, wanted, lambda field: comment_of(self._law, f"{path}.{field}" if path else field)
            )

        name(self._layout, "", "numbers")

    def _write_function(self, key: str, traced: _Traced) -> None:
        function, graph = traced.function, traced.graph
        arguments = {n: with_real(layout_of(v), self._code) for n, v in function.arguments.items()}
        results = {
            n: with_real(layout_of(v), self._code)
            for n, v in zip(function.results, traced.results, strict=True)
        }
        # parameters, and for each input and output of the graph the text of its place
        numbers = f"const {self._structs.name_of(self._layout, 'numbers')} *restrict numbers"
        taken, read = self._declare(arguments, function.kinds, "const ")
        given, written = self._declare(results, function.kinds, "")
        parameters = [numbers, *taken, *given]
        of_numbers = (
            f"numbers->{member(path_members(path))}" if path in self._used else "0" for path in self._places
        )
        emitter = emit.Emitter(self._real, self._tables)
        inputs = _storages((*of_numbers, *read), graph.inputs, fixed=True)
        emitter.emit(graph, inputs, _storages(written, graph.outputs))
        emitter.mark_unread()
        empty = [
            f"    {n}->nothing = 0;"
            for n, layout in results.items()
            if layout[0] == "tuple" and not leaves_of(layout)
        ]
        name = f"{self._name}_{key}"
        signature = f"void {name}(\n    " + ",\n    ".join(parameters) + ")"
        quiet = _quiet(parameters, "\n".join(emitter.lines))
        self._declarations.append(signature)
        self._bodies.append(
            "\n".join([signature + "\n{", *quiet, *empty, *emitter.arrays, *emitter.lines, "}\n"])
        )
        self._compiled[key] = Compiled(
            name, arguments, results, emitter.statements, graph.operations, emitter.stack
        )
        if "before" in arguments and "after" in results:
            self._write_run(self._compiled[key])

    def _declare(
        self, layouts: Mapping[str, Layout], kinds: Mapping[str, str], const: str
    ) -> tuple[list[str], list[str]]:
        """Return a parameter for each value, and the texts of all their parts."""
        parameters: list[str] = []
        texts: list[str] = []
        for name, layout in layouts.items():
            parameters.append(f"{const}{self._kind(layout, kinds.get(name, name))} *restrict {name}")
            texts += _texts_of(layout, name)
        return parameters, texts

    def _write_run(self, step: Compiled) -> None:
        """Write a function that calls a step for many samples; ``state`` is that before, then that after."""
        before = step.arguments["before"]
        kind = self._kind(before, "state")
        size = math.prod(before[2]) if before[0] == "array" else 1
        given = {
            name: self._kind(layout, name) for name, layout in step.arguments.items() if name != "before"
        }
        made = {name: self._kind(layout, name) for name, layout in step.results.items() if name != "after"}
        parameters = [
            f"const {self._structs.name_of(self._layout, 'numbers')} *numbers",
            f"{kind} *state",
            f"{kind} *spare",
            *(f"const {each} *{name}" for name, each in given.items()),
            *(f"{each} *{name}" for name, each in made.items()),
            "int count",
        ]
        order = [*step.arguments, *step.results]
        states = {"before": "k % 2 ? spare : state", "after": "k % 2 ? state : spare"}
        layouts = {**step.arguments, **step.results}

        def at(name: str) -> str:
            layout = layouts[name]
            size = math.prod(layout[2]) if layout[0] == "array" else 1
            return f"&{name}[{f'{size} * ' if size != 1 else ''}k]"

        values = ", ".join(states.get(name) or at(name) for name in order)
        signature = f"void {step.name}_run(\n    " + ",\n    ".join(parameters) + ")"
        self._declarations.append(signature)
        self._bodies.append(
            f"{signature}\n{{\n    for (int k = 0; k < count; k++) {{\n"
            f"        {step.name}(numbers, {values});\n    }}\n"
            f"    for (int k = 0; count % 2 && k < {size}; k++) {{\n        state[k] = spare[k];\n    }}\n"
            "}\n"
        )

    def _kind(self, layout: Layout, name: str) -> str:
        """Return the type of an argument or a result."""
        return C_TYPES[layout[1]] if layout[0] == "array" else self._structs.name_of(layout, name)


def _storages(texts: Iterable[str], nodes: Sequence[Node], fixed: bool = False) -> list[Storage]:
    """Return where the inputs or outputs of a graph are kept."""
    return [Storage(text, node.shape == (), fixed=fixed) for text, node in zip(texts, nodes, strict=True)]


def _quiet(parameters: Sequence[str], body: str) -> list[str]:
    """Return what tells compilers of parameters that nothing reads."""
    names = [each.split()[-1].lstrip("*") for each in parameters]
    return [
        f"    (void){name};"
        for name in names
        if f"{name}->" not in body and f"*{name}" not in body and f"{name}[" not in body
    ]


def _texts_of(layout: Layout, name: str) -> list[str]:
    """Return the texts of all arrays of an argument, in the order in which JAX takes them."""
    if layout[0] == "array":
        return [name if layout[2] else f"*{name}"]
    if layout[0] == "none":
        return []
    found: list[str] = []

    def walk(inside: Layout, path: str) -> None:
        if inside[0] == "array":
            found.append(path)
        elif inside[0] == "tuple":
            for field, each in inside[2]:
                walk(each, f"{path}.{c_name(field)}" if path != name else f"{name}->{c_name(field)}")

    walk(layout, name)
    return found


def nested(numbers: Mapping[str, Numbers]) -> dict[str, Any]:
    """Return a law's numbers by the members of its struct of numbers: a mapping for each part."""
    inside: dict[str, Any] = {}
    for path, value in numbers.items():
        part = inside
        *parents, last = path_members(path)
        for each in parents:
            part = part.setdefault(each, {})
        part[last] = value
    return inside


def _layout_of_part(part: object) -> Layout:
    """Return the layout of a part of a law's numbers: a struct for each mapping."""
    if isinstance(part, dict):
        return ["tuple", "", [[name, _layout_of_part(each)] for name, each in part.items()]]
    return layout_of(part)


def path_members(path: str) -> list[str]:
    """Return the members of the struct of numbers to a path; numbered parts get names."""
    return [f"part{each}" if each.isdecimal() else each.lstrip("_") for each in path.split(".")]


def comment_of(law: object, path: str) -> str:
    """Return unit and meaning of a number of a law."""
    from quadftc_compile.layout import field_comments
    from quadftc_model.vehicle_table import KEYS

    part: Any = law
    *parents, last = path.split(".")
    for each in parents:
        part = (
            part[int(each[4:])]
            if each.startswith("part") and each[4:].isdecimal()
            else getattr(part, each, None)
        )
    kind = type(part)
    if dataclasses.is_dataclass(kind):
        for spec in parameters_of(kind):
            if spec.name == last:
                return f"[{spec.unit}] {spec.doc}".replace("*/", "* /")
    for table in KEYS.values():
        if last in table and kind.__module__.startswith("quadftc_model.vehicle"):
            return f"[{table[last].unit}] {table[last].doc}"
    derived = inspect.getattr_static(kind, last, None)
    if derived is not None and (words := inspect.getdoc(derived)):
        return words.splitlines()[0].replace("*/", "* /")
    return field_comments(kind).get(last, "")


def _summary_of(law: object) -> tuple[str, str]:
    """Return what a law is, and its name; ``named_after`` says which part of it tells more."""
    while (part := getattr(law, "named_after", None)) is not None:
        law = part
    words = inspect.getdoc(type(law)) or type(law).__name__
    return words.splitlines()[0].replace("*/", "* /"), type(law).__name__
