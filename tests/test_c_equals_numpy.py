"""Every law in C and in NumPy: a step from the same state gives the same numbers, whatever the inputs are."""

from __future__ import annotations

import functools
import json
import subprocess
import zlib

import numpy as np
import pytest
from every_law import EVERY_LAW

from quadftc_compile.build import EXACT
from quadftc_compile.engine import CEngine
from quadftc_compile.fingerprint import compiler
from quadftc_compile.layout import C_TYPES
from quadftc_compile.memory import Memory
from quadftc_compile.program import write_program
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner, numbers_in
from quadftc_model.numbers import numbers_of, with_numbers

STEPS = (0.0, 1e-9, 1e-4, 0.004, 0.004, 0.004, 0.02, 0.3, 1.0)  # s
HOSTILE = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-310, 0.0, 1.0)
SAMPLES = 60
ROUNDING = 1e-12  # of the largest entry of an array
NEARBY = 4e-15  # relative; a comparison within rounding of its bound may go either way


@functools.cache
def libraries():
    laws = {name: make() for name, make in EVERY_LAW.items()}
    return dict(zip(laws, zip(laws.values(), CEngine().prepare(laws.values()), strict=True), strict=True))


def varied(tree, rng, hostile):
    """Inputs like an example: floats moved, some of them replaced; flags at random."""
    if isinstance(tree, tuple):
        parts = [varied(each, rng, hostile) for each in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    if tree is None:
        return None
    array = np.asarray(tree)
    if array.dtype.kind == "b":
        return np.asarray(rng.random(array.shape) < 0.8)[()]
    if array.dtype.kind != "f":
        return array
    found = array * rng.uniform(0.7, 1.3, array.shape) + rng.normal(0.0, 0.05, array.shape)
    if array.shape == (4,) and abs(np.linalg.norm(array) - 1.0) < 1e-9:  # an attitude
        found = found / np.linalg.norm(found)
    strange = rng.random(array.shape) < hostile
    return np.where(strange, rng.choice(HOSTILE, array.shape), found)[()]


def nudged(tree, rng):
    """The same to rounding."""
    if isinstance(tree, tuple):
        parts = [nudged(each, rng) for each in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    if tree is None or np.asarray(tree).dtype.kind != "f":
        return tree
    with np.errstate(all="ignore"):
        return (tree * (1.0 + NEARBY * rng.uniform(-1.0, 1.0, np.shape(tree))))[()]


def leaves(tree, path=""):
    if isinstance(tree, tuple):
        names = getattr(tree, "_fields", range(len(tree)))
        for name, each in zip(names, tree, strict=True):
            yield from leaves(each, f"{path}.{name}")
    elif tree is not None:
        yield path, np.asarray(tree)


def alike(found, wanted, spread=0.0):
    """Whether two arrays are equal to rounding or a spread, with NaN and infinities in the same places."""
    if found.dtype.kind != "f":
        return np.array_equal(found, wanted)
    usual = np.isfinite(wanted)
    if not np.array_equal(np.isfinite(found), usual) or not np.array_equal(
        found[~usual], wanted[~usual], equal_nan=True
    ):
        return False
    size = np.max(np.abs(wanted[usual]), initial=0.0)
    return bool(np.all(np.abs(found[usual] - wanted[usual]) <= max(ROUNDING * size, spread)))


def numpy_step(law, state, inputs, dt):
    with np.errstate(all="ignore"):
        return dict(leaves(law.step(state, inputs, dt)))


def spread_of(arrays):
    """How far NumPy's own results lie apart, where they are numbers."""
    if arrays[0].dtype.kind != "f":
        return 0.0
    with np.errstate(all="ignore"):
        return np.nanmax(np.ptp(np.array(arrays), axis=0), initial=0.0)


def differing(law, state, inputs, dt, told, rng):
    """Paths of arrays that are another in NumPy.

    Where rounding of numbers, state and inputs moves NumPy's results, by a comparison near its bound or a
    root near zero, each of them will do, and what lies as far from them as they from each other.
    """
    told = dict(leaves(told))
    wanted = numpy_step(law, state, inputs, dt)
    wrong = {path for path, each in told.items() if not alike(each, wanted[path])}
    if wrong:
        nearby = [wanted]
        for _ in range(20):
            other = with_numbers(law, {path: nudged(each, rng) for path, each in numbers_of(law).items()})
            nearby.append(numpy_step(other, nudged(state, rng), nudged(inputs, rng), dt))
        for path in [*wrong]:
            arrays = [each[path] for each in nearby]
            if any(alike(told[path], each, spread_of(arrays)) for each in arrays):
                wrong.remove(path)
    return wrong


@pytest.mark.parametrize("name", EVERY_LAW)
def test_a_step_in_c_is_that_of_numpy(name):
    law, library = libraries()[name]
    assert library is not None
    runner, rng = CRunner(law, library), np.random.default_rng(zlib.crc32(name.encode()))
    example = law.example()
    state, _ = runner.first(example)
    tree, compared = runner.tree(state), 0
    for sample in range(SAMPLES):
        hostile = (0.0, 0.02, 0.3)[sample % 3]
        inputs, dt = varied(example, rng, hostile), float(rng.choice(STEPS))
        after, output = runner.step(tree, inputs, dt)
        told = (runner.tree(after), output)
        wrong = differing(law, tree, inputs, dt, told, rng)
        assert not wrong, (sample, hostile, dt)
        compared += len([*leaves(told)])
        # the next step begins at this state, at the last healthy one if it is not finite
        if all(np.isfinite(each).all() for _, each in leaves(told[0]) if each.dtype.kind == "f"):
            tree = told[0]
    assert compared >= SAMPLES


DRIVER = """
#include <stdio.h>
#include <stdlib.h>

int main(void)
{{
    static {numbers} numbers;
    static {before} before, after;
    static {inputs} inputs;
    static {output} output;
    double dt;
    if (fread(&numbers, {numbers_bytes}, 1, stdin) != 1) return EXIT_FAILURE;
    while (fread(&inputs, sizeof inputs, 1, stdin) == 1 && fread(&dt, sizeof dt, 1, stdin) == 1) {{
        if (dt < 0.0) {name}_init(&numbers, &inputs, &before);
        {name}_step(&numbers, &before, &inputs, dt < 0.0 ? &zero : &dt, &after, &output);
        before = after;
        fwrite(&output, sizeof output, 1, stdout);
    }}
    return EXIT_SUCCESS;
}}
"""
SANITIZE = ("-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")


def kind_of(program, layout):
    """The C type of an argument of one number, or of a struct."""
    return C_TYPES[layout[1]] if layout[0] == "array" else program.structs[json.dumps(layout)]


@pytest.mark.thorough
@pytest.mark.parametrize("name", EVERY_LAW)
def test_c_does_nothing_undefined(name, tmp_path):
    law, library = libraries()[name]
    recipe = recipe_of(law, law.example())
    program = write_program(recipe.name, law, recipe.functions)
    step = program.functions["step"]
    layouts = {
        "before": step.arguments["before"],
        "inputs": step.arguments["inputs"],
        "output": step.results["output"],
    }
    kinds = {key: kind_of(program, layout) for key, layout in layouts.items()} | {"name": recipe.name}
    numbers = numbers_in(library, law)
    kinds |= {
        "numbers": program.structs[json.dumps(program.numbers_layout)],
        "numbers_bytes": len(numbers.bytes),
    }
    (tmp_path / f"{recipe.name}.h").write_text(program.header)
    driver = "static const double zero = 0.0;" + DRIVER.format(**kinds)
    (tmp_path / "main.c").write_text(f'#include "{recipe.name}.h"\n{program.source}\n{driver}')
    command = [*compiler().command, "-std=c99", "-g", "-O1", *EXACT, *SANITIZE, "main.c", "-o", "main", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    rng, inputs, output = (
        np.random.default_rng(5),
        Memory(step.arguments["inputs"]),
        Memory(step.results["output"]),
    )
    given, runner, state, told = [numbers.bytes.tobytes()], CRunner(law, library), None, []
    for sample in range(SAMPLES):
        drawn, dt = varied(law.example(), rng, (0.0, 0.02, 0.3)[sample % 3]), float(rng.choice(STEPS))
        state, said = runner.step(state, drawn, dt) if state else runner.first(drawn)
        told.append(said)
        inputs.write(drawn)
        given.append(inputs.bytes.tobytes() + np.float64(dt if sample else -1.0).tobytes())
    done = subprocess.run([tmp_path / "main"], input=b"".join(given), capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    size = len(output.bytes)
    for sample, said in enumerate(told):
        output.bytes[:] = np.frombuffer(done.stdout[sample * size : (sample + 1) * size], np.uint8)
        for (path, found), (_, wanted) in zip(leaves(output.read()), leaves(said), strict=True):
            assert alike(found, wanted), (sample, path)
