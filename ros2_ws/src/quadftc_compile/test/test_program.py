"""The C of a law as people read it and compilers take it: names, units, sources, no warnings."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from quadftc_compile.build import build_library, compile_c
from quadftc_compile.export import export_law, write_samples
from quadftc_compile.program import write_program
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_model.position_estimator import PositionEstimator, PositionEstimatorInputs
from quadftc_model.samples import NO_PLACE, PositionSample, level_sample

sys.path.insert(0, str(Path(__file__).parent))
from small_laws import Inputs, LowPass

pytest.importorskip("jax")
STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fPIC", "-shared")


@pytest.fixture
def recipe():
    law = PositionEstimator(gives_velocity=True, delay=0.05)
    return recipe_of(law, PositionEstimatorInputs(level_sample(), NO_PLACE))


def test_members_have_the_names_units_and_meanings_of_the_fields(recipe):
    header = write_program(recipe.name, recipe.law, recipe.functions).header
    assert "double body_rate[3];  /* [rad/s], body frame */" in header
    assert "bool there;  /* a sample came with this IMU sample */" in header
    assert "double bias_walk;  /* [m/s^2/sqrt(s)] how far the accelerometer's bias walks */" in header
    assert "/* One sample of the IMU message: attitude, body rate, specific force" in header


def test_statements_say_where_in_the_law_they_come_from(recipe):
    source = write_program(recipe.name, recipe.law, recipe.functions).source
    path = Path(sys.modules[PositionEstimator.__module__].__file__)
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = {each.name: each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef)}
    told = re.findall(rf"{path.name}:(\d+) ([\w.]+)", source)
    assert len(told) > 50
    for line, name in told:
        function = functions[name.removeprefix("PositionEstimator.").split(".")[0]]
        assert function.lineno <= int(line) <= function.end_lineno
    assert {"_predicted", "_corrected", "_gained"} <= {name.split(".")[-1] for _, name in told}
    assert "rotations.py" in source


def test_what_is_prepared_is_a_number_with_its_meaning():
    law = LowPass()
    header = write_program("low_pass", law, recipe_of(law, law.example()).functions).header
    assert "double product;  /* Product of the gains [1]. */" in header
    assert "double time;  /* [s] time constant */" in header


@pytest.mark.parametrize("real", ["double", "float"])
def test_no_compiler_warns_of_it(recipe, real):
    program = write_program(recipe.name, recipe.law, recipe.functions, real)
    assert compile_c("warned", program.header, program.source, STRICT)
    for word in ("malloc", "printf", "goto", "static double v", "static float v"):
        assert word not in program.source
    assert ("double" in program.source) == (real == "double")


def test_the_same_law_gives_the_same_text(recipe):
    one, other = (write_program(recipe.name, recipe.law, recipe.functions) for _ in range(2))
    assert one == other


@pytest.mark.parametrize("real", ["double", "float"])
def test_an_exported_law_reads_samples_and_says_what_it_says_here(tmp_path, recipe, real):
    exported = export_law(recipe, tmp_path / "out", real)
    random, rows = np.random.default_rng(4), []
    for _ in range(60):
        force = np.array([0.0, 0.0, 9.81]) + random.normal(size=3)
        place = PositionSample(random.normal(size=3) * 1e-3, np.zeros(3), np.bool_(random.random() < 0.5))
        rows.append((0.004, PositionEstimatorInputs(level_sample()._replace(specific_force=force), place)))
    layout = exported.program.functions["step"].arguments["inputs"]
    write_samples(tmp_path / "samples.csv", layout, rows)
    folder = exported.folder
    command = ["cc", *STRICT[:-3], "-o", "example", "main.c", f"{recipe.name}.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    with (tmp_path / "samples.csv").open() as samples:
        told = subprocess.run([folder / "example"], stdin=samples, capture_output=True, text=True, check=True)
    shown = np.array([line.split(",") for line in told.stdout.splitlines()[1:]], float)
    runner = CRunner(recipe.law, build_library(recipe, keep=False))
    state, output = runner.first(rows[0][1])
    for row, (dt, inputs) in enumerate(rows):
        if row:
            state, output = runner.step(state, inputs, dt)
        wanted = np.concatenate([np.ravel(each) for each in output])
        np.testing.assert_allclose(
            shown[row, 1:], wanted, rtol=1e-12 if real == "double" else 1e-3, atol=1e-5
        )
    assert len(shown) == 60


def test_a_table_of_samples_has_a_column_for_each_number(tmp_path):
    law = LowPass()
    exported = export_law(recipe_of(law, law.example()), tmp_path)
    assert exported.columns == ["dt", "value[0]", "value[1]", "value[2]", "there"]
    path = tmp_path / "samples.csv"
    write_samples(
        path, exported.program.functions["step"].arguments["inputs"], [(0.5, Inputs(np.arange(3.0), True))]
    )
    assert path.read_text(encoding="utf-8").splitlines()[1] == "0.5,0.0,1.0,2.0,1.0"
