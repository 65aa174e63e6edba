"""Laws run in C: the numbers of NumPy, one library for all numbers, and NumPy where C cannot be had."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from quadftc_compile import cache, engine
from quadftc_compile.build import BuildError, build_library, find_library, key_of
from quadftc_compile.engine import CEngine, engine_named
from quadftc_compile.fingerprint import Compiler
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_model.stepper import NumpyRunner, Stepper

sys.path.insert(0, str(Path(__file__).parent))  # so that another process can import these laws, too
from small_laws import Branching, Floating, Inputs, Keywords, LowPass, Rotation

RANDOM = np.random.default_rng(3)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("QUADFTC_CACHE", str(tmp_path / "laws"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    monkeypatch.setattr(engine, "_libraries", {})
    monkeypatch.setattr(engine, "_told", set())
    return tmp_path / "laws"


def samples(count):
    return [Inputs(RANDOM.normal(size=3), np.bool_(RANDOM.random() < 0.8)) for _ in range(count)]


def run(runner, inputs, dt=0.01):
    state, output = runner.first(inputs[0])
    outputs = [output]
    for each in inputs[1:]:
        state, output = runner.step(state, each, dt)
        outputs.append(output)
    return runner.tree(state), np.array(outputs)


def test_c_gives_the_numbers_of_numpy_sample_by_sample_and_in_a_stretch():
    law, inputs = LowPass(time=0.1), samples(40)
    state, wanted = run(NumpyRunner(law), inputs)
    c = CRunner(law, build_library(recipe_of(law, law.example())))
    of_c, found = run(c, inputs)
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(of_c.mean, state.mean, rtol=1e-12, atol=1e-13)
    assert of_c.count == state.count
    first, _ = c.first(inputs[0])
    columns = Inputs(*(np.array(each) for each in zip(*inputs[1:], strict=True)))
    last, outputs = c.run(first, columns, 0.01)
    np.testing.assert_array_equal(outputs, found[1:])
    np.testing.assert_array_equal(c.tree(last).mean, of_c.mean)


def test_products_and_sums_are_rounded_one_by_one():
    law, inputs = Rotation(), [RANDOM.uniform(-1.0, 1.0, 8) for _ in range(20)]
    state, wanted = run(NumpyRunner(law), inputs)
    of_c, found = run(CRunner(law, build_library(recipe_of(law, law.example()))), inputs)
    assert np.array_equal(found, wanted)
    assert np.array_equal(of_c, state)


def test_fields_may_have_words_of_c_as_names():
    law, inputs = Keywords(register=0.25), samples(10)
    state, wanted = run(NumpyRunner(law), inputs)
    of_c, found = run(CRunner(law, build_library(recipe_of(law, inputs[0]))), inputs)
    np.testing.assert_array_equal(found, wanted)
    assert of_c.short == state.short
    np.testing.assert_array_equal(of_c.double, state.double)


def test_other_numbers_need_no_other_library_but_another_structure_does():
    one, other, more = (LowPass(time=0.1), LowPass(time=0.7, gain=(3.0, 1.0, 1.0)), LowPass(order=2))
    keys = {key_of(recipe_of(law, law.example())) for law in (one, other)}
    assert len(keys) == 1
    assert key_of(recipe_of(more, more.example())) not in keys
    runner = CRunner(other, build_library(recipe_of(one, one.example())))
    inputs = samples(10)
    np.testing.assert_allclose(
        run(runner, inputs)[1], run(NumpyRunner(other), inputs)[1], rtol=1e-12, atol=1e-13
    )


def test_a_law_resumes_in_c_from_last_words():
    law, (inputs, later) = LowPass(), samples(2)
    library = build_library(recipe_of(law, inputs, words=np.zeros(3)))
    words = np.array([0.1, 0.2, 0.3])
    c, reference = CRunner(law, library), NumpyRunner(law)
    state, output = c.resumed(inputs, words)
    same, wanted = reference.resumed(inputs, words)
    np.testing.assert_allclose(output, wanted, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(
        c.step(state, later, 0.1)[1], reference.step(same, later, 0.1)[1], rtol=1e-12, atol=1e-13
    )


def test_a_compiled_law_is_found_again_without_jax(own_cache):
    law = LowPass()
    words: list[str] = []
    CEngine(words.append)(law).first(law.example())
    assert [each for each in words if "compiling low_pass" in each] == words
    code = (
        "import sys; from small_laws import LowPass; from quadftc_compile.engine import CEngine\n"
        "law = LowPass(time=0.2); runner = CEngine()(law); runner.first(law.example())\n"
        "print(type(runner._runner).__name__, sorted({'jax', 'scipy'} & set(sys.modules)))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.split("\n")[0] == "CRunner []"
    assert told.stderr == ""


def test_the_folder_belongs_to_the_user_alone(own_cache):
    law = LowPass()
    build_library(recipe_of(law, law.example()))
    assert own_cache.stat().st_mode & 0o777 == 0o700
    assert {path.stat().st_mode & 0o077 for path in own_cache.iterdir()} == {0}
    own_cache.chmod(0o777)  # by a careless hand: taken back
    assert find_library(recipe_of(law, law.example())) is not None
    assert own_cache.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("damage", ["cut", "foreign", "writable", "link", "record", "processor"])
def test_a_damaged_or_foreign_file_is_made_anew(own_cache, damage):
    law = LowPass()
    recipe = recipe_of(law, law.example())
    path = build_library(recipe).path
    (record,) = own_cache.glob("*.json")
    content = path.read_bytes()
    path.rename(own_cache / "loaded")  # what is loaded must not change
    path.write_bytes(content)
    path.chmod(0o600)
    if damage == "cut":
        path.write_bytes(content[:1000])
    elif damage == "foreign":
        path.write_bytes(b"#!/bin/sh\n")
    elif damage == "writable":
        path.chmod(0o666)
    elif damage == "link":
        path.rename(own_cache / "elsewhere.so")
        path.symlink_to(own_cache / "elsewhere.so")
    elif damage == "record":
        record.write_text("{}", encoding="utf-8")
    else:
        changed = json.loads(record.read_text(encoding="utf-8")) | {"processor": "another"}
        record.write_text(json.dumps(changed), encoding="utf-8")
    assert find_library(recipe) is None
    anew = build_library(recipe)
    assert anew.path.read_bytes() == content
    assert not anew.path.is_symlink()
    inputs = samples(5)
    np.testing.assert_allclose(
        run(CRunner(law, anew), inputs)[1], run(NumpyRunner(law), inputs)[1], rtol=1e-12, atol=1e-13
    )


def test_a_folder_of_somebody_else_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(cache.os, "getuid", lambda: 12345)
    with pytest.raises(cache.CacheError, match="of this user's own"):
        cache.cache_folder()


def test_processes_that_compile_at_once_wait_for_one_another(own_cache):
    code = (
        "from small_laws import LowPass; from quadftc_compile.build import build_library\n"
        "from quadftc_compile.recipe import recipe_of\n"
        "law = LowPass(order=3); print(build_library(recipe_of(law, law.example())).path)"
    )
    started = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(3)
    ]
    paths = {each.communicate()[0] for each in started}
    assert len(paths) == 1
    assert len(list(own_cache.glob("*.so"))) == 1


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (Branching(), r"small_laws.py:\d+ step: it branches on data: write it with `where`"),
        (Floating(), r"small_laws.py:\d+ step: it needs a number before there is one"),
    ],
)
def test_a_law_that_cannot_be_traced_says_where_and_flies_in_numpy(monkeypatch, law, words):
    with pytest.raises(BuildError, match=words):
        build_library(recipe_of(law, law.example()))
    said: list[str] = []
    runner = CEngine(said.append)(law)
    monkeypatch.setattr(engine, "_build", None)  # neither tried again
    CEngine(said.append)(law)  # nor said again
    inputs = [each._replace(value=np.abs(each.value)) for each in samples(4)]
    np.testing.assert_array_equal(run(runner, inputs)[1], run(NumpyRunner(law), inputs)[1])
    assert len([each for each in said if "flies in NumPy" in each]) == 1


def build_here(recipes, tell):
    return [engine._build_here(each, tell) for each in recipes]


def test_without_a_compiler_a_law_flies_in_numpy_and_says_so(monkeypatch):
    monkeypatch.setattr("quadftc_compile.build.compiler", lambda: None)
    monkeypatch.setattr(engine, "_build", build_here)
    said: list[str] = []
    law, inputs = LowPass(), samples(4)
    found = run(CEngine(said.append)(law), inputs)[1]
    np.testing.assert_array_equal(found, run(NumpyRunner(law), inputs)[1])
    assert said[-1].endswith("there is no C compiler that works (cc, gcc or clang)")


def test_a_compiler_that_fails_is_quoted(monkeypatch, tmp_path):
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\necho 'no such flag' >&2; exit 4\n", encoding="utf-8")
    broken.chmod(0o755)
    monkeypatch.setattr("quadftc_compile.build.compiler", lambda: Compiler((str(broken),), "broken 1.0"))
    law = LowPass()
    with pytest.raises(BuildError, match="fails with code 4: no such flag"):
        build_library(recipe_of(law, law.example()))


def test_a_folder_that_cannot_be_written_costs_only_the_next_start(own_cache, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache, "_replace", full)
    said: list[str] = []
    law, inputs = LowPass(), samples(4)
    monkeypatch.setattr(engine, "_build", build_here)
    runner = CEngine(said.append)(law)
    assert type(runner._runner) is CRunner
    folder = re.escape(str(own_cache))
    told = rf"compiled for this process alone: low_pass: cannot be kept: {folder}: No space left on device"
    assert re.fullmatch(told, said[-1])
    np.testing.assert_allclose(
        run(runner, inputs)[1], run(NumpyRunner(law), inputs)[1], rtol=1e-12, atol=1e-13
    )
    assert list(own_cache.glob("*.so")) == []
    assert list(own_cache.glob(".new-*")) == []


def test_changed_sources_give_another_key(tmp_path, monkeypatch):
    module = tmp_path / "my_law.py"
    monkeypatch.syspath_prepend(tmp_path)
    text = (Path(__file__).parent / "small_laws.py").read_text(encoding="utf-8")
    code = (
        "import my_law\n"
        "from quadftc_compile.build import key_of\n"
        "from quadftc_compile.recipe import recipe_of\n"
        "law = my_law.LowPass(); print(key_of(recipe_of(law, law.example())))"
    )
    keys = []
    for version in (text, text.replace("mean + share", "mean + 0.5 * share"), text):
        module.write_text(version, encoding="utf-8")
        env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
        told = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=env
        )
        keys.append(told.stdout)
    assert keys[0] == keys[2] != keys[1]


def test_a_stepper_flies_another_law_of_the_same_structure_in_c():
    law = LowPass()
    stepper = Stepper(law, engine=engine_named("c"))
    reference = Stepper(law, engine=engine_named("numpy"))
    for number, inputs in enumerate(samples(20)):
        if number == 10:
            stepper.law = reference.law = dataclasses.replace(law, time=2.0)
        stamp = 10**9 + number * 10_000_000
        np.testing.assert_allclose(
            stepper.step(stamp, inputs), reference.step(stamp, inputs), rtol=1e-12, atol=1e-13
        )
    np.testing.assert_allclose(stepper.state.mean, reference.state.mean, rtol=1e-12, atol=1e-13)


def test_an_unknown_engine_is_named():
    with pytest.raises(ValueError, match="engine = 'rust': expected one of c, numpy"):
        engine_named("rust")
