"""What is compiled of a law: its functions, with examples of their arguments."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any


@dataclasses.dataclass(frozen=True)
class Function:
    """One function: ``call(law, *arguments)`` returns a tuple of results."""

    call: Callable[..., tuple[Any, ...]]
    arguments: Mapping[str, Any]  # an example of each
    results: tuple[str, ...]
    kinds: Mapping[str, str] = dataclasses.field(
        default_factory=dict
    )  # argument or result -> its struct's name


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


def _parts(tree: Any) -> Iterator[Any]:
    yield tree
    if isinstance(tree, tuple):
        inside: Any = tree  # pyright: ignore[reportUnknownVariableType]
    elif dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        inside = [getattr(tree, field.name) for field in dataclasses.fields(tree)]
    else:
        inside = ()
    for each in inside:
        yield from _parts(each)


def first(law: Any, inputs: Any) -> tuple[Any, Any]:
    """State and output at the first sample."""
    return law.step(law.init(inputs), inputs, 0.0)


def step(law: Any, before: Any, inputs: Any, dt: Any) -> tuple[Any, Any]:
    """State and output ``dt`` [s] after the sample before."""
    return law.step(before, inputs, dt)


def resume(law: Any, inputs: Any, words: Any) -> tuple[Any, Any]:
    """State and output at a sample from which it resumes by last words."""
    return law.step(law.resumed(inputs, words), inputs, 0.0)


def recipe_of(law: Any, inputs: Any, words: Any = None, name: str = "") -> Recipe:
    """Return the recipe of a law with ``init`` and ``step``, for inputs like an example.

    With an example of last ``words`` its function ``resumed`` is compiled, too.
    """
    import numpy as np

    kinds = {"before": "state", "after": "state"}
    with np.errstate(all="ignore"):
        state = law.init(inputs)
    functions = {
        "first": Function(first, {"inputs": inputs}, ("after", "output"), kinds),
        "step": Function(
            step, {"before": state, "inputs": inputs, "dt": np.float64(0.004)}, ("after", "output"), kinds
        ),
    }
    if words is not None:
        functions["resumed"] = Function(
            resume, {"inputs": inputs, "words": words}, ("after", "output"), kinds
        )
    return Recipe(name or _snake(type(law).__name__), law, functions)


def _snake(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
