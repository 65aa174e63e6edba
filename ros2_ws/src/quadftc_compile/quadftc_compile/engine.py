"""What runs the laws of a vehicle: C that is generated from them, or NumPy, the reference.

A law is compiled at its first use, in a process of its own, so that this one does not load JAX. A law that
cannot be compiled flies in NumPy, and a line says why, once.
"""

from __future__ import annotations

import concurrent.futures
import os
import queue
import sys
import threading
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any

from quadftc_compile.build import BuildError, Library, build_library, find_library, key_of, what_is_missing
from quadftc_compile.layout import Layout, layout_of
from quadftc_compile.recipe import Recipe, recipe_of
from quadftc_compile.runner import CRunner
from quadftc_compile.worker import Worker
from quadftc_model.numbers import structure_of
from quadftc_model.stepper import Engine, NumpyRunner, Runner

ENGINES = ("c", "numpy")
Log = Callable[[str], object]

_libraries: dict[str, Library | None] = {}  # that this process has loaded; None: it cannot be compiled
_told: set[str] = set()  # what has been said already
_lock = threading.Lock()


def say(words: str) -> None:
    """Write a line for people."""
    sys.stderr.write(f"quadftc: {words}\n")
    sys.stderr.flush()


def engine_named(name: str, log: Log = say) -> Engine:
    """Return the engine "c" or "numpy"; ``log`` gets what people should know."""
    if name not in ENGINES:
        raise ValueError(f"engine = {name!r}: expected one of {', '.join(ENGINES)}")
    return CEngine(log) if name == "c" else NumpyRunner


def engine_from(values: Mapping[str, object], log: Log = say) -> Engine:
    """Return the engine that the parameter ``engine`` of a node names."""
    return engine_named(str(values["engine"]), log)


class CEngine:
    """Runs laws in C.

    A law with a method ``example() -> inputs`` is compiled when its runner is made, others at their first
    sample.
    """

    def __init__(self, log: Log = say) -> None:
        self._log = log

    def __call__(self, law: Any) -> Runner[Any, Any]:
        """Return what runs a law."""
        if not _can_be_traced(law):
            return NumpyRunner(law)
        runner = _Chosen(law, self._library_for)
        if hasattr(law, "example"):
            runner.choose(law.example())
        return runner

    def prepare(self, laws: Iterable[Any]) -> list[Library | None]:
        """Return compiled laws, which have examples of their inputs; compile what is missing side by side.

        One that cannot be compiled is None.
        """
        recipes = [recipe_for(law, law.example()) if _can_be_traced(law) else None for law in laws]
        self._compile([each for each in recipes if each is not None])
        return [None if each is None else _loaded(each) for each in recipes]

    def libraries(self, laws: Mapping[str, Any]) -> dict[str, Library] | None:
        """Return compiled laws by name; None if one cannot be compiled."""
        found = dict(zip(laws, self.prepare(laws.values()), strict=True))
        there = {name: library for name, library in found.items() if library is not None}
        return there if len(there) == len(laws) else None

    def is_ready(self, law: object, inputs: object) -> bool:
        """Whether a law can be run in C without compiling it now."""
        try:
            return _loaded(recipe_for(law, inputs)) is not None
        except ValueError:
            return False

    def _library_for(self, law: object, inputs: object) -> Library | None:
        """Return a compiled law, compiled now if need be; None if it has to fly in NumPy."""
        recipe = recipe_for(law, inputs)
        self._compile([recipe])
        return _loaded(recipe)

    def _compile(self, recipes: Iterable[Recipe]) -> None:
        """Compile side by side what is missing, and load it; what cannot be compiled is not tried again."""
        missing = {key_of(each): each for each in recipes if _loaded(each) is None}
        missing = {key: each for key, each in missing.items() if key not in _libraries}
        if not missing:
            return
        if what_is_missing() is None:
            self._announce(missing.values())
        for key, library in zip(missing, _build([*missing.values()], self._tell), strict=True):
            failed = isinstance(library, BuildError)
            if failed:
                self._tell(f"flies in NumPy, which is slower: {library}")
            with _lock:
                _libraries.setdefault(key, None if failed else library)

    def _announce(self, recipes: Iterable[Recipe]) -> None:
        """Say once what is compiled now."""
        names = [name for name in dict.fromkeys(each.name for each in recipes) if name not in _told]
        _told.update(names)
        if names:
            self._log(f"compiling {', '.join(names)} for this machine, once: some seconds")

    def _tell(self, words: str) -> None:
        with _lock:
            if words in _told:
                return
            _told.add(words)
        self._log(words)


class _Chosen:
    """A runner in C, or in NumPy if the law has none; chosen by the structure of the first inputs."""

    def __init__(self, law: object, library_for: Callable[[object, object], Library | None]) -> None:
        self._law, self._library_for = law, library_for
        self._runner: Runner[Any, Any] | None = None
        self._layout: Layout | None = None
        self._structure: Hashable = None

    def configure(self, law: object) -> bool:
        """Go on with the numbers of another law of the same structure; False: it has another."""
        if self._runner is not None:
            self._structure = self._structure or structure_of(self._law)
            if structure_of(law) != self._structure or not self._runner.configure(law):
                return False
        self._law = law
        return True

    def choose(self, inputs: object) -> Runner[Any, Any]:
        """Return the runner for inputs like these."""
        layout = layout_of(inputs)
        if self._runner is None or layout != self._layout:
            library = self._library_for(self._law, inputs)
            self._runner = NumpyRunner(self._law) if library is None else CRunner(self._law, library)
            self._layout = layout
            self.step = self._runner.step  # from here on without a detour
        return self._runner

    def first(self, inputs: object) -> tuple[object, Any]:
        """Return state and output at the first sample."""
        return self.choose(inputs).first(inputs)

    def resumed(self, inputs: object, words: object) -> tuple[object, Any]:
        """Return state and output at a sample from which the law resumes by last words."""
        return self.choose(inputs).resumed(inputs, words)

    def step(self, state: object, inputs: object, dt: float) -> tuple[object, Any]:
        """Advance by ``dt`` [s] to a sample."""
        return self.choose(inputs).step(state, inputs, dt)

    def tree(self, state: object) -> Any:
        """Return the nested tuples of a state."""
        return state if self._runner is None else self._runner.tree(state)


def _can_be_traced(law: object) -> bool:
    """Whether it is worth a try: a law may say that it cannot be traced."""
    return bool(getattr(law, "traceable", True))


def recipe_for(law: Any, inputs: object) -> Recipe:
    """Return the recipe of a law for inputs like an example; it resumes, if the law has last words."""
    words = law.example_words() if hasattr(law, "example_words") else None
    return recipe_of(law, inputs, words)


def _loaded(recipe: Recipe) -> Library | None:
    """Return a law that is compiled already."""
    key = key_of(recipe)
    if key not in _libraries and (found := find_library(recipe)) is not None:
        with _lock:
            _libraries.setdefault(key, found)
    return _libraries.get(key)


def _build(recipes: Sequence[Recipe], tell: Log) -> list[Library | BuildError]:
    """Compile laws: here if JAX is loaded already, else in processes of their own."""
    if "jax" in sys.modules or what_is_missing() is not None:
        return [_build_here(each, tell) for each in recipes]
    count = min(len(recipes), os.cpu_count() or 1)
    workers = queue.SimpleQueue[Worker]()
    for _ in range(count):
        workers.put(Worker())

    def build(recipe: Recipe) -> Library | BuildError:
        worker = workers.get()
        answer = worker.build(recipe)
        workers.put(worker)
        if "error" in answer:
            return BuildError(answer["error"])
        # what that process cannot import or keep, this one may
        return (None if "unknown" in answer else find_library(recipe)) or _build_here(recipe, tell)

    with concurrent.futures.ThreadPoolExecutor(max_workers=count) as pool:
        built = list(pool.map(build, recipes))
    for _ in range(count):
        workers.get().close()
    return built


def _build_here(recipe: Recipe, tell: Log) -> Library | BuildError:
    """Compile a law in this process; where nothing can be kept, for this process alone."""
    try:
        return build_library(recipe)
    except BuildError as error:
        if not error.unkept:
            return error
        tell(f"compiled for this process alone: {error}")
    try:
        return build_library(recipe, keep=False)
    except BuildError as error:
        return error
