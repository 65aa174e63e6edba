# pyright: basic
"""A fault observer alone over the samples of many flights, compiled by JAX: in stretches, flights last."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.compiled import MAX_SETTLING, STRETCH, take
from quadftc_campaign.batch.engine import lanes_for
from quadftc_campaign.batch.parts import numbers_of, structure_of
from quadftc_fdi.fault_observer import FaultObserver
from quadftc_model.jax_settings import keep_compiled_code, settle_precision
from quadftc_model.samples import FaultEstimate, FaultObserverInputs
from quadftc_model.staged_step import StagedStep

BEGINNING = MAX_SETTLING + 1  # samples that NumPy takes, in which the structure of a state may still change
PERIOD = 0.004  # s; for shapes

_compiled: dict[Any, CompiledScan] = {}


def scan(law: FaultObserver, inputs: FaultObserverInputs, dt: NDArray[np.float64]) -> FaultEstimate:
    """Start an observer on the first of samples (n, flights, ...), and step over all; ``dt[0]`` [s] is 0.

    What `quadftc_model.compiled.UNTRACEABLE` names is raised where JAX cannot trace the observer.
    """
    settle_precision(float32=False)
    keep_compiled_code()
    state, said = law.init(take(inputs, 0)), []
    for row in range(min(BEGINNING, len(dt))):
        state, estimate = law.step(state, take(inputs, row), float(dt[row]))
        said.append(estimate)
    beginning = jax.tree.map(lambda *each: np.stack(each), *said)
    if len(dt) <= BEGINNING:
        return beginning
    one = take(inputs, (0, 0))
    numbers = tuple((path, value.tobytes()) for path, value in numbers_of(law).items())
    key = structure_of(law), numbers, jax.tree.structure(one)
    if key not in _compiled:
        _compiled[key] = CompiledScan(law, one)
    later = _compiled[key](state, take(inputs, slice(BEGINNING, None)), dt[BEGINNING:])
    return jax.tree.map(lambda first, then: np.concatenate([first, then]), beginning, later)


class CompiledScan:
    """Steps of an observer, compiled once for each power of two of flights."""

    def __init__(self, law: FaultObserver, one: FaultObserverInputs) -> None:
        single, dt = jax.tree.map(jnp.asarray, (one, PERIOD))
        self._state = jax.eval_shape(law.init, single)
        for _ in range(MAX_SETTLING):
            self._state = jax.eval_shape(law.step, self._state, single, dt)[0]
        staged = StagedStep(law.step, self._state, single, dt)

        self._stretch = jax.jit(
            lambda state, inputs, dt: jax.lax.scan(lambda s, each: staged(s, *each), state, (inputs, dt))
        )

    def __call__(self, state: Any, inputs: Any, dt: NDArray[np.float64]) -> Any:
        """Step from a state (flights, ...) over samples (n, flights, ...), in NumPy."""
        flights = inputs.imu.body_rate.shape[1]
        lanes = np.minimum(np.arange(lanes_for(flights)), flights - 1)  # the last fills those that are left

        def in_lanes(leaf: Any, one: Any) -> Any:
            filled = np.broadcast_to(leaf, (flights, *one.shape))[lanes]
            return np.moveaxis(filled, 0, -1).astype(one.dtype)

        state, said = jax.tree.map(in_lanes, state, self._state), []
        for start in range(0, len(dt), STRETCH):
            rows = np.minimum(np.arange(start, start + STRETCH), len(dt) - 1)  # all stretches are as long
            given = jax.tree.map(lambda each, rows=rows: np.moveaxis(each[rows][:, lanes], 1, -1), inputs)
            state, estimates = self._stretch(state, given, dt[rows])
            there = slice(min(STRETCH, len(dt) - start)), ..., slice(flights)
            said.append(
                jax.tree.map(lambda each, at=there: np.moveaxis(np.asarray(each)[at], -1, 1), estimates)
            )
        return jax.tree.map(lambda *each: np.concatenate(each), *said)
