"""The C of a law as people read it and compilers take it: names, units, sources, no warnings."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from quadftc_compile.fingerprint import compiler
from quadftc_compile.program import write_program
from quadftc_compile.recipe import recipe_of
from quadftc_model.position_estimator import PositionEstimator, PositionEstimatorInputs
from quadftc_model.samples import NO_PLACE, level_sample

sys.path.insert(0, str(Path(__file__).parent))
from small_laws import LowPass

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
def test_no_compiler_warns_of_it(recipe, real, tmp_path):
    program = write_program(recipe.name, recipe.law, recipe.functions, real)
    (tmp_path / "warned.h").write_text(program.header, encoding="utf-8")
    (tmp_path / "warned.c").write_text(program.source, encoding="utf-8")
    command = [*compiler().command, *STRICT, "-include", "warned.h", "warned.c"]
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == 0
    for word in ("malloc", "printf", "goto", "static double v", "static float v"):
        assert word not in program.source
    assert ("double" in program.source) == (real == "double")


def test_the_same_law_gives_the_same_text(recipe):
    one, other = (write_program(recipe.name, recipe.law, recipe.functions) for _ in range(2))
    assert one == other
