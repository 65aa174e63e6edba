"""A law as it is exported: what its example says, what it refuses, and that nothing is hidden in its C."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from quadftc_compile.build import build_library
from quadftc_compile.export import export_of, write_readme
from quadftc_compile.layout import flatten
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_compile.samples import sample_columns
from quadftc_model.arrays import rows_of

pytest.importorskip("jax")
sys.path.insert(0, str(Path(__file__).parent))
from exported_laws import (
    COUNT,
    WARNINGS,
    Tagged,
    TaggedInputs,
    built,
    estimator_samples,
    exported_estimator,
    run,
    table_of,
    write_inputs,
    written,
)
from small_laws import LowPass

HEAD = "dt,value[0],value[1],value[2],there,channel,shift\n"
GOOD = "0.1,1,2,3,1,7,-2\n"


@pytest.fixture(scope="module")
def tagged(tmp_path_factory):
    """Return the example of a law with numbers of all kinds, and its folder."""
    law = Tagged()
    exported = export_of(recipe_of(law, law.example()))
    folder = written(exported, tmp_path_factory.mktemp("tagged"))
    return built(exported, folder)


@pytest.mark.parametrize(("real", "tolerance"), [("double", 1e-12), ("float", 1e-4)])
def test_an_exported_law_says_what_it_says_here(tmp_path, real, tolerance):
    exported = exported_estimator(real)
    dt, inputs = estimator_samples()
    samples = write_inputs(exported, tmp_path / "samples.csv", dt, inputs)
    told = run(built(exported, written(exported, tmp_path / "law")), samples)
    assert told.returncode == 0, told.stderr
    runner, wanted, state = CRunner(exported.recipe.law, build_library(exported.recipe, keep=False)), [], None
    for row, step in enumerate(dt.tolist()):
        seen = inputs._replace(
            imu=inputs.imu._replace(specific_force=inputs.imu.specific_force[row]),
            sample=rows_of(inputs.sample, row),
        )
        state, output = runner.step(state, seen, step) if step else runner.first(seen)
        wanted.append(
            np.concatenate([np.ravel(each) for each in flatten(exported.layouts["output"], output)])
        )
    np.testing.assert_allclose(table_of(told.stdout), wanted, rtol=tolerance, atol=tolerance)
    assert len(wanted) == COUNT


def test_numbers_of_all_kinds_go_in_and_out(tagged, tmp_path):
    (tmp_path / "samples.csv").write_text(
        HEAD + "0,-1,2,3,1,255,-2147483648\n\n0.5,1,1, 1,0,3,5\r\n0.5,1,1,1,0,3,5"
    )
    told = run(tagged, tmp_path / "samples.csv")
    assert told.returncode == 0, told.stderr
    head, *lines = told.stdout.splitlines()
    assert head == "sample,mean[0],mean[1],mean[2],low,channel,shifts"
    assert [line.split(",")[4:] for line in lines] == [
        ["1", "255", "-2147483648"],
        ["1", "3", "-2147483643"],
        ["1", "3", "-2147483638"],
    ]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", ":1: line: expected the names of the columns, not 'the end of the file'"),
        (HEAD, ":2: line: expected a sample, not 'the end of the file'"),
        (HEAD.replace("there", "yonder") + GOOD, ":1: name: expected there, not 'yonder'"),
        (HEAD.replace(",shift", "") + GOOD, ":1: expected 7 columns, found 6"),
        (HEAD + GOOD + "0.1,1,2,3,1,7\n", ":3: expected 7 columns, found 6"),
        (HEAD + GOOD + "0.1,1,2,3,1,7,-2,\n", ":3: expected 7 columns, found 8"),
        (HEAD + "0.1,1,two,3,1,7,-2\n", ":2: value[1]: expected a number, not 'two'"),
        (HEAD + "0.1,1,,3,1,7,-2\n", ":2: value[1]: expected a number, not ''"),
        (HEAD + "0.1,1,2 3,3,1,7,-2\n", ":2: value[1]: expected a number, not '2 3'"),
        (HEAD + GOOD + "-0.1,1,2,3,1,7,-2\n", ":3: dt: expected 0 (begin) or more, not '-0.1'"),
        (HEAD + GOOD + "nan,1,2,3,1,7,-2\n", ":3: dt: expected 0 (begin) or more, not 'nan'"),
        (HEAD + "0.1,1,2,3,0.5,7,-2\n", ":2: there: expected 0 or 1, not '0.5'"),
        (HEAD + "0.1,1,2,3,nan,7,-2\n", ":2: there: expected 0 or 1, not 'nan'"),
        (HEAD + "0.1,1,2,3,1,256,-2\n", ":2: channel: expected a whole number of 8 bits, not '256'"),
        (HEAD + "0.1,1,2,3,1,7,0.5\n", ":2: shift: expected a whole number of 32 bits, not '0.5'"),
        (
            HEAD + "0.1,1,2,3,1,7," + 3000 * "0" + "\n",
            ":2: line: expected fewer characters, not 'a longer line'",
        ),
    ],
)
def test_samples_that_make_no_sense_are_refused_with_their_line(tagged, tmp_path, content, words):
    path = tmp_path / "samples.csv"
    path.write_text(content)
    told = run(tagged, path)
    assert told.returncode == 1
    assert told.stderr == f"{path}{words}\n"


def test_a_file_that_is_not_there_is_named(tagged, tmp_path):
    told = run(tagged, tmp_path / "nothing.csv")
    assert told.returncode == 1
    assert "nothing.csv: No such file" in told.stderr


def test_nan_is_a_number(tagged, tmp_path):
    (tmp_path / "samples.csv").write_text(HEAD + "0,nan,inf,3,1,7,-2\n")
    told = run(tagged, tmp_path / "samples.csv")
    assert told.returncode == 0
    assert "nan" in told.stdout


def test_samples_come_from_standard_input_as_well(tagged, tmp_path):
    given = HEAD + GOOD
    (tmp_path / "samples.csv").write_text(given)
    told = subprocess.run([tagged], input=given, capture_output=True, text=True, check=True)
    assert told.stdout == run(tagged, tmp_path / "samples.csv").stdout


@pytest.mark.parametrize("real", ["double", "float"])
def test_nothing_is_hidden_in_the_c(tmp_path, real):
    exported = exported_estimator(real)
    folder = written(exported, tmp_path)
    promoted = ["-Wdouble-promotion"] if real == "float" else []
    command = ["cc", "-std=c99", "-O1", *WARNINGS, *promoted, "-c", f"{exported.name}.c", "-o", "law.o"]
    subprocess.run(command, cwd=folder, check=True)
    told = subprocess.run(["nm", "law.o"], cwd=folder, capture_output=True, text=True, check=True).stdout
    symbols = [line.split()[-2:] for line in told.splitlines()]
    assert {kind for kind, _ in symbols} <= {"T", "t", "U", "r"}  # code and constants, no variables
    suffix = "f" if real == "float" else ""
    allowed = {f"{each}{suffix}" for each in ("sin", "cos", "sqrt", "atan2", "asin", "exp", "log")}
    assert {name for kind, name in symbols if kind == "U"} <= allowed | {"memcpy", "memset"}


def test_a_law_whose_output_is_an_array_is_refused():
    law = LowPass()
    with pytest.raises(ValueError, match="low_pass: output of a law that is exported: expected a NamedTuple"):
        export_of(recipe_of(law, law.example()))


def test_the_readme_says_what_a_law_needs(tmp_path):
    exported = export_of(recipe_of(Tagged(), Tagged().example()))
    write_readme(exported, tmp_path, "A filter.", ["Mind the gap."])
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    columns = sample_columns(exported.layouts["inputs"])
    assert columns == HEAD.strip().split(",")
    assert f"{len(columns)} columns: {', '.join(f'`{each}`' for each in columns)}" in text
    for words in ("A filter. In double precision", "- Mind the gap.", "| stack of a step, its arrays"):
        assert words in text
    assert "| state, each of two | 40 bytes |" in text  # four doubles and a whole number, with a gap
    assert "@" not in text


@pytest.mark.skipif(shutil.which("cmake") is None, reason="there is no cmake")
def test_cmake_builds_the_example(tmp_path):
    exported = export_of(recipe_of(Tagged(), Tagged().example()))
    folder = written(exported, tmp_path / "law")
    for command in (["cmake", "-S", ".", "-B", "build"], ["cmake", "--build", "build"]):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    samples = write_inputs(exported, tmp_path / "samples.csv", [0.0, 0.1], TaggedInputs(*Tagged().example()))
    assert len(table_of(run(folder / "build" / "tagged_main", samples).stdout)) == 2
