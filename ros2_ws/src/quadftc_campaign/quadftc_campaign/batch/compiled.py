# pyright: basic
"""Flights of one structure, compiled: the first samples, then stretches of samples, many flights at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadftc_campaign.batch.inputs import is_random
from quadftc_campaign.batch.loop_step import ClosedLoop, Delivery, LoopState, Row, StepInputs, Times
from quadftc_campaign.batch.parts import Loop, in_precision, numbers_of, with_numbers
from quadftc_campaign.batch.staged_step import StagedStep
from quadftc_campaign.batch.tally import Schedule, Tally, empty_tally, update_tally
from quadftc_sim.injector import FaultDraws

QUICK_TO_COMPILE = {"xla_backend_optimization_level": 0}  # the beginning runs once
MAX_SETTLING = 3  # steps in which the structure of a state may still change


class PerFlight(NamedTuple):
    """Constants of a flight."""

    numbers: dict[str, Any]  # of its parts, by path
    schedule: Schedule
    direction: dict[str, Any] | None = None  # in which some numbers change, for slopes


class Carried(NamedTuple):
    """What goes from step to step."""

    loop: LoopState
    tally: Tally


@dataclasses.dataclass(frozen=True, eq=False)
class Structure:
    """Everything that flights must share to fly together.

    Parameters
    ----------
    loop : Loop
        The parts of one of the flights.
    varying : tuple of str
        Paths of the numbers that differ between flights.
    events : int
        Faults of an axis, at most.
    late_start : bool
        Whether a fault may keep the diagnosis from beginning with the first sample.
    float32 : bool
        Single precision in place of double.
    tuned : tuple of str
        Paths of the numbers whose change a flight is differentiated by; all of them vary.
    """

    loop: Loop
    varying: tuple[str, ...]
    events: int
    late_start: bool
    float32: bool
    tuned: tuple[str, ...] = ()

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of all floats."""
        return np.dtype(np.float32 if self.float32 else np.float64)


class CompiledFlight:
    """Functions that fly all flights of one structure, arrays with the flights last.

    Parameters
    ----------
    structure : Structure
    traced : bool
        Whether to keep every row, for traces of chosen flights.
    staged : bool
        Whether to rewrite the step for CPUs (`quadftc_campaign.batch.staged_step`), or to use ``jax.vmap``.

    Raises
    ------
    ValueError
        If a part cannot be compiled.
    """

    def __init__(self, structure: Structure, traced: bool = False, staged: bool = True) -> None:
        self.structure = dataclasses.replace(structure, loop=in_precision(structure.loop, structure.dtype))
        self._traced = traced
        inputs, per_flight, times = self._shapes()
        bias = jax.ShapeDtypeStruct((3,), structure.dtype)
        # the beginning takes samples until the state keeps its structure: some laws remember a few first
        for settling in range(MAX_SETTLING + 1):
            self.first_samples = structure.loop.sensor.delay + 1 + settling
            first = [(inputs, times)] * self.first_samples
            state = jax.eval_shape(self._begin, bias, *zip(*first, strict=True), per_flight)[0]
            after = jax.eval_shape(self._step, state, (inputs, per_flight), times)[0]
            if jax.tree.structure(state) == jax.tree.structure(after):
                break
        else:
            raise ValueError(f"after {MAX_SETTLING} steps a state still gets more parts")
        self.needed_draws: Sequence[bool] = [True] * len(inputs.draws)
        self._step_all: Any = jax.vmap(self._step, in_axes=(-1, -1, None), out_axes=-1)
        if staged:
            self._step_all = StagedStep(self._step, state, (inputs, per_flight), times, self._shown)
            self.needed_draws = self._step_all.needed[0].draws
        begin = jax.vmap(self._begin, in_axes=(-1, -1, None, -1), out_axes=-1)
        self.begin = jax.jit(begin, compiler_options=QUICK_TO_COMPILE)
        self.fly = jax.jit(self._fly_stretch, donate_argnums=0)

    def _shown(self, carried: Any) -> Any:
        """Select the part of a state that the engine reads in the end."""
        return carried.tally

    def _begin(
        self, bias: Any, inputs: Sequence[StepInputs], times: Sequence[Times], per_flight: PerFlight
    ) -> tuple[Carried, list[Row]]:
        """Take the first samples of one flight."""
        closed, schedule = self._closed_loop(per_flight), per_flight.schedule
        given = list(zip(inputs, times, strict=True))
        first = self.structure.loop.sensor.delay + 1
        state, row = closed.begin(bias, given[:first])
        rows, tally = [row], update_tally(empty_tally(bias, self.structure.events), row, schedule)
        for each in given[first:]:
            state, row = closed.step(state, *each)
            tally = update_tally(tally, row, schedule)
            rows.append(row)
        return self._cast(Carried(state, tally)), rows if self._traced else []

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

        def sample(index: Any, carried: Carried) -> Carried:
            return body(carried, jax.tree.map(lambda samples: samples[index], (inputs, times)))[0]

        return jax.lax.fori_loop(0, count, sample, start), ()

    def _closed_loop(self, per_flight: PerFlight) -> ClosedLoop:
        loop = with_numbers(self.structure.loop, per_flight.numbers)
        return ClosedLoop(loop, self.structure.late_start)

    def _cast(self, tree: Any) -> Any:
        """Put every float in the precision of the structure: a state must keep its types."""
        return jax.tree.map(lambda leaf: cast_float(jnp.asarray(leaf), self.structure.dtype), tree)

    def _shapes(self) -> tuple[StepInputs, PerFlight, Times]:
        """Shapes and types of the arguments of a step of one flight."""
        structure = self.structure

        def shape(*axes: int, dtype: Any = structure.dtype) -> jax.ShapeDtypeStruct:
            return jax.ShapeDtypeStruct(axes, dtype)

        one, flag, vector = shape(), shape(dtype=np.bool_), shape(3)
        injections, numbers = structure.loop.injections, numbers_of(structure.loop)
        faults = tuple(FaultDraws(vector, vector) if is_random(each) else None for each in injections)
        loses = any(injection.channel == "imu" for injection in injections)
        varying = {
            path: shape(*numbers[path].shape, dtype=cast_float(numbers[path], structure.dtype).dtype)
            for path in structure.varying
        }
        per_flight = PerFlight(
            varying,
            Schedule(*[shape(structure.events, 3)] * 3),
            {path: varying[path] for path in structure.tuned} or None,
        )
        delivery = Delivery(flag, one, flag, one) if loses else None
        return StepInputs((vector,) * 4, faults, delivery), per_flight, Times(one, one, one)


def cast_float(array: Any, dtype: np.dtype[Any]) -> Any:
    """Return an array in another precision, if it is one of floats."""
    return array.astype(dtype) if jnp.issubdtype(array.dtype, jnp.floating) else array
