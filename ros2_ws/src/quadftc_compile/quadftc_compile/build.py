"""From a law to functions that can be called: traced, written in C, built, kept, loaded."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from quadftc_compile import cache
from quadftc_compile.fingerprint import Compiler, compiler, fingerprint, sources_of, tracer
from quadftc_compile.layout import Layout, layout_of
from quadftc_compile.recipe import Recipe
from quadftc_model.numbers import structure_of

# no contraction of products and sums, so that the same statement gives the same number on every machine
EXACT = ("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
# gcc joins products and sums in spite of -ffp-contract=off where it makes vectors of pairs (vfmaddsub)
X86 = ("-march=native", "-mno-fma", "-mno-fma4", "-mno-avx512f")
NATIVE = X86 if platform.machine() in ("x86_64", "i686") else ("-mcpu=native",)
# all that makes loops of arrays fast; -O3 takes three times as long for the statements of a large law
VECTORS = ("-ftree-vectorize", "-fvect-cost-model=dynamic", "-fpeel-loops", "-funswitch-loops")
# with expensive optimizations only does gcc clear the upper halves of vectors before calls; else, on an Intel
# processor, logarithms of the observer `bank` take more time than all the rest
LOOPS = ("-O1", "-fexpensive-optimizations", *VECTORS)
LIBRARY = ("-std=c99", *EXACT, "-fPIC", "-shared", "-Wall", "-Wextra", "-pedantic")
NO_TRACER = "JAX is not installed, which traces laws: pip install 'quadftc[batch]'"
FORMAT = 2  # of records; another one for another way to call


class BuildError(ValueError):
    """A law cannot be compiled here: why. ``unkept``: it can, but not be kept."""

    def __init__(self, words: str, unkept: bool = False) -> None:
        super().__init__(words)
        self.unkept = unkept


@dataclasses.dataclass(frozen=True)
class Entry:
    """A function of a library."""

    call: Any  # of ctypes; takes addresses
    run: Any  # calls it for many samples; None of what has no state
    arguments: dict[str, Layout]
    results: dict[str, Layout]


@dataclasses.dataclass(frozen=True)
class Library:
    """A compiled law."""

    path: Path
    numbers: list[str]  # paths of the numbers that it takes
    numbers_layout: Layout
    entries: dict[str, Entry]
    facts: Mapping[str, Any]  # statements, seconds, bytes
    held: ctypes.CDLL


def key_of(recipe: Recipe) -> str:
    """Return the key of a law, the same wherever it is compiled: its structure and sources."""
    shapes = {
        name: layout_of(tree) for each in recipe.functions.values() for name, tree in each.arguments.items()
    }
    return fingerprint(
        FORMAT,
        recipe.name,
        structure_of(recipe.law),
        sorted(recipe.functions),
        shapes,
        sources_of(type(recipe), *recipe.classes()),
    )


def cache_key(key: str) -> str:
    """Return the key under which this machine keeps what has a key: tracer and compiler join it."""
    return fingerprint(key, LIBRARY, NATIVE, LOOPS, tracer(), compiler())


def find_library(recipe: Recipe) -> Library | None:
    """Return a law that is compiled already, carried or kept; None if it is not, or has no cache."""
    key = key_of(recipe)
    with contextlib.suppress(OSError):  # made for a newer libc
        if (carried := cache.load_carried(key)) is not None:
            return load_library(*carried)
    with contextlib.suppress(OSError):
        if (kept := cache.load_entry(cache_key(key))) is not None:
            return load_library(*kept)
    return None


def build_library(recipe: Recipe, keep: bool = True) -> Library:
    """Return a compiled law, from the cache or made now; BuildError says why it cannot be.

    Without ``keep`` the cache is left alone, and the functions may be of any kind.
    """
    if not keep:
        library, record = make_library(recipe)
        with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
            path = Path(folder) / f"{recipe.name}.so"
            path.write_bytes(library)
            return load_library(path, record)
    key = cache_key(key_of(recipe))
    with cache.lock_entry(key):
        found = find_library(recipe)
        if found is not None:
            return found
        library, record = make_library(recipe)
        try:
            path = cache.store_entry(key, library, record)
        except OSError as error:
            words = f"{cache.cache_folder()}: {error.strerror}" if error.strerror else str(error)
            raise BuildError(f"{recipe.name}: cannot be kept: {words}", unkept=True) from None
    return load_library(path, record)


def what_is_missing() -> str | None:
    """Return what this machine lacks to compile laws, in words; None if nothing."""
    if tracer() is None:
        return NO_TRACER
    return None if compiler() is not None else "there is no C compiler that works (cc, gcc or clang)"


def make_library(recipe: Recipe, cc: Compiler | None = None) -> tuple[bytes, cache.Record]:
    """Trace a law and compile its C as `compile_c`; return library and record."""
    missing = what_is_missing()
    if missing is not None:
        raise BuildError(missing)
    from quadftc_compile.program import write_program

    begin = time.process_time()
    try:
        program = write_program(recipe.name, recipe.law, recipe.functions)
    except ValueError as error:
        raise BuildError(str(error)) from None
    traced, before = time.process_time(), os.times()
    library = compile_c(recipe.name, program.header, program.source, cc)
    spent = sum(os.times()[2:4]) - sum(before[2:4])  # s, of the compiler
    facts = {
        "statements": {key: each.statements for key, each in program.functions.items()},
        "operations": {key: each.operations for key, each in program.functions.items()},
        "stack_bytes": {key: each.stack for key, each in program.functions.items()},
        "trace_s": round(traced - begin, 3),
        "compile_s": round(spent, 3),
        "bytes": len(library),
    }
    record = {
        "name": recipe.name,
        "numbers": program.numbers,
        "numbers_layout": program.numbers_layout,
        "functions": {
            key: {"name": each.name, "arguments": each.arguments, "results": each.results}
            for key, each in program.functions.items()
        },
        "facts": facts,
    }
    return library, record


def compile_c(name: str, header: str, source: str, cc: Compiler | None = None) -> bytes:
    """Return the library of a program; BuildError: what the compiler says.

    ``cc`` is called as it is; without it, the compiler of this machine makes a library for this processor.
    """
    found = cc or compiler()
    if found is None:
        raise BuildError(f"{name}: there is no C compiler that works (cc, gcc or clang)")
    machine = NATIVE if cc is None else ()
    flags = (*LIBRARY, *machine, *(("-O2",) if "clang" in found.version else LOOPS))
    try:
        with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
            place = Path(folder)
            (place / f"{name}.h").write_text(header, encoding="utf-8")
            (place / f"{name}.c").write_text(f'#include "{name}.h"\n\n{source}', encoding="utf-8")
            command = [*found.command, *flags, "-o", f"{name}.so", f"{name}.c", "-lm"]
            told = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
            if told.returncode:
                words = (told.stderr.strip().splitlines() or ["no words"])[0]
                raise BuildError(f"{name}: {found.command[0]} fails with code {told.returncode}: {words}")
            return (place / f"{name}.so").read_bytes()
    except OSError as error:
        raise BuildError(f"{name}: {error}") from None


def load_library(path: Path, record: cache.Record) -> Library:
    """Load a library that can be trusted."""
    held = ctypes.CDLL(str(path))
    entries: dict[str, Entry] = {}
    for key, told in record["functions"].items():
        call: Callable[..., None] = getattr(held, told["name"])
        count = 1 + len(told["arguments"]) + len(told["results"])
        call.argtypes, call.restype = [ctypes.c_void_p] * count, None  # type: ignore[attr-defined]
        run = getattr(held, f"{told['name']}_run", None)
        if run is not None:
            run.argtypes, run.restype = [*[ctypes.c_void_p] * count, ctypes.c_int], None
        entries[key] = Entry(call, run, told["arguments"], told["results"])
    numbers, layout = list(record["numbers"]), record["numbers_layout"]
    return Library(path, numbers, layout, entries, record["facts"], held)
