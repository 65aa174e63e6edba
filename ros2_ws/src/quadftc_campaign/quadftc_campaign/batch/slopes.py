# pyright: basic
"""A flight and its derivative: how the sums of a tally change when gains do.

Forward mode: beside every float that a flight carries goes its slope along one direction of the gains, so a
flight of any length takes the same memory, and a gradient takes one lane for each gain. A slope is that of
the branch that was taken: what a gain does by moving a decision (the moment of a detection, say) to another
sample is not in it. Where a function has no slope (a norm at zero), it is taken as 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from quadftc_campaign.batch.compiled import Brought, Carried, CompiledFlight, Own, Times
from quadftc_campaign.batch.loop import LoopState
from quadftc_campaign.batch.tally import Sums, Tally

Floats = tuple[Any, ...]


class Slopes(NamedTuple):
    """Of all floats that are carried, by unit of the direction."""

    loop: Floats
    tally: Floats


class CarriedWithSlopes(NamedTuple):
    """What goes from step to step."""

    loop: LoopState
    tally: Tally
    slopes: Slopes


class SlopeFlight(CompiledFlight):
    """Functions that fly all flights of one structure, each with its slope along a direction of its own.

    The slopes of sums are those of the whole flight: they are never taken out.
    """

    def _shown(self, carried: CarriedWithSlopes) -> Any:
        return carried.tally, carried.slopes.tally

    def _begin(
        self, bias: Any, brought: Sequence[Brought], own: Own, times: Sequence[Times]
    ) -> tuple[CarriedWithSlopes, list[Any]]:
        def begun(tuned: dict[str, Any]) -> tuple[Slopes, Carried]:
            state, _ = CompiledFlight._begin(self, bias, brought, _with(own, tuned), times)
            return _floats_of(state), state

        _, slopes, state = jax.jvp(begun, (_tuned(own),), (own.direction,), has_aux=True)
        return CarriedWithSlopes(state.loop, state.tally, _finite(slopes)), []

    def _step(
        self, state: CarriedWithSlopes, inputs: tuple[Brought, Own], times: Times
    ) -> tuple[CarriedWithSlopes, Any]:
        brought, own = inputs
        before = Carried(state.loop, state.tally)

        def stepped(floats: Slopes, tuned: dict[str, Any]) -> tuple[Slopes, Carried]:
            carried = Carried(
                _with_floats(before.loop, floats.loop), _with_floats(before.tally, floats.tally)
            )
            after, _ = CompiledFlight._step(self, carried, (brought, _with(own, tuned)), times)
            return _floats_of(after), after

        primals, tangents = (_floats_of(before), _tuned(own)), (state.slopes, own.direction)
        _, slopes, after = jax.jvp(stepped, primals, tangents, has_aux=True)
        return CarriedWithSlopes(after.loop, after.tally, _finite(slopes)), ()


def slope_of_sums(carried: CarriedWithSlopes) -> Sums:
    """The slopes of the sums of a flight; its leaves are floats, and the first of the tally."""
    return Sums(*carried.slopes.tally[: len(Sums._fields)])


def _tuned(own: Own) -> dict[str, Any]:
    return {path: own.numbers[path] for path in own.direction or {}}


def _with(own: Own, tuned: dict[str, Any]) -> Own:
    return own._replace(numbers={**own.numbers, **tuned})


def _is_float(leaf: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(leaf), jnp.floating)


def _floats_of(carried: Carried) -> Slopes:
    return Slopes(*(tuple(filter(_is_float, jax.tree.leaves(part))) for part in carried))


def _with_floats(tree: Any, floats: Floats) -> Any:
    """The tree with other floats."""
    leaves, structure = jax.tree.flatten(tree)
    rest = iter(floats)
    return jax.tree.unflatten(structure, [next(rest) if _is_float(leaf) else leaf for leaf in leaves])


def _finite(slopes: Slopes) -> Slopes:
    keep: Callable[[Any], Any] = lambda slope: jnp.where(jnp.isfinite(slope), slope, 0.0)  # noqa: E731
    return jax.tree.map(keep, slopes)
