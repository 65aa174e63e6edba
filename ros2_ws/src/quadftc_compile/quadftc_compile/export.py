"""A law for the vehicle itself: C and header, its numbers, an example that reads samples, a way to build it.

What is written needs nothing but a C99 compiler and libm: no heap, no globals, no operating system.
"""

from __future__ import annotations

import csv
import itertools
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadftc_compile.layout import Layout, flatten, leaves_of
from quadftc_compile.program import Program, path_members, write_program
from quadftc_compile.recipe import Recipe
from quadftc_compile.text import literal
from quadftc_model.numbers import number_at

FORMATS = {"f": "%.17g", "b": "%d", "u": "%u", "i": "%ld"}


class Exported(NamedTuple):
    """What was written."""

    folder: Path
    program: Program
    columns: list[str]  # of a file of samples


def export_law(recipe: Recipe, folder: Path, real: str = "double", about: str = "") -> Exported:
    """Write a law, its functions ``init`` and ``step``, into a folder; OSError if it cannot be written."""
    program = write_program(recipe.name, recipe.law, recipe.functions, real)
    name, columns = recipe.name, sample_columns(program.functions["step"].arguments["inputs"])
    folder.mkdir(parents=True, exist_ok=True)
    files = {
        f"{name}.h": program.header,
        f"{name}.c": f'#include "{name}.h"\n\n{program.source}',
        f"{name}_numbers.h": _numbers(recipe, program, real),
        "main.c": _main(name, program, real),
        "CMakeLists.txt": _cmake(name),
        "README.md": _readme(recipe, program, real, columns, about),
    }
    for file, content in files.items():
        (folder / file).write_text(content, encoding="utf-8")
    return Exported(folder, program, columns)


def sample_columns(layout: Layout) -> list[str]:
    """Return the columns of a file of samples: the time step, then every number of the inputs."""
    return ["dt", *(name for leaf in leaves_of(layout) for name in _names(".".join(leaf.path), leaf.shape))]


def _names(path: str, shape: Sequence[int]) -> Iterator[str]:
    if not shape:
        yield path
    for place in itertools.product(*(range(n) for n in shape)):
        if shape:
            yield f"{path}[{']['.join(map(str, place))}]"


def write_samples(path: Path, layout: Layout, rows: Sequence[tuple[float, Any]]) -> None:
    """Write samples, time steps [s] with inputs, as a CSV file that the example reads."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(sample_columns(layout))
        for dt, inputs in rows:
            numbers = np.concatenate([np.ravel(each).astype(float) for each in flatten(layout, inputs)])
            writer.writerow([repr(float(each)) for each in (dt, *numbers.tolist())])


def _numbers(recipe: Recipe, program: Program, real: str) -> str:
    """Return the numbers of a law as a constant struct."""
    values = {path: number_at(recipe.law, path) for path in program.numbers}
    tree: dict[str, Any] = {}
    for path, value in values.items():
        part = tree
        *parents, last = path_members(path)
        for each in parents:
            part = part.setdefault(each, {})
        part[last] = value

    def initial(part: Any, depth: int) -> str:
        if isinstance(part, dict):
            inside = ",\n".join(
                f"{'    ' * depth}.{key} = {initial(each, depth + 1)}" for key, each in part.items()
            )
            return "{\n" + inside + "}"
        numbers = [literal(each, real).text for each in np.ravel(part)]
        return numbers[0] if np.ndim(part) == 0 else "{" + ", ".join(numbers) + "}"

    name = recipe.name
    kind = f"{name}_numbers"
    guard = f"{name.upper()}_NUMBERS_H"
    return (
        f"/* The numbers of {name} for one vehicle; other vehicles and parameters need another of these files. */\n"
        f'#ifndef {guard}\n#define {guard}\n\n#include <math.h>\n\n#include "{name}.h"\n\n'
        f"static const {kind} {name}_default = {initial(tree, 1)};\n\n#endif\n"
    )


def _main(name: str, program: Program, real: str) -> str:
    """Return an example: it reads samples from standard input and writes what comes out."""
    step = program.functions["step"]
    kinds = {
        key: _kind(program, name, layout, key)
        for key, layout in (*step.arguments.items(), *step.results.items())
    }
    reads = [
        f"    if (!next(&number)) return false;\n    in->{'.'.join(leaf.path)}{f'[{k}]' if leaf.shape else ''} = {_cast(leaf.dtype.kind, real)}number;"
        for leaf in leaves_of(step.arguments["inputs"])
        for k in range(leaf.size)
    ]
    shown = leaves_of(step.results["output"])
    writes = [
        f'    printf(",{FORMATS[leaf.dtype.kind]}", {_shown(leaf.dtype.kind)}out->{".".join(leaf.path)}{f"[{k}]" if leaf.shape else ""});'
        for leaf in shown
        for k in range(leaf.size)
    ]
    head = ",".join(["sample", *(n for leaf in shown for n in _names(".".join(leaf.path), leaf.shape))])
    return f'''/* Reads samples from standard input (CSV, with a line of names) and writes what {name} says of them. */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#include "{name}.h"
#include "{name}_numbers.h"

static bool next(double *number) {{ return scanf("%lf%*[,]", number) == 1; }}

static bool read_sample({real} *dt, {kinds["inputs"]} *in) {{
    double number;
    if (!next(&number)) return false;
    *dt = ({real})number;
{chr(10).join(reads)}
    return true;
}}

static void show(long sample, const {kinds["output"]} *out) {{
    printf("%ld", sample);
{chr(10).join(writes)}
    printf("\\n");
}}

int main(void) {{
    static {kinds["before"]} states[2];
    static {kinds["inputs"]} in;
    static {kinds["output"]} out;
    {real} dt;
    long sample = 0;
    int letter;
    while ((letter = getchar()) != EOF && letter != '\\n') {{}}
    printf("{head}\\n");
    if (!read_sample(&dt, &in)) return EXIT_FAILURE;
    {name}_init(&{name}_default, &in, &states[0]);
    for (dt = 0; ; sample++) {{
        {name}_step(&{name}_default, &states[sample % 2], &in, &dt, &states[(sample + 1) % 2], &out);
        show(sample, &out);
        if (!read_sample(&dt, &in)) break;
    }}
    return EXIT_SUCCESS;
}}
'''


def _kind(program: Program, name: str, layout: Layout, wanted: str) -> str:
    """Return the name of the struct of a layout, as the program has it."""
    if layout[0] == "array":
        return layout[1]
    return program.structs[json.dumps(layout)]


def _cast(kind: str, real: str) -> str:
    return {"f": f"({real})", "b": "0 != ", "u": "(uint8_t)", "i": "(int64_t)"}[kind]


def _shown(kind: str) -> str:
    return {"f": "(double)", "b": "(int)", "u": "(unsigned)", "i": "(long)"}[kind]


def _cmake(name: str) -> str:
    return f"""cmake_minimum_required(VERSION 3.10)
project({name} C)

add_library({name} STATIC {name}.c)
set_target_properties({name} PROPERTIES C_STANDARD 99 C_EXTENSIONS OFF)
target_compile_options({name} PRIVATE -O2 -ffp-contract=off -fno-math-errno)
target_include_directories({name} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
target_link_libraries({name} PUBLIC m)

add_executable({name}_main main.c)
target_link_libraries({name}_main {name})
"""


def _readme(recipe: Recipe, program: Program, real: str, columns: Sequence[str], about: str) -> str:
    """Return what a user of the folder has to know."""
    name, step = recipe.name, program.functions["step"]
    size = {key: _bytes(layout) for key, layout in (*step.arguments.items(), *step.results.items())}
    return f"""# {name} in C

{about or "A law of quadftc"}, in {"single" if real == "float" else "double"} precision: C99 and libm alone, no heap, no globals. Calls need no order between vehicles.

```c
#include "{name}.h"
#include "{name}_numbers.h"

{name}_init(&{name}_default, &in, &states[0]);                           /* at the first sample: dt = 0 */
{name}_step(&{name}_default, &states[0], &in, &dt, &states[1], &out);    /* dt [s] after the one before */
```

A step reads one state and writes another: let two of them take turns. A state that is not finite any more is left by calling `{name}_init` again.

| | |
|---|---|
| state, each of two | {size["before"]} bytes |
| inputs, output | {size["inputs"]}, {size["output"]} bytes |
| numbers | {_bytes(program.numbers_layout)} bytes |
| stack of a step, besides registers | {step.stack} bytes |
| operations on numbers in a step, branches counted once | {step.operations} |

`cmake -B build && cmake --build build && build/{name}_main < samples.csv > out.csv` builds the example. `samples.csv` has the columns
{", ".join(f"`{each}`" for each in columns[:6])} and so on, {len(columns)} in all; `quadftc export --samples BAG` makes one of a recording.
"""


def _bytes(layout: Layout) -> int:
    from quadftc_compile.layout import numpy_type

    return int(math.ceil(numpy_type(layout).itemsize))
