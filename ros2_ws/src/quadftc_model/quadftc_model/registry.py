"""Named components: one new file with one ``@register("name")`` adds an observer, a controller, a fault...

A registry finds its own files: it imports every module of its package on the first look-up. It imports the
entry points of its group, by which other packages add theirs, for a name that is in none of these files.
"""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
import sys
from collections.abc import Callable
from typing import Any, Generic, TypeVar

if sys.version_info >= (3, 11):
    from typing import dataclass_transform
else:
    from typing_extensions import dataclass_transform

from quadftc_model.hints import nearest

T = TypeVar("T")
Component = TypeVar("Component")


class Registry(Generic[T]):
    """The components of one kind, by name.

    ``kind`` says in error messages what they are ("fault observer"). The modules of ``package`` and the
    entry points of ``group`` register them.
    """

    def __init__(self, kind: str, package: str, group: str) -> None:
        self.kind, self._package, self._group = kind, package, group
        self._components: dict[str, type[Any]] = {}  # of T, which `register` does not check
        self._sources = [self._import_files, self._import_entry_points]  # not looked at yet

    @dataclass_transform(eq_default=False, kw_only_default=True, frozen_default=True)
    def register(self, name: str) -> Callable[[type[Component]], type[Component]]:
        """Class decorator that makes a frozen dataclass, if it is none yet, and adds it under ``name``."""

        def add(component: type[Component]) -> type[Component]:
            if "__dataclass_params__" not in vars(component):
                component = dataclasses.dataclass(frozen=True, eq=False, kw_only=True)(component)
            present = self._components.get(name)
            if present is not None and _origin(present) != _origin(component):
                raise ValueError(f"{self.kind} '{name}': registered twice ({present!r} and {component!r})")
            self._components[name] = component
            return component

        return add

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted."""
        while self._sources:
            self._import_next()
        return tuple(sorted(self._components))

    def get(self, name: str) -> type[T]:
        """Return the component's class."""
        while name not in self._components:
            if not self._sources:
                hint = nearest(str(name), self._components)
                raise ValueError(f"no {self.kind} '{name}'{hint}; there are: {', '.join(self.names())}")
            self._import_next()
        return self._components[name]

    def name_of(self, component: type[T]) -> str:
        """Return the name of a component's class."""
        return next(name for name, each in self._components.items() if each is component)

    def _import_next(self) -> None:
        self._sources[0]()
        del self._sources[0]  # only now: what cannot be imported fails at every look-up

    def _import_files(self) -> None:
        package = importlib.import_module(self._package)
        for module in pkgutil.iter_modules(package.__path__):
            importlib.import_module(f"{self._package}.{module.name}")

    def _import_entry_points(self) -> None:
        import importlib.metadata  # takes 50 ms

        for entry in importlib.metadata.entry_points(group=self._group):
            self.register(entry.name)(entry.load())


def _origin(component: type) -> tuple[str, str]:
    """Where a class is defined; the same for a module that is imported again."""
    return component.__module__, component.__qualname__
