"""A law for the vehicle itself: C and header, its numbers, an example that reads samples, a way to build it.

What is written needs nothing but a C99 compiler and libm: no heap, no globals, no operating system.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from quadftc_compile.build import NO_TRACER, BuildError
from quadftc_compile.fingerprint import tracer
from quadftc_compile.layout import Layout, Leaf, leaves_of, numpy_type
from quadftc_compile.program import Program, nested, write_program
from quadftc_compile.recipe import Recipe
from quadftc_compile.samples import number_names, sample_columns
from quadftc_compile.text import literal
from quadftc_model.numbers import number_at

TEMPLATES = Path(__file__).parent / "exported"
FLAGS = ("-O2", "-ffp-contract=off", "-fno-math-errno", "-ffunction-sections")  # of the CMake file
PRECISION = {"double": "double", "float": "single"}
DIGITS = {"double": "%.17g", "float": "%.9g"}  # that tell every number from its neighbours
LARGEST = 2**53  # whole numbers up to here are exact where the example reads them


@dataclasses.dataclass(frozen=True)
class Exported:
    """A law as it is exported."""

    recipe: Recipe
    program: Program
    real: str  # "double" or "float"

    @property
    def name(self) -> str:
        """Its name in C."""
        return self.recipe.name

    @property
    def layouts(self) -> dict[str, Layout]:
        """Layouts of state, inputs and output of a step, and of the numbers."""
        step = self.program.functions["step"]
        inside = {"state": step.arguments["before"], "inputs": step.arguments["inputs"]}
        return {**inside, "output": step.results["output"], "numbers": self.program.numbers_layout}

    def bytes_of(self, part: str) -> int:
        """Return how many bytes one of these takes, with gaps."""
        return numpy_type(self.layouts[part]).itemsize

    def type_of(self, part: str) -> str:
        """Return the type of one of these in C."""
        return self.program.structs[json.dumps(self.layouts[part])]


def export_of(recipe: Recipe, real: str = "double") -> Exported:
    """Trace a law and write it in C; ValueError if it cannot be exported."""
    if tracer() is None:
        raise BuildError(f"{recipe.name}: {NO_TRACER}")
    exported = Exported(recipe, write_program(recipe.name, recipe.law, recipe.functions, real), real)
    plain = [part for part, layout in exported.layouts.items() if layout[0] != "tuple"]
    if plain:
        raise ValueError(f"{recipe.name}: {plain[0]} of a law that is exported: expected a NamedTuple")
    return exported


def write_law(exported: Exported, folder: Path) -> None:
    """Write source, header and numbers of a law into a folder."""
    name, program = exported.name, exported.program
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / f"{name}.h", program.header)
    _write(folder / f"{name}.c", f'#include "{name}.h"\n\n{program.source}')
    _write(folder / f"{name}_numbers.h", _filled("numbers.h", _common_parts(exported)))
    _write(folder / f"{name}_numbers.c", _numbers(exported))


def write_example(exported: Exported, folder: Path) -> None:
    """Write the example that reads samples, and how to build it."""
    _write(folder / "main.c", _filled("main.c", _main_parts(exported)))
    _write(folder / "CMakeLists.txt", _filled("CMakeLists.txt", _common_parts(exported)))


def write_readme(
    exported: Exported, folder: Path, about: str, notes: Iterable[str] = (), recorded: str = ""
) -> None:
    """Write what a user of the folder has to know; ``recorded`` is a command that makes samples.csv."""
    step, columns = exported.program.functions["step"], sample_columns(exported.layouts["inputs"])
    parts = {
        **_common_parts(exported),
        "ABOUT": about,
        "PRECISION": PRECISION[exported.real],
        "NOTES": "".join(f"- {each}\n" for each in notes),
        "STATE_BYTES": str(exported.bytes_of("state")),
        "INPUTS_BYTES": str(exported.bytes_of("inputs")),
        "OUTPUT_BYTES": str(exported.bytes_of("output")),
        "NUMBERS_BYTES": str(exported.bytes_of("numbers")),
        "OPERATIONS": str(step.operations),
        "STATEMENTS": str(step.statements),
        "STACK_BYTES": str(step.stack),
        "RECORDED": f"{recorded}\n" if recorded else "",
        "COLUMNS_COUNT": str(len(columns)),
        "COLUMNS": ", ".join(f"`{each}`" for each in columns),
    }
    _write(folder / "README.md", _filled("README.md", parts))


def _write(path: Path, content: str) -> None:
    path.write_text(content, encoding="utf-8")


def _filled(template: str, parts: Mapping[str, str]) -> str:
    """Return a template with its parts in the places of @NAMES@."""
    text = (TEMPLATES / template).read_text(encoding="utf-8")
    return re.sub(r"@([A-Z_]+)@", lambda found: parts[found[1]], text)


def _common_parts(exported: Exported) -> dict[str, str]:
    return {
        "NAME": exported.name,
        "UPPER": exported.name.upper(),
        "REAL": exported.real,
        "INPUTS": exported.type_of("inputs"),
        "STATE": exported.type_of("state"),
        "OUTPUT": exported.type_of("output"),
        "NUMBERS": exported.type_of("numbers"),
        "FLAGS": " ".join(FLAGS),
    }


# -- numbers ----------------------------------------------------------------------------------------


def _numbers(exported: Exported) -> str:
    """Return the numbers of a law as a constant struct."""
    law = exported.recipe.law
    tree = nested({path: number_at(law, path) for path in exported.program.numbers})
    name, value = exported.name, _initial(tree, exported.real, 1)
    return (
        f'#include "{name}_numbers.h"\n\n#include <math.h>\n\n'
        f"const {exported.type_of('numbers')} {name}_default = {value};\n"
    )


def _initial(part: Any, real: str, depth: int) -> str:
    """Return the initialiser of a part of a struct."""
    if not isinstance(part, dict):
        numbers = [literal(each, real).text for each in np.ravel(part)]
        return numbers[0] if np.ndim(part) == 0 else "{" + ", ".join(numbers) + "}"
    members: dict[str, object] = part or {"nothing": 0}  # pyright: ignore[reportUnknownVariableType]
    indent = "    " * depth
    lines = [f"{indent}.{key} = {_initial(each, real, depth + 1)}" for key, each in members.items()]
    return "{\n" + ",\n".join(lines) + "}"


# -- the example --------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Kind:
    """A kind of number in the example's tables."""

    name: str
    words: str  # what is expected of it
    type: str
    test: str  # whether a double is such a number; empty: each is
    shown: str  # format, and the type that it takes

    @property
    def put(self) -> str:
        """Code that stores a number."""
        test = f"        if (!({self.test})) return false;\n" if self.test else ""
        return (
            f"    case {self.name}: {{\n{test}"
            f"        const {self.type} value = ({self.type})number;\n"
            f"        memcpy(at, &value, sizeof value);\n        return true;\n    }}"
        )

    @property
    def show(self) -> str:
        """Code that prints a number."""
        form, as_type = self.shown.split(" ", maxsplit=1)
        return (
            f"    case {self.name}: {{\n        {self.type} value;\n"
            f"        memcpy(&value, at, sizeof value);\n"
            f'        printf(",{form}", ({as_type})value);\n        break;\n    }}'
        )


def _kind_of(leaf: Leaf, real: str) -> _Kind:
    kind, bits = leaf.dtype.kind, 8 * leaf.dtype.itemsize
    if kind == "f":
        return _Kind("REAL", "a number", "real", "", f"{DIGITS[real]} double")
    if kind == "b":
        return _Kind("FLAG", "0 or 1", "bool", "number == 0 || number == 1", "%d int")
    limits = np.iinfo(leaf.dtype)
    low, high = max(int(limits.min), -LARGEST), min(int(limits.max), LARGEST)
    test = f"number >= {low}.0 && number <= {high}.0 && number == (double)(int64_t)number"
    signed = kind == "i"
    shown = "%ld long" if signed else "%lu unsigned long"
    return _Kind(
        leaf.dtype.name.upper(), f"a whole number of {bits} bits", f"{leaf.dtype.name}_t", test, shown
    )


def _main_parts(exported: Exported) -> dict[str, str]:
    """Return what the example has of a law: tables of its numbers."""
    layouts, real = exported.layouts, exported.real
    leaves = [leaf for part in ("inputs", "output") for leaf in leaves_of(layouts[part])]
    kinds = {kind.name: kind for kind in (_kind_of(leaf, real) for leaf in leaves)}
    return {
        **_common_parts(exported),
        "KINDS": ", ".join(kinds),
        "WORDS": ", ".join(f'"{each.words}"' for each in kinds.values()),
        "GIVEN": "\n".join(_table(layouts["inputs"], "inputs", real)),
        "SAID": "\n".join(_table(layouts["output"], "output", real)),
        "PUT": "\n".join(each.put for each in kinds.values()),
        "SHOW": "\n".join(each.show for each in kinds.values()),
    }


def _table(layout: Layout, kind: str, real: str) -> Sequence[str]:
    """Return the rows of a table of all numbers of a struct."""
    names = iter(number_names(layout))
    rows: list[str] = []
    for leaf in leaves_of(layout):
        member = ".".join(leaf.path)
        for k in range(leaf.size):
            place = f"{member}[{k}]" if leaf.shape else member
            rows.append(f'    {{"{next(names)}", offsetof({kind}, {place}), {_kind_of(leaf, real).name}}},')
    return rows
