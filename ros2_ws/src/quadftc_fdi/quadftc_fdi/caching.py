"""Caching of small tables that depend on numbers alone, such as the gains for a sampling period."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


def cache_numbers(function: Callable[..., T]) -> Callable[..., T]:
    """Keep the results for arguments that are all floats or texts, of which a flight has few.

    Other arguments, such as parameters that JAX traces, are computed each time.
    """
    cached: Callable[..., T] = functools.lru_cache(maxsize=256)(function)

    @functools.wraps(function)
    def call(*arguments: Any) -> T:
        plain = all(isinstance(each, (float, str)) for each in arguments)
        return cached(*arguments) if plain else function(*arguments)

    return call
