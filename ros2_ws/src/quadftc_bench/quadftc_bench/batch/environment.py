"""The environment in which the batch engine is quickest; JAX reads it when it is imported first."""

from __future__ import annotations

import os

WIDTH = "--xla_cpu_prefer_vector_width"


def environment(cores: int = 1) -> dict[str, str]:
    """Return the variables for a process that may use some cores.

    The widest vector registers that there are, of which XLA would use half, and as many threads as cores.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    return {
        "XLA_FLAGS": flags if WIDTH in flags else f"{flags} {WIDTH}=512".strip(),
        "NPROC": str(cores),
    }
