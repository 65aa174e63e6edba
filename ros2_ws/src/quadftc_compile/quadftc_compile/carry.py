"""Laws compiled beforehand, for a wheel to carry: for every processor of a kind, without JAX or compiler."""

from __future__ import annotations

import concurrent.futures
import functools
import multiprocessing
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from quadftc_compile import cache
from quadftc_compile.build import BuildError, key_of, make_library
from quadftc_compile.engine import recipe_for
from quadftc_compile.fingerprint import Compiler, compiler
from quadftc_compile.wiring import CONDUCTOR, compile_conductor

PORTABLE = ("-march=x86-64", "-mtune=generic")  # any x86-64


def portable_compiler(command: str = "") -> Compiler:
    """Return the compiler of a command as in `CC`, which names its target; BuildError if it does not work.

    Without a command: the compiler of this machine, for any x86-64.
    """
    found = compiler(*shlex.split(command))
    if found is None:
        raise BuildError(f"{command or 'cc, gcc, clang'}: no C compiler that works")
    return found if command else found._replace(command=(*found.command, *PORTABLE))


def carry(laws: Iterable[Any], folder: Path, cc: Compiler) -> str:
    """Compile laws, which have examples of their inputs, into a folder; BuildError if one cannot be.

    Return the machine that they are for, as in `cache.machine_of`.
    """
    conductor = compile_conductor(cc)
    cache.store_carried(folder, CONDUCTOR, conductor, {})
    recipes = {key_of(each): each for each in (recipe_for(law, law.example()) for law in laws)}
    # not threads: `ast`, which tells where a law is traced, does not take them in Python 3.11
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(mp_context=spawn) as pool:
        made = pool.map(functools.partial(make_library, cc=cc), recipes.values())
        for key, (library, record) in zip(recipes, made, strict=True):
            cache.store_carried(folder, key, library, record)
    return cache.machine_of(conductor)
