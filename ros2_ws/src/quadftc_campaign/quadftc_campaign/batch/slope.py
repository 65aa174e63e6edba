# pyright: basic
"""Slopes of flights: how sums over a flight change with numbers of its laws.

Forward mode: beside every float that a flight carries go its slopes, one along each direction in which some
numbers change. JAX derives the step of the whole loop, and C evaluates it, all slopes at once. A flight of
any length takes the same memory.

The slopes follow the branch that was taken: they leave out what a number does by moving a decision (a
detection, say) to another sample. Where a function has no slope (a norm at zero), it counts as 0.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from quadftc_campaign.batch.engine import BatchFlight, Floats, Outcome, Progress, outcome_of
from quadftc_campaign.batch.judged_loop import JudgedLoop, JudgedState
from quadftc_compile.build import build_library
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_compile.wiring import BLOCK
from quadftc_flight.loop import LoopInputs
from quadftc_flight.loop_draws import LoopDraws
from quadftc_model.arrays import Array, Scalar
from quadftc_model.composition import PlainCalls
from quadftc_model.numbers import number_at, part_at, prepared, structure_of, with_numbers

T = TypeVar("T")

TOGETHER = 16  # directions in one flight at most: a step takes up to 0.13 MB of the stack for each


class SlopedState(NamedTuple):
    """State of a judged loop and its slopes."""

    state: JudgedState
    slopes: Any  # of the floats, (directions, ...); None beside what is no float


class SlopedInputs(NamedTuple):
    """What goes into a judged loop at a sample, and how its numbers change."""

    sample: LoopInputs
    directions: tuple[Array, ...]  # of the number at each path, (directions, ...)


class Sloped(NamedTuple):
    """What is left of a flight, with slopes of its sums by name, (directions, ...)."""

    outcome: Outcome
    slopes: dict[str, Floats]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SlopedLoop:
    """A judged loop and its slopes, as one law."""

    loop: JudgedLoop
    paths: tuple[str, ...]  # of the loop's numbers that change
    count: int  # of directions

    @prepared
    def first(self) -> JudgedState:
        """What the loop begins with, whatever the numbers that change: its laws begin at the first sample."""
        with np.errstate(all="ignore"):
            return jax.tree.map(np.asarray, self.loop.init(PlainCalls(self.loop.laws)))

    def example(self) -> SlopedInputs:
        """Return the inputs of one sample, along no direction."""
        shapes = [(self.count, *number_at(self.loop, path).shape) for path in self.paths]
        return SlopedInputs(LoopDraws.example(self.loop.loop), tuple(map(np.zeros, shapes)))

    def init(self, inputs: SlopedInputs) -> SlopedState:
        """Return what a flight begins with."""
        zeros = jax.tree.map(lambda x: np.zeros((self.count, *x.shape)), _floats_of(self.first))
        return SlopedState(self.first, zeros)

    def step(self, state: SlopedState, inputs: SlopedInputs, dt: Scalar) -> tuple[SlopedState, tuple[()]]:
        """Advance to the next sample, whose inputs have its times."""

        def fly(floats: Any, numbers: Sequence[Array]) -> tuple[Any, JudgedState]:
            loop = with_numbers(self.loop, dict(zip(self.paths, numbers, strict=True)))
            after, _ = loop.step(TracedCalls(loop.laws), _with_floats(state.state, floats), inputs.sample)
            return _floats_of(after), after

        given = _floats_of(state.state), tuple(part_at(self.loop, path) for path in self.paths)

        def derive(*along: object) -> tuple[Any, JudgedState]:
            _, slopes, after = jax.jvp(fly, given, along, has_aux=True)
            return slopes, after

        slopes, after = jax.vmap(derive, out_axes=(0, None))(state.slopes, inputs.directions)
        finite = jax.tree.map(lambda slope: jnp.where(jnp.isfinite(slope), slope, 0.0), slopes)
        return SlopedState(after, finite), ()


class TracedCalls(PlainCalls):
    """Calls the laws with arrays of JAX, also where a loop gives them constants."""

    def step(self, name: str, state: object, inputs: object, dt: Scalar) -> tuple[object, Any]:
        """Step a law by ``dt`` [s]; where that is 0, the law begins."""
        return super().step(name, state, jax.tree.map(jnp.asarray, inputs), dt)


def fly_with_slopes(
    flights: Sequence[BatchFlight],
    directions: Mapping[str, Floats],
    progress: Progress = lambda samples: None,
) -> list[Sloped]:
    """Fly flights in C with slopes along directions, which change some numbers of their loops.

    By the path of a number: (directions, ...). A `BuildError` says why a loop cannot be compiled.
    """
    total = len(next(iter(directions.values())))
    count = -(-total // -(-total // TOGETHER))
    runners: dict[Hashable, CRunner] = {}
    flown: list[Sloped] = []
    for flight in flights:
        law, key = (
            SlopedLoop(loop=flight.loop, paths=tuple(directions), count=count),
            structure_of(flight.loop),
        )
        if key in runners:
            runners[key].configure(law)
        else:
            runners[key] = CRunner(law, build_library(recipe_of(law, law.example())))
        parts: list[Sloped] = []
        for start in range(0, total, count):
            rows = np.minimum(np.arange(start, start + count), total - 1)  # the last one fills those left
            along = tuple(each[rows] for each in directions.values())
            parts.append(_fly(flight, runners[key], along, progress))
        names = parts[0].slopes
        slopes = {name: np.concatenate([each.slopes[name] for each in parts])[:total] for name in names}
        flown.append(Sloped(parts[0].outcome, slopes))
    return flown


def _fly(flight: BatchFlight, runner: CRunner, along: tuple[Floats, ...], progress: Progress) -> Sloped:
    law: Any = runner.law
    state, draws = law.init(None), flight.draws
    for begin in range(0, flight.samples, BLOCK):
        rows = min(BLOCK, flight.samples - begin)
        state, _ = runner.run(state, SlopedInputs(draws.next(rows), along), flight.period)
        progress(rows)
    flown: SlopedState = runner.tree(state)
    slopes = flown.slopes.judge.tally.sums._asdict()
    kept = {name: slope for name, slope in slopes.items() if slope is not None}
    return Sloped(outcome_of(flight, flown.state.judge.tally), kept)


def _floats_of(state: object) -> Any:
    return jax.tree.map(lambda leaf: leaf if jnp.issubdtype(leaf.dtype, jnp.floating) else None, state)


def _with_floats(state: T, floats: object) -> T:
    def exchange(number: Array | None, leaf: Array) -> Array:
        return leaf if number is None else number

    return jax.tree.map(exchange, floats, state, is_leaf=lambda each: each is None)
