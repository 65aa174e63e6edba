"""Laws over long flights, in C: sample by sample in NumPy they take tests minutes."""

import jax
import numpy as np

from quadftc_compile.build import build_library
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_model.arrays import rows_of


def fly_arrays(law, inputs, dt, state=None):
    """Last state and outputs (n, ...) of a law over inputs (n, ...), ``dt`` [s] apart: one, or (n,).

    Without a state the law begins at the first sample. Single flags are the same at all samples.
    """
    first = rows_of(inputs, 0)
    runner = CRunner(law, build_library(recipe_of(law, first)))
    count = max(len(leaf) for leaf in jax.tree.leaves(inputs) if np.ndim(leaf))
    steps = np.array(np.broadcast_to(np.asarray(dt, float), count))
    if state is not None:
        state, outputs = runner.run(state, inputs, steps)
        return runner.tree(state), outputs
    state, output = runner.first(first)
    state, rest = runner.run(state, rows_of(inputs, slice(1, None)), steps[1:])
    return runner.tree(state), jax.tree.map(lambda one, more: np.concatenate([[one], more]), output, rest)


def fly_law(law, samples, dt, state=None):
    """The same for a sequence of inputs; outputs are a list."""
    inputs = jax.tree.map(lambda *rows: np.stack(rows), *samples)
    state, outputs = fly_arrays(law, inputs, dt, state)
    return state, [rows_of(outputs, row) for row in range(len(samples))]
