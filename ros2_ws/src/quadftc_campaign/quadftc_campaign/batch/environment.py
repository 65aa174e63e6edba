"""The environment in which the batch engine is quickest; JAX reads it before it computes anything.

XLA cuts a step into hundreds of kernels, and to call one takes longer than to step one flight through it.
Loops that it takes for small it compiles into one kernel, with their bodies; here it is told that all are
small. Loops in which something cannot be compiled that way (a sort, a call of LAPACK) it leaves as they were.
"""

from __future__ import annotations

import os

WIDTH = "--xla_cpu_prefer_vector_width"
SMALL_LOOP = "xla_cpu_small_while_loop_byte_threshold"  # what a loop reads and writes, at most [bytes]
FLAGS = {
    WIDTH: f"{WIDTH}=512",
    SMALL_LOOP: f"--xla_backend_extra_options={SMALL_LOOP}={2**62}",
}


def environment(cores: int = 1) -> dict[str, str]:
    """Return the variables for a process that may use some cores.

    The widest vector registers that there are, of which XLA would use half; one kernel for a loop; and as
    many threads as cores. Flags that are set already stay as they are.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    ours = [flag for name, flag in FLAGS.items() if name not in flags]
    return {"XLA_FLAGS": " ".join([*flags.split(), *ours]), "NPROC": str(cores)}
