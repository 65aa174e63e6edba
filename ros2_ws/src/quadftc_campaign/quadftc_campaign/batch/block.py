# pyright: basic
"""One block of flights, flown a stretch of samples at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from quadftc_campaign.batch.compiled import CompiledFlight, PerFlight, cast_float
from quadftc_campaign.batch.inputs import InputSource
from quadftc_campaign.batch.loop_step import Row
from quadftc_campaign.batch.parts import FlightParts
from quadftc_campaign.batch.tally import Outcome, Sums
from quadftc_model.stepper import NANOSECONDS_PER_SECOND

STRETCH = 500  # samples of one call of the compiled function; between calls sums are taken out


def fly_block(
    compiled: CompiledFlight,
    flights: Sequence[FlightParts],
    per_flight: PerFlight,
    count: int,
    progress: Callable[[int], None] = lambda _: None,
    keep: Callable[[Row], None] | None = None,
) -> tuple[list[Outcome], Any]:
    """Fly a block of flights, one in each lane.

    Parameters
    ----------
    compiled : CompiledFlight
    flights : sequence of FlightParts
    per_flight : PerFlight
        Arrays (..., flights).
    count : int
        How many outcomes are wanted, of the first flights; the others fill the lanes.
    progress : callable
        Called with the number of samples flown since the last call.
    keep : callable, optional
        Takes the rows of each stretch, arrays (samples, ..., flights).

    Returns
    -------
    list of Outcome
    pytree
        The last state, arrays (..., flights).
    """
    structure, first = compiled.structure, compiled.first_samples
    per_flight = jax.tree.map(lambda array: cast_float(array, structure.dtype), per_flight)
    source = InputSource(flights, structure.dtype, compiled.needed_draws)
    # the first samples, one by one
    inputs, times = (_split(tree, first) for tree in source.next(first, every=True))
    state, rows = compiled.begin(source.bias, inputs, times, per_flight)
    per_flight = jax.device_put(per_flight)
    total = to_float64(state.tally.sums)
    progress(first * count)
    if keep is not None:
        keep(jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *rows))
    # the rest, in stretches
    for start in range(first, structure.loop.count, STRETCH):
        samples = min(STRETCH, structure.loop.count - start)
        inputs, times = source.next(samples)
        if keep is None and samples < STRETCH:
            inputs, times = jax.tree.map(_fill_up, (inputs, times))
        state, rows = compiled.fly(state, inputs, times, per_flight, samples)
        if keep is not None:
            keep(jax.tree.map(np.asarray, rows))
        total = Sums(*(a + b for a, b in zip(total, to_float64(state.tally.sums), strict=True)))
        progress(samples * count)
    marks, loop = to_float64(state.tally.marks), structure.loop
    rows_out, period = loop.count - loop.sensor.delay, loop.period_ns / NANOSECONDS_PER_SECOND
    outcomes = [Outcome(lane_of(total, k), lane_of(marks, k), rows_out, period) for k in range(count)]
    return outcomes, state


def to_float64(arrays: Any) -> Any:
    """Return a tuple's arrays as NumPy arrays, floats in double precision."""
    return type(arrays)(*(cast_float(np.asarray(array), np.dtype(np.float64)) for array in arrays))


def lane_of(arrays: Any, lane: int) -> Any:
    """Return the numbers of one flight of a tuple's arrays."""
    return type(arrays)(*(array[..., lane] for array in arrays))


def _split(tree: Any, count: int) -> list[Any]:
    """Split a tree of arrays (count, ...) into trees of single samples."""
    return [jax.tree.map(lambda leaf: leaf[index], tree) for index in range(count)]  # noqa: B023


def _fill_up(array: Any) -> Any:
    """Make a stretch as long as any other, so that nothing is compiled for it alone."""
    return np.concatenate([array, np.zeros((STRETCH - len(array), *array.shape[1:]), array.dtype)])
