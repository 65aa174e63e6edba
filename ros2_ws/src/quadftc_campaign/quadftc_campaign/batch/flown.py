# pyright: basic
"""One block of flights flown, a stretch of samples at a time, and what is left of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from quadftc_campaign.batch.compiled import CompiledFlight, Own
from quadftc_campaign.batch.loop import Row
from quadftc_campaign.batch.parts import FlightParts
from quadftc_campaign.batch.supply import Supply
from quadftc_campaign.batch.tally import Marks, Sums
from quadftc_model.stepper import NANOSECONDS_PER_SECOND

STRETCH = 500  # samples between two looks from outside: sums are taken out, random numbers brought


class Outcome(NamedTuple):
    """What is left of one flight; arrays as in `Sums` and `Marks`, in double precision."""

    sums: Sums
    marks: Marks
    rows: int  # samples that came out of the IMU
    period: float  # of the samples [s]


def flown(
    compiled: CompiledFlight,
    flights: Sequence[FlightParts],
    own: Own,
    count: int,
    progress: Callable[[int], None],
    keep: Callable[[Row], None] | None = None,
) -> tuple[list[Outcome], Any]:
    """Fly a block of flights, one in each lane.

    Parameters
    ----------
    compiled : CompiledFlight
    flights : sequence of FlightParts
    own : Own
        What each has of its own, arrays (..., flights).
    count : int
        How many of them, the first, are wanted; the others fill the lanes.
    progress : callable
        Called with the number of samples flown since the last call.
    keep : callable, optional
        Takes the rows of each stretch, arrays (samples, ..., flights).

    Returns
    -------
    list of Outcome
    pytree
        What is carried in the end, arrays (..., flights).
    """
    structure = compiled.structure
    supply = Supply(flights, structure, compiled.needed)
    first = compiled.first_samples
    brought, times = supply.next(first, every=True)
    state, rows = compiled.begin(
        supply.bias,
        _one_by_one(brought, first),
        _in_precision(own, structure.dtype),
        _one_by_one(times, first),
    )
    own = jax.device_put(_in_precision(own, structure.dtype))
    total = doubled(state.tally.sums)
    progress(first * count)
    if keep is not None:
        keep(jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *rows))
    for start in range(first, structure.loop.count, STRETCH):
        samples = min(STRETCH, structure.loop.count - start)
        brought, times = supply.next(samples)
        if keep is None and samples < STRETCH:
            brought, times = jax.tree.map(_filled, (brought, times))
        state, rows = compiled.fly(state, brought, own, times, samples)
        if keep is not None:
            keep(jax.tree.map(np.asarray, rows))
        total = Sums(*(a + b for a, b in zip(total, doubled(state.tally.sums), strict=True)))
        progress(samples * count)
    marks, loop = doubled(state.tally.marks), structure.loop
    rows_out, period = loop.count - loop.sensor.delay, loop.period_ns / NANOSECONDS_PER_SECOND
    outcomes = [Outcome(lane_of(total, k), lane_of(marks, k), rows_out, period) for k in range(count)]
    return outcomes, state


def _one_by_one(tree: Any, count: int) -> list[Any]:
    """Trees of single samples from a tree of arrays (count, ...)."""
    leaves, structure = jax.tree.flatten(tree)
    return [jax.tree.unflatten(structure, [leaf[index] for leaf in leaves]) for index in range(count)]


def _filled(array: Any) -> Any:
    """As long as any other stretch, so that nothing is compiled for this one alone."""
    return np.concatenate([array, np.zeros((STRETCH - len(array), *array.shape[1:]), array.dtype)])


def _in_precision(own: Own, dtype: np.dtype[Any]) -> Own:
    def cast(array: Any) -> Any:
        return array.astype(dtype) if array.dtype.kind == "f" else array

    return jax.tree.map(cast, own)


def doubled(tree: Any) -> Any:
    """Arrays of NumPy, floats in double precision."""
    arrays = [np.asarray(leaf) for leaf in tree]
    return type(tree)(*(array.astype(np.float64) if array.dtype.kind == "f" else array for array in arrays))


def lane_of(tree: Any, lane: int) -> Any:
    """Of one flight."""
    return type(tree)(*(leaf[..., lane] for leaf in tree))
