"""A law in single precision behind functions that take and give double."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from quadftc_compile.build import build_library
from quadftc_compile.layout import flatten, leaves_of
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_compile.single import single_library
from quadftc_model.arrays import rows_of

pytest.importorskip("jax")
sys.path.insert(0, str(Path(__file__).parent))
from exported_laws import COUNT, Waves, wave_samples


def test_a_law_in_float_says_what_it_says_in_double_but_for_rounding():
    law, (dt, inputs) = Waves(), wave_samples()
    recipe = recipe_of(law, law.example())
    libraries = (build_library(recipe, keep=False), single_library(recipe))
    runners = [CRunner(law, library) for library in libraries]
    states, said = [None, None], ([], [])
    for row in range(COUNT):
        seen = rows_of(inputs, row)
        for k, runner in enumerate(runners):
            states[k], output = runner.step(states[k], seen, dt[row]) if row else runner.first(seen)
            layout = libraries[k].entries["step"].results["output"]
            said[k].append(np.concatenate([np.ravel(each) for each in flatten(layout, output)]))
    double, single = map(np.array, said)
    assert single.dtype == double.dtype == np.float64
    np.testing.assert_allclose(single, double, rtol=1e-4, atol=1e-4)
    assert np.abs(single - double).max() > 1e-9  # it is float
    kept = leaves_of(libraries[1].entries["step"].arguments["before"])
    assert {leaf.dtype for leaf in kept} == {np.dtype(np.float32)}
