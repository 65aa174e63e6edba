"""What is compiled of a law: its functions, with examples of their arguments."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, cast

import numpy as np

from quadftc_compile.layout import snake_case


@dataclasses.dataclass(frozen=True)
class Function:
    """One function: ``call(law, *arguments)`` returns a tuple of results."""

    call: Callable[..., tuple[object, ...]]
    arguments: Mapping[str, object]  # an example of each
    results: tuple[str, ...]
    kinds: Mapping[str, str] = dataclasses.field(default_factory=dict[str, str])  # names of their structs


@dataclasses.dataclass(frozen=True)
class Recipe:
    """A law and its functions; everything of it can be pickled if the law can."""

    name: str
    law: Any
    functions: Mapping[str, Function]

    def classes(self) -> list[type]:
        """Return all classes that the functions depend on."""
        found: dict[type, None] = {}
        for part in _parts(self.law):
            found[type(part)] = None
        for function in self.functions.values():
            for tree in function.arguments.values():
                for part in _parts(tree):
                    found[type(part)] = None
        return [each for each in found if not each.__module__.startswith(("builtins", "numpy"))]


def _parts(tree: object) -> Iterator[object]:
    yield tree
    if isinstance(tree, tuple):
        inside: Iterable[object] = cast("tuple[object, ...]", tree)
    elif dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        inside = [getattr(tree, field.name) for field in dataclasses.fields(tree)]
    else:
        inside = ()
    for each in inside:
        yield from _parts(each)


def init(law: Any, inputs: object) -> tuple[object]:
    """State at the first sample; a step of 0 s from it gives the output."""
    return (law.init(inputs),)


def step(law: Any, before: object, inputs: object, dt: object) -> tuple[object, object]:
    """State and output ``dt`` [s] after the sample before."""
    return law.step(before, inputs, dt)


def resumed(law: Any, inputs: object, words: object) -> tuple[object]:
    """State that resumes at a sample by last words; a step of 0 s from it gives the output."""
    return (law.resumed(inputs, words),)


def recipe_of(law: Any, inputs: object, words: object = None, name: str = "") -> Recipe:
    """Return the recipe of a law with ``init`` and ``step``, for inputs like an example.

    With an example of last ``words`` its function ``resumed`` is compiled, too.
    """
    kinds = {"before": "state", "after": "state"}
    with np.errstate(all="ignore"):
        arguments = {"before": law.init(inputs), "inputs": inputs, "dt": np.float64(0.004)}
    functions = {
        "init": Function(init, {"inputs": inputs}, ("after",), kinds),
        "step": Function(step, arguments, ("after", "output"), kinds),
    }
    if words is not None:
        functions["resumed"] = Function(resumed, {"inputs": inputs, "words": words}, ("after",), kinds)
    return Recipe(name or name_of(law), law, functions)


def name_of(law: object) -> str:
    """Return the name of a law in C: its attribute ``named_after`` says which part of it tells more."""
    after = getattr(law, "named_after", None)
    return snake_case(type(law).__name__) if after is None else name_of(after)
