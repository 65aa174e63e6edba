"""A law in single precision that takes and gives double: to compare both in one flight.

State and numbers are float, as on a vehicle; inputs are rounded to float, and outputs become double again.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quadftc_compile.build import Library, compile_c, key_of, load_library
from quadftc_compile.engine import CEngine
from quadftc_compile.export import Exported, export_of
from quadftc_compile.layout import C_TYPES, Layout, leaves_of, with_real
from quadftc_compile.program import Compiled
from quadftc_compile.recipe import Recipe, recipe_of

STATES = ("before", "after")  # what stays float


class SingleEngine(CEngine):
    """Runs the laws of some names in float, all others in double."""

    def __init__(self, single: frozenset[str]) -> None:
        super().__init__()
        self._single = single
        self._built: dict[str, Library] = {}  # in float, by key

    def libraries(self, laws: Mapping[str, Any]) -> dict[str, Library] | None:
        """Return compiled laws by name; this object keeps those in float."""
        found = super().libraries({name: law for name, law in laws.items() if name not in self._single})
        if found is None:
            return None
        return found | {name: self._in_float(law) for name, law in laws.items() if name in self._single}

    def _in_float(self, law: Any) -> Library:
        recipe = recipe_of(law, law.example())
        key = key_of(recipe)
        if key not in self._built:
            self._built[key] = single_library(recipe)
        return self._built[key]


def single_library(recipe: Recipe) -> Library:
    """Return a law in float whose functions take and give double; BuildError if it cannot be compiled."""
    exported = export_of(recipe, "float")
    program, functions = exported.program, exported.program.functions
    record = {
        "numbers": program.numbers,
        "numbers_layout": program.numbers_layout,
        "functions": {
            key: {
                "name": _name(each),
                "arguments": {name: _seen(name, layout) for name, layout in each.arguments.items()},
                "results": {name: _seen(name, layout) for name, layout in each.results.items()},
            }
            for key, each in functions.items()
        },
        "facts": {},
    }
    source = "\n".join([program.source, *(_wrapper(exported, each) for each in functions.values())])
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        path = Path(folder) / f"{exported.name}.so"
        path.write_bytes(compile_c(exported.name, program.header, source))
        return load_library(path, record)


def _name(function: Compiled) -> str:
    return f"{function.name}_from_double"


def _seen(name: str, layout: Layout) -> Layout:
    """Return the layout of an argument or a result from outside."""
    return layout if name in STATES else with_real(layout, "f8")


def _wrapper(exported: Exported, function: Compiled) -> str:
    """Return a function that rounds its arguments, calls that of the law, and widens its results."""
    parameters = [f"const {exported.type_of('numbers')} *numbers"]
    passed, begin, end = ["numbers"], list[str](), list[str]()
    for name, layout in (*function.arguments.items(), *function.results.items()):
        given = name in function.arguments
        const = "const " if given else ""
        if name in STATES:
            parameters.append(f"{const}{exported.type_of('state')} *{name}")
            passed.append(name)
            continue
        kind = "float" if layout[0] == "array" else exported.program.structs[json.dumps(layout)]
        parameters.append(f"{const}char *{name}")
        passed.append(f"&{name}_single")
        begin.append(f"    {kind} {name}_single;")
        (begin if given else end).extend(_moves(name, layout, given))
    head = f"void {_name(function)}({', '.join(parameters)})"
    call = f"    {function.name}({', '.join(passed)});"
    return "\n".join([f"{head};", f"{head}\n{{", *begin, call, *end, "}\n"])


def _moves(name: str, layout: Layout, given: bool) -> list[str]:
    """Return statements that move the numbers of a struct from its place outside, or back there."""
    lines: list[str] = []
    for leaf, outside in zip(leaves_of(layout), leaves_of(_seen(name, layout)), strict=True):
        member = ".".join((f"{name}_single", *leaf.path)) + ("[k]" if leaf.shape else "")
        inner, outer = C_TYPES[leaf.dtype.str[1:]], C_TYPES[outside.dtype.str[1:]]
        place = f"(({'const ' if given else ''}{outer} *)({name} + {outside.offset}))[k]"
        move = f"{member} = ({inner}){place};" if given else f"{place} = ({outer}){member};"
        lines.append(f"    for (int k = 0; k < {leaf.size}; k++) {move}")
    return lines
