# pyright: basic
"""A flight and its derivative: how the sums of a tally change when gains do.

Forward mode: beside every float that a flight carries goes its slope along one direction of the gains. A
flight of any length takes the same memory, and a gradient takes one lane for each gain. The slope follows
the branch that was taken: it leaves out what a gain does by moving a decision (a detection, say) to another
sample. Where a function has no slope (a norm at zero), it counts as 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from quadftc_campaign.batch.compiled import Carried, CompiledFlight, PerFlight
from quadftc_campaign.batch.loop_step import StepInputs, Times
from quadftc_campaign.batch.tally import Tally

Floats = tuple[Any, ...]


class Slopes(NamedTuple):
    """Floats that are carried, or their slopes by unit of the direction."""

    loop: Floats
    sums: dict[str, Any]  # of the whole flight: no stretch sets their slopes to zero
    marks: Floats  # the rest of the tally


class SlopeFlight(CompiledFlight):
    """Functions that fly all flights of one structure, each with its slope along its direction."""

    def _begin(
        self, bias: Any, inputs: Sequence[StepInputs], times: Sequence[Times], per_flight: PerFlight
    ) -> tuple[Carried, list[Any]]:
        def begin(tuned: dict[str, Any]) -> tuple[Slopes, Carried]:
            state, _ = CompiledFlight._begin(self, bias, inputs, times, _with_tuned(per_flight, tuned))
            return _floats_of(state), state

        _, slopes, state = jax.jvp(begin, (_tuned(per_flight),), (per_flight.direction,), has_aux=True)
        return state._replace(slopes=_finite(slopes)), []

    def _step(
        self, state: Carried, inputs: tuple[StepInputs, PerFlight], times: Times
    ) -> tuple[Carried, Any]:
        step_inputs, per_flight = inputs

        def step(floats: Slopes, tuned: dict[str, Any]) -> tuple[Slopes, Carried]:
            arguments = (step_inputs, _with_tuned(per_flight, tuned))
            after, _ = CompiledFlight._step(self, _with_floats(state, floats), arguments, times)
            return _floats_of(after), after

        primals, tangents = (_floats_of(state), _tuned(per_flight)), (state.slopes, per_flight.direction)
        _, slopes, after = jax.jvp(step, primals, tangents, has_aux=True)
        return after._replace(slopes=_finite(slopes)), ()


def _tuned(per_flight: PerFlight) -> dict[str, Any]:
    return {path: per_flight.numbers[path] for path in per_flight.direction}


def _with_tuned(per_flight: PerFlight, tuned: dict[str, Any]) -> PerFlight:
    return per_flight._replace(numbers={**per_flight.numbers, **tuned})


def _is_float(leaf: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(leaf), jnp.floating)


def _floats_of(carried: Carried) -> Slopes:
    loop, marks = (
        tuple(filter(_is_float, jax.tree.leaves(part))) for part in (carried.loop, carried.tally[1:])
    )
    return Slopes(loop, carried.tally.sums, marks)


def _with_floats(carried: Carried, floats: Slopes) -> Carried:
    marks = _exchange(carried.tally[1:], floats.marks)
    return Carried(_exchange(carried.loop, floats.loop), Tally(floats.sums, *marks))


def _exchange(tree: Any, floats: Floats) -> Any:
    """Return the tree with other floats."""
    leaves, structure = jax.tree.flatten(tree)
    rest = iter(floats)
    return jax.tree.unflatten(structure, [next(rest) if _is_float(leaf) else leaf for leaf in leaves])


def _finite(slopes: Slopes) -> Slopes:
    return jax.tree.map(lambda slope: jnp.where(jnp.isfinite(slope), slope, 0.0), slopes)
