"""What a result was made from, as one digest: code, parameters, seed and recording.

A stored result counts only as long as its digest is that of today; so a change of one observer makes only
its own flights anew.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
from collections.abc import Iterable, Iterator
from pathlib import Path

from quadftc_fdi.fault_observer import fault_observers
from quadftc_sim.fault import faults
from quadftc_tools.diagnosis_study.flights import KINDS
from quadftc_tools.diagnosis_study.runs import Task
from quadftc_tools.diagnosis_study.settings import Variant

OURS = "quadftc_"  # how the names of our packages begin
RUNS = "quadftc_tools.diagnosis_study.runs"
LENGTH = 16  # hexadecimal digits


def digest_of(task: Task, variant: Variant) -> str:
    """Digest of what the record of a flight with one observer is made from."""
    named = (fault_observers.get(variant.observer), *(faults.get(kind) for kind in KINDS.values()))
    parts = (
        sources_digest((RUNS, *(component.__module__ for component in named))),
        variant,
        task.plan.setting.ranges,
        task.plan.setting.one_axis,
        task.plan.setting.number,
        task.plan.number,
        task.plan.bag_number,
        "" if task.plan.bag is None else _bag_digest(task.plan.bag),
        task.seed,
        task.duration,
        task.windows,
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:LENGTH]


@functools.lru_cache(maxsize=64)
def sources_digest(modules: tuple[str, ...]) -> str:
    """Digest of the sources of modules and of all that they import from our packages."""
    found = hashlib.sha256()
    for name in sorted(closure(modules)):
        found.update(name.encode())
        found.update(_source(name))
    return found.hexdigest()


def closure(modules: Iterable[str]) -> set[str]:
    """Return the names of modules of ours, and of those that they import, directly or not."""
    found: set[str] = set()
    open_ = [*modules]
    while open_:
        name = open_.pop()
        if name not in found and _origin(name) is not None:
            found.add(name)
            open_.extend(_imports(name))
    return found


def _imports(name: str) -> Iterator[str]:
    """Names that a module imports; some of those from a package may be no modules."""
    for node in ast.walk(ast.parse(_source(name))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(OURS):
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.startswith(OURS))


@functools.lru_cache(maxsize=4096)
def _origin(name: str) -> Path | None:
    """File of a module; None if there is no such module."""
    try:
        spec = importlib.util.find_spec(name)
    except ModuleNotFoundError:  # the name before the last dot is no package
        return None
    return Path(spec.origin) if spec is not None and spec.origin else None


@functools.lru_cache(maxsize=4096)
def _source(name: str) -> bytes:
    file = _origin(name)
    return b"" if file is None else file.read_bytes()


@functools.lru_cache(maxsize=64)
def _bag_digest(bag: Path) -> str:
    found = hashlib.sha256()
    for file in sorted(bag.iterdir()) if bag.is_dir() else [bag]:
        if file.is_file():
            found.update(file.name.encode())
            found.update(file.read_bytes())
    return found.hexdigest()
