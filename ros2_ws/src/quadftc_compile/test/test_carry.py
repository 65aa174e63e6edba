"""Laws that a wheel carries: flown without JAX and compiler, unless anything about them is another."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import pytest

from quadftc_compile import cache, engine, fingerprint, wiring
from quadftc_compile.build import NATIVE, BuildError, build_library, find_library, key_of
from quadftc_compile.carry import carry, portable_compiler
from quadftc_compile.engine import CEngine
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_model.stepper import NumpyRunner

sys.path.insert(0, str(Path(__file__).parent))
from small_laws import LowPass, Rotation

LAWS = (LowPass(), Rotation())


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    folder = tmp_path_factory.mktemp("carried")
    assert carry(LAWS, folder, portable_compiler()) == platform.machine()
    return folder


@pytest.fixture
def bare(carried, tmp_path, monkeypatch):
    """A machine with such a wheel, without JAX and compiler, and with a cache that is empty."""
    folder = tmp_path / "carried"
    folder.mkdir()
    for path in carried.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr(cache, "CARRIED", folder)
    monkeypatch.setenv("QUADFTC_CACHE", str(tmp_path / "laws"))
    for name in ("compiler", "tracer"):
        monkeypatch.setattr(f"quadftc_compile.build.{name}", lambda: None)
    monkeypatch.setattr(engine, "_libraries", {})
    monkeypatch.setattr(engine, "_told", set())
    wiring.conductor.cache_clear()
    yield folder
    wiring.conductor.cache_clear()


def outputs(runner, law):
    random, values = np.random.default_rng(5), []
    state, output = runner.first(law.example())
    for _ in range(20):
        inputs = law.example()
        if isinstance(inputs, np.ndarray):
            inputs = random.uniform(-1.0, 1.0, inputs.shape)
        else:
            inputs = inputs._replace(value=random.normal(size=3))
        state, output = runner.step(state, inputs, 0.01)
        values.append(output)
    return np.array(values)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_is_flown_without_jax_and_compiler_and_gives_the_same_bits(law, bare, tmp_path, monkeypatch):
    said: list[str] = []
    flown = CEngine(said.append)(law)
    found = outputs(flown, law)
    assert type(flown.choose(law.example())) is CRunner
    assert said == []
    assert wiring.conductor() is not None
    assert not list((tmp_path / "laws").glob("*.so"))
    monkeypatch.undo()
    monkeypatch.setenv("QUADFTC_CACHE", str(tmp_path / "laws"))
    native = build_library(recipe_of(law, law.example()))
    assert native.path.parent == tmp_path / "laws"
    np.testing.assert_array_equal(found, outputs(CRunner(law, native), law))


def change(record: Path, **values) -> None:
    record.write_text(json.dumps(json.loads(record.read_text(encoding="utf-8")) | values), encoding="utf-8")


@pytest.mark.parametrize("damage", ["cut", "gone", "processor", "key", "libc"])
def test_one_that_does_not_fit_is_not_flown(bare, damage):
    law = LowPass()
    recipe = recipe_of(law, law.example())
    record = bare / f"{key_of(recipe)}.json"
    (library,) = bare.glob(f"{key_of(recipe)}-*.so")
    if damage == "cut":
        library.write_bytes(library.read_bytes()[:2000])
    elif damage == "gone":
        library.unlink()
    elif damage == "libc":  # no library that this machine can load
        content = json.loads(record.read_text(encoding="utf-8"))
        cache.store_carried(bare, key_of(recipe), library.read_bytes()[:64], content)
    else:
        change(record, **{damage: "another"})
    assert find_library(recipe) is None
    said: list[str] = []
    found = outputs(CEngine(said.append)(law), law)
    np.testing.assert_array_equal(found, outputs(NumpyRunner(law), law))
    assert said == [
        "flies in NumPy, which is slower: "
        "JAX is not installed, which traces laws: pip install 'quadftc[batch]'"
    ]


CROSS = """#!{python}
import pathlib, subprocess, sys
if "--version" in sys.argv:
    sys.exit(print("cross 1.0"))
assert sys.argv[1:3] == ["-target", "aarch64"] and not {native} & {{*sys.argv}}
subprocess.run(["{cc}", *sys.argv[3:]], check=True)
library = pathlib.Path(sys.argv[sys.argv.index("-o") + 1])
content = library.read_bytes()
library.write_bytes(content[:18] + b"\\xb7\\0" + content[20:])
"""


def test_libraries_are_for_the_machine_that_a_given_compiler_compiles_for(tmp_path):
    cross, laws = tmp_path / "cross", tmp_path / "laws"
    laws.mkdir()
    values = {"python": sys.executable, "cc": fingerprint.compiler().command[0], "native": {*NATIVE}}
    cross.write_text(CROSS.format(**values), encoding="utf-8")
    cross.chmod(0o755)
    assert carry((LowPass(),), laws, portable_compiler(f"{cross} -target aarch64")) == "aarch64"
    records = [json.loads(path.read_text(encoding="utf-8")) for path in laws.glob("*.json")]
    assert [record["processor"] for record in records] == ["aarch64", "aarch64"]  # conductor and law
    with pytest.raises(BuildError, match="no-such-cc"):
        portable_compiler("no-such-cc -s")
    with pytest.raises(ValueError, match="x86_64, aarch64"):
        cache.machine_of(b"\xcf\xfa\xed\xfe" + bytes(60))  # of macOS


def test_a_law_with_other_sources_or_structure_is_not_there(bare, tmp_path):
    code = (
        "import pathlib, sys; from small_laws import LowPass; from quadftc_compile import cache\n"
        "from quadftc_compile.build import find_library; from quadftc_compile.recipe import recipe_of\n"
        "cache.CARRIED = pathlib.Path(sys.argv[1]); laws = LowPass(time=0.5), LowPass(order=2)\n"
        "print([find_library(recipe_of(law, law.example())) is not None for law in laws])"
    )
    source = (Path(__file__).parent / "small_laws.py").read_text(encoding="utf-8")
    for more, there in (("", True), ("# another\n", False)):
        (tmp_path / "small_laws.py").write_text(source + more, encoding="utf-8")
        env = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
        command = [sys.executable, "-c", code, bare]
        told = subprocess.run(command, capture_output=True, text=True, check=True, env=env)
        assert told.stdout == f"[{there}, False]\n"


def test_without_a_conductor_laws_are_called_one_by_one(bare, monkeypatch):
    (bare / f"{wiring.CONDUCTOR}.json").unlink()
    monkeypatch.setattr("quadftc_compile.build.compiler", lambda: None)
    with pytest.raises(BuildError, match="no C compiler"):
        wiring.conductor()
    assert not wiring._can_conduct()


Kind = TypeVar("Kind")


class OfAKind(Generic[Kind]):
    """Has the standard library among its classes."""


def test_the_standard_library_is_no_part_of_the_key(monkeypatch):
    before = fingerprint.sources_of(OfAKind)
    fingerprint._digest.cache_clear()
    monkeypatch.setattr(sys.modules["typing"], "__file__", __file__)
    assert fingerprint.sources_of(OfAKind) == before
