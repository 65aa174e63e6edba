"""Settings of JAX for batches and compiled steps: flags, which it reads on its first import, and precision.

XLA cuts a step into hundreds of kernels, and the call of a kernel takes longer than one flight's numbers in
it. Loops that XLA takes for small become one kernel with their bodies; a flag here says that all are small.
A loop with something that cannot be compiled so (a sort, a call of LAPACK) stays as it was.
"""

from __future__ import annotations

import os
from pathlib import Path

WIDTH = "--xla_cpu_prefer_vector_width"  # the widest registers, of which XLA would use half
SMALL_LOOP = "xla_cpu_small_while_loop_byte_threshold"  # what a loop reads and writes, at most [bytes]
FLAGS = {WIDTH: f"{WIDTH}=512", SMALL_LOOP: f"--xla_backend_extra_options={SMALL_LOOP}={2**62}"}

_precisions: set[bool] = set()  # whether this process computes in single precision, once it is known


def environment(cores: int = 1) -> dict[str, str]:
    """Return the variables for a process that may use some cores; flags that are set already stay."""
    flags = os.environ.get("XLA_FLAGS", "")
    ours = [flag for name, flag in FLAGS.items() if name not in flags]
    return {"XLA_FLAGS": " ".join([*flags.split(), *ours]), "NPROC": str(cores)}


def settle_precision(float32: bool) -> None:
    """Set the precision of this process, for good, as JAX keeps constants; ValueError if it has another."""
    import jax

    if _precisions and float32 not in _precisions:
        there, wanted = ("float64", "float32") if float32 else ("float32", "float64")
        raise ValueError(f"precision {wanted}: this process computes in {there}; start another")
    _precisions.add(float32)
    jax.config.update("jax_enable_x64", not float32)  # pyright: ignore[reportUnknownMemberType]


def keep_compiled_code() -> None:
    """Have JAX keep on disk what it compiles, for later processes."""
    import jax

    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for name, value in (
        ("jax_compilation_cache_dir", str(cache / "quadftc" / "jax")),
        ("jax_persistent_cache_min_compile_time_secs", 0.5),
    ):
        jax.config.update(name, value)  # pyright: ignore[reportUnknownMemberType]
