# pyright: basic
"""Flights of one structure, compiled: the first samples, then stretches of samples, many flights at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadftc_campaign.batch.inputs import ALL_DRAWS, InputSource
from quadftc_campaign.batch.loop_step import ClosedLoop, LoopState, Row, StepInputs, Times
from quadftc_campaign.batch.parts import FlightParts, Progress, in_precision, with_numbers
from quadftc_campaign.batch.tally import Outcome, Schedule, Tally, update_tally
from quadftc_model.staged_step import StagedStep
from quadftc_model.stepper import seconds

QUICK_TO_COMPILE = {"xla_backend_optimization_level": 0}  # the beginning runs once
MAX_SETTLING = 3  # steps in which the structure of a state may still change
STRETCH = 500  # samples of one call of the compiled function; between calls sums are taken out


class PerFlight(NamedTuple):
    """Constants of a flight."""

    numbers: dict[str, Any]  # of its parts, by path
    schedule: Schedule
    direction: dict[str, Any]  # in which some numbers change, for slopes


class Carried(NamedTuple):
    """What goes from step to step."""

    loop: LoopState
    tally: Tally
    # of loop and tally, None for what is no float; no stretch sets those of the sums to zero
    slopes: Any = None

    def shown(self) -> Any:
        """Return what `CompiledFlight.fly` reads in the end."""
        return self.tally, self.slopes and self.slopes[1].sums


class CompiledFlight:
    """Functions that fly all flights of one structure, arrays with the flights last."""

    def __init__(
        self,
        flight: FlightParts,  # one of the flights
        per_flight: PerFlight,  # of some flights, for its shapes
        late_start: bool,  # as in `ClosedLoop`
        dtype: np.dtype[Any],  # of all floats
        traced: bool,  # whether to keep every row
        staged: bool,  # whether to rewrite the step for CPUs (`StagedStep`), or to use ``jax.vmap``
    ) -> None:
        self._loop, self._late_start = in_precision(flight.loop, dtype), late_start
        self._dtype, self._traced = dtype, traced
        source = InputSource([flight], dtype)
        inputs, times = source.next(1)
        inputs, times = take(take(inputs, 0), 0, axis=-1), take(times, 0)
        drawn, per_flight = self._cast(take((source.first, per_flight), 0, axis=-1))
        # the beginning takes samples until the state keeps its structure: some laws remember a few first
        for settling in range(MAX_SETTLING + 1):
            self._first = self._loop.sensor.delay + 1 + settling
            first = [(inputs, times)] * self._first
            state = jax.eval_shape(self._begin, drawn, *zip(*first, strict=True), per_flight)[0]
            after = jax.eval_shape(self._step, state, (inputs, per_flight), times)[0]
            if jax.tree.structure(state) == jax.tree.structure(after):
                break
        else:
            raise ValueError(f"after {MAX_SETTLING} steps a state still gets more parts")
        self._needed_draws: Sequence[bool] = ALL_DRAWS
        self._step_all: Any = jax.vmap(self._step, in_axes=(-1, -1, None), out_axes=-1)
        if staged:
            self._step_all = StagedStep(self._step, state, (inputs, per_flight), times, Carried.shown)
            self._needed_draws = self._step_all.needed[0].draws
        begin: Any = jax.vmap(self._begin, in_axes=(-1, -1, None, -1), out_axes=-1)
        if staged:
            begin = self._staged_begin(drawn, *zip(*first, strict=True), per_flight)
        self.begin = jax.jit(begin, compiler_options=QUICK_TO_COMPILE)
        self.fly_stretch = jax.jit(self._fly_stretch, donate_argnums=0)

    def fly(
        self, flights: Sequence[FlightParts], per_flight: PerFlight, count: int, progress: Progress
    ) -> list[Outcome]:
        """Fly a block of flights, one in each lane; outcomes are wanted of the first ``count``."""
        first, loop = self._first, self._loop
        source = InputSource(flights, self._dtype)
        # the first samples, one by one
        inputs, times = ([take(tree, sample) for sample in range(first)] for tree in source.next(first))
        per_flight = self._cast(per_flight)
        state, rows = self.begin(source.first, inputs, times, per_flight)
        sums = to_float64(state.tally.sums)
        trace = [jax.tree.map(lambda *leaves: np.stack(leaves), *rows)] if self._traced else []
        progress(first * count)
        # the rest, in stretches; a trace in one
        stretch = max(loop.count - first, 1) if self._traced else STRETCH
        for start in range(first, loop.count, stretch):
            samples = min(stretch, loop.count - start)
            inputs, times = source.next(samples, self._needed_draws)
            if samples < stretch:  # as long as any other, so that nothing is compiled for it alone
                wanted = (inputs, times)
                inputs, times = jax.tree.map(lambda a: np.resize(a, (stretch, *a.shape[1:])), wanted)
            state, rows = self.fly_stretch(state, inputs, times, per_flight, samples)
            sums = jax.tree.map(np.add, sums, to_float64(state.tally.sums))
            trace += [rows] if self._traced else []
            progress(samples * count)
        tally = to_float64(state.tally)
        arrays = {
            "sums": sums,
            "marks": {**tally.ever, **tally.largest, **tally.smallest, **tally.last},
            "slope": to_float64(state.slopes and state.slopes[1].sums),
            "trace": jax.tree.map(lambda *parts: np.concatenate(parts), *trace) if self._traced else None,
        }
        period = seconds(loop.period_ns)
        span = (loop.count - loop.sensor.delay - 1) * period
        return [Outcome(span=span, period=period, **take(arrays, lane, axis=-1)) for lane in range(count)]

    def _begin(
        self, drawn: Any, inputs: Sequence[StepInputs], times: Sequence[Times], per_flight: PerFlight
    ) -> tuple[Carried, list[Row]]:
        """Take the first samples of one flight."""
        closed, schedule = self._closed_loop(per_flight), per_flight.schedule
        given = list(zip(inputs, times, strict=True))
        first = self._loop.sensor.delay + 1
        state, row = closed.begin(drawn, given[:first])
        rows, tally = [row], update_tally(None, row, schedule)
        for each in given[first:]:
            state, row = closed.step(state, *each)
            tally = update_tally(tally, row, schedule)
            rows.append(row)
        return self._cast(Carried(state, tally)), rows if self._traced else []

    def _staged_begin(self, *arguments: Any) -> Callable[..., Any]:
        """Return `_begin` for many flights in stages, as a step that has no state before."""
        drawn, inputs, times, per_flight = arguments

        def begin(_: Any, given: Any, times: Any) -> Any:
            return (), self._begin(given[0], given[1], times, given[2])

        staged = StagedStep(begin, (), (drawn, inputs, per_flight), times)
        return lambda drawn, inputs, times, per_flight: staged((), (drawn, inputs, per_flight), times)[1]

    def _step(
        self, state: Carried, inputs: tuple[StepInputs, PerFlight], times: Times
    ) -> tuple[Carried, Any]:
        """Take a sample of one flight."""
        step_inputs, per_flight = inputs
        loop, row = self._closed_loop(per_flight).step(state.loop, step_inputs, times)
        new = Carried(loop, update_tally(state.tally, row, per_flight.schedule))
        return self._cast(new), row if self._traced else ()

    def _fly_stretch(
        self, state: Carried, inputs: StepInputs, times: Times, per_flight: PerFlight, count: int
    ) -> tuple[Carried, Any]:
        """Fly all flights over the first ``count`` samples of the inputs, with sums that begin at zero."""
        sums = jax.tree.map(jnp.zeros_like, state.tally.sums)
        start = state._replace(tally=state.tally._replace(sums=sums))

        def body(carried: Carried, each: tuple[StepInputs, Times]) -> tuple[Carried, Any]:
            return self._step_all(carried, (each[0], per_flight), each[1])

        if self._traced:
            return jax.lax.scan(body, start, (inputs, times))
        return jax.lax.fori_loop(
            0, count, lambda index, carried: body(carried, take((inputs, times), index))[0], start
        ), ()

    def _closed_loop(self, per_flight: PerFlight) -> ClosedLoop:
        return ClosedLoop(with_numbers(self._loop, per_flight.numbers), self._late_start)

    def _cast(self, tree: Any) -> Any:
        """Put every float in the precision of the structure: a state must keep its types."""
        return jax.tree.map(lambda leaf: _cast_float(jnp.asarray(leaf), self._dtype), tree)


class SlopeFlight(CompiledFlight):
    """Functions that fly all flights of one structure, each with its slope along its direction.

    Forward mode: beside every float that a flight carries goes its slope along one direction of the gains. A
    flight of any length takes the same memory, and a gradient takes one lane for each gain. The slope follows
    the branch that was taken: it leaves out what a gain does by moving a decision (a detection, say) to
    another sample. Where a function has no slope (a norm at zero), it counts as 0.
    """

    def _begin(
        self, drawn: Any, inputs: Sequence[StepInputs], times: Sequence[Times], per_flight: PerFlight
    ) -> tuple[Carried, list[Any]]:
        begin = super()._begin
        return _differentiate(lambda _, tuned: begin(drawn, inputs, times, tuned)[0], (), (), per_flight), []

    def _step(
        self, state: Carried, inputs: tuple[StepInputs, PerFlight], times: Times
    ) -> tuple[Carried, Any]:
        step, (step_inputs, per_flight) = super()._step, inputs

        def fly(floats: Any, tuned: PerFlight) -> Carried:
            return step(_with_floats(state, floats), (step_inputs, tuned), times)[0]

        return _differentiate(fly, _floats_of(state), state.slopes, per_flight), ()


def to_float64(arrays: Any) -> Any:
    """Return a tree of arrays as NumPy arrays, floats in double precision."""
    return jax.tree.map(lambda array: _cast_float(np.asarray(array), np.dtype(np.float64)), arrays)


def take(arrays: Any, index: Any, axis: int = 0) -> Any:
    """Return what is at an index of an axis, the first or the last (-1), in each array of a tree."""
    place = index if axis == 0 else (..., index)
    return jax.tree.map(lambda array: array[place], arrays)


def _cast_float(array: Any, dtype: np.dtype[Any]) -> Any:
    return array.astype(dtype) if jnp.issubdtype(array.dtype, jnp.floating) else array


def _differentiate(
    fly: Callable[[Any, PerFlight], Carried], floats: Any, slopes: Any, per_flight: PerFlight
) -> Carried:
    """Return what ``fly`` returns for floats with these slopes, and the slopes of that."""

    def run(floats: Any, tuned: dict[str, Any]) -> tuple[Any, Carried]:
        after = fly(floats, per_flight._replace(numbers=per_flight.numbers | tuned))
        return _floats_of(after), after

    tuned = {path: per_flight.numbers[path] for path in per_flight.direction}
    _, new, after = jax.jvp(run, (floats, tuned), (slopes, per_flight.direction), has_aux=True)
    return after._replace(slopes=jax.tree.map(lambda each: jnp.where(jnp.isfinite(each), each, 0.0), new))


def _floats_of(carried: Carried) -> Any:
    def keep(leaf: Any) -> Any:
        return leaf if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else None

    return jax.tree.map(keep, (carried.loop, carried.tally))


def _with_floats(carried: Carried, floats: Any) -> Carried:
    def exchange(number: Any, leaf: Any) -> Any:
        return leaf if number is None else number

    parts = (carried.loop, carried.tally)
    return Carried(*jax.tree.map(exchange, floats, parts, is_leaf=lambda each: each is None))
