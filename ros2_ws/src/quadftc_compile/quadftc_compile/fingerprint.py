"""What a compiled law depends on: its structure, the sources that it is written in, tracer and compiler."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

# import a.b.c / from a.b import (c, d)
IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n(]+)|import[ \t]+([\w., \t]+))", re.M
)

WRITERS = {"quadftc_compile.program", "quadftc_compile.build"}


class Compiler(NamedTuple):
    """How a C compiler is called, and its version."""

    command: tuple[str, ...]
    version: str


def fingerprint(*parts: object) -> str:
    """Return a short text that is another for other parts; each is told by its ``repr``."""
    return hashlib.sha256("\n".join(map(repr, parts)).encode()).hexdigest()[:32]


def sources_of(*classes: type) -> str:
    """Return a digest of the modules of classes, of what writes their C, and of all that these import.

    Installed libraries are left out: they have versions.
    """
    modules = {kind.__module__ for each in classes for kind in each.__mro__} | WRITERS
    return _digest(frozenset(modules))


@functools.cache
def _digest(modules: frozenset[str]) -> str:
    own = {"quadftc_compile", *(name.partition(".")[0] for name in modules)} - sys.stdlib_module_names
    found: dict[str, bytes] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        package = name.partition(".")[0]
        if name in found or not (package in own or package.startswith("quadftc_")):
            continue
        path = _file_of(name)
        if path is not None:
            found[name] = path.read_bytes()
            waiting += _imports(name, path, found[name])
    whole = hashlib.sha256()
    for name in sorted(found):
        whole.update(name.encode() + b"\0" + found[name])
    return whole.hexdigest()


def _imports(name: str, path: Path, content: bytes) -> Iterator[str]:
    """Yield the names of modules, and of what may be modules, that a file imports."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for origin, names, plain in IMPORT.findall(content.decode("utf-8", "replace")):
        if plain:
            yield from (each.strip().partition(" ")[0] for each in plain.split(","))
            continue
        base = importlib.util.resolve_name(origin, package) if origin.startswith(".") else origin
        yield base
        for each in re.findall(r"\w+", re.sub(r"\bas\s+\w+|#.*", "", names)):
            yield f"{base}.{each}"


def _file_of(name: str) -> Path | None:
    """Return the source of a module; None if it has none, or is no module."""
    loaded = getattr(sys.modules.get(name), "__file__", None)
    if loaded is None and name not in sys.modules:
        try:
            spec = importlib.util.find_spec(name)
        except (ImportError, ValueError, AttributeError):
            return None
        loaded = spec.origin if spec is not None else None
    return Path(loaded) if loaded is not None and loaded.endswith(".py") else None


@functools.cache
def compiler(*given: str) -> Compiler | None:
    """Return the C compiler: that of a command with arguments, else cc, gcc or clang; None if none works."""
    for words in [given] if given else [("cc",), ("gcc",), ("clang",)]:
        path = shutil.which(words[0])
        if path is None:
            continue
        command = (path, *words[1:])
        told = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
        if told.returncode == 0 and told.stdout:
            return Compiler(command, told.stdout.splitlines()[0])
    return None


@functools.cache
def tracer() -> str | None:
    """Return the version of JAX, which is not loaded for it; None if it is not installed."""
    import importlib.metadata

    try:
        return importlib.metadata.version("jax")
    except importlib.metadata.PackageNotFoundError:
        return None
