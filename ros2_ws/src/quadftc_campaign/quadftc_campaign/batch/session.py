# pyright: basic
"""Settings of JAX in this process."""

from __future__ import annotations

import os
from pathlib import Path

import jax

_settled: set[bool] = set()  # whether this process computes in single precision, once it is known


def settle_precision(float32: bool) -> None:
    """Set the precision of this process, for good: JAX keeps constants in that in which it met them first.

    Raises
    ------
    ValueError
        If this process computes in another one already.
    """
    if _settled and float32 not in _settled:
        there, wanted = ("float64", "float32") if float32 else ("float32", "float64")
        raise ValueError(f"precision {wanted}: this process computes in {there}; start another")
    _settled.add(float32)
    jax.config.update("jax_enable_x64", not float32)


def keep_compiled(directory: Path | None = None) -> None:
    """Keep what is compiled on disk, for other processes and the next time.

    Parameters
    ----------
    directory : Path, optional
        Default: ``$XDG_CACHE_HOME/quadftc/jax``.
    """
    place = directory or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "quadftc" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(place))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
