"""Laws compiled beforehand, for a wheel to carry: for every x86-64, and found without JAX or compiler."""

from __future__ import annotations

import concurrent.futures
import functools
import multiprocessing
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from quadftc_compile import cache
from quadftc_compile.build import PORTABLE, key_of, make_library
from quadftc_compile.engine import recipe_for
from quadftc_compile.wiring import CONDUCTOR, compile_conductor


def carry(laws: Iterable[Any], folder: Path) -> None:
    """Compile laws, which have examples of their inputs, into a folder; BuildError if one cannot be."""
    cache.store_carried(folder, CONDUCTOR, compile_conductor(*PORTABLE), {})
    recipes = {key_of(each): each for each in (recipe_for(law, law.example()) for law in laws)}
    # not threads: `ast`, which tells where a law is traced, does not take them in Python 3.11
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(mp_context=spawn) as pool:
        made = pool.map(functools.partial(make_library, more=PORTABLE), recipes.values())
        for key, (library, record) in zip(recipes, made, strict=True):
            cache.store_carried(folder, key, library, record)
