# pyright: basic
"""A flight of one structure, compiled: the beginning, and stretches of samples, for many flights at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadftc_campaign.batch.flights_last import AllFlights
from quadftc_campaign.batch.loop import ClosedLoop, Delivery, Given, LoopState, Row
from quadftc_campaign.batch.parts import Loop, in_precision, numbers_of, with_numbers
from quadftc_campaign.batch.tally import Schedule, Tally, no_tally, tallied
from quadftc_sim.injection_step import FaultDraws

QUICK_TO_COMPILE = {"xla_backend_optimization_level": 0}  # the beginning runs once
MAX_SETTLING = 3  # steps in which the parts of a state may still change
DRAWN = ("attitude", "gyro", "accelerometer", "gyro bias")


class Times(NamedTuple):
    """Scenario times of a sample, the same in all flights."""

    before: Any  # of the sample before [s]
    now: Any  # [s]
    taken: Any  # of the sample that comes out of the IMU now [s]


class Brought(NamedTuple):
    """What is brought to a step for each flight."""

    draws: tuple[Any, ...]  # four of (3,): see `Given`
    faults: tuple[FaultDraws | None, ...]
    delivery: Delivery | None


class Own(NamedTuple):
    """What a flight has of its own, from its beginning to its end."""

    numbers: dict[str, Any]  # of its parts, by path
    schedule: Schedule
    direction: dict[str, Any] | None = (
        None  # in which some of them change, for `quadftc_campaign.batch.slopes`
    )


class Carried(NamedTuple):
    """What goes from step to step."""

    loop: LoopState
    tally: Tally


@dataclasses.dataclass(frozen=True, eq=False)
class Structure:
    """What a compiled flight is compiled for.

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
    loses : bool
        Whether samples may be withheld.
    float32 : bool
        Single precision in place of double.
    tuned : tuple of str
        Paths of the numbers whose change a flight is derived by; all of them vary.
    """

    loop: Loop
    varying: tuple[str, ...]
    events: int
    late_start: bool
    loses: bool
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
    lanes_last : bool
        Whether to use the form for CPUs of `quadftc_campaign.batch.flights_last`, or ``jax.vmap``.

    Raises
    ------
    ValueError
        If a part cannot be compiled.
    """

    def __init__(self, structure: Structure, traced: bool = False, lanes_last: bool = True) -> None:
        self.structure = dataclasses.replace(structure, loop=in_precision(structure.loop, structure.dtype))
        self._traced = traced
        brought, own, times = self._shapes()
        delay = structure.loop.sensor.delay
        # some states take on their final parts only after a few samples, such as those that remember some
        for settling in range(MAX_SETTLING + 1):
            self.first_samples = delay + 1 + settling  # that the beginning takes
            many = [brought] * self.first_samples, [times] * self.first_samples
            bias = jax.ShapeDtypeStruct((3,), structure.dtype)
            state = jax.eval_shape(self._begin, bias, many[0], own, many[1])[0]
            after = jax.eval_shape(self._step, state, (brought, own), times)[0]
            if jax.tree.structure(state) == jax.tree.structure(after):
                break
        else:
            raise ValueError(f"after {MAX_SETTLING} steps a state still gets more parts")
        if lanes_last:
            program = AllFlights(self._step, state, (brought, own), times, shown=self._shown)
            self.needed: Brought = program.needed[0]
            self._all = program
        else:
            self.needed = jax.tree.map(lambda _: True, brought)
            self._all = jax.vmap(self._step, in_axes=(-1, -1, None), out_axes=-1)
        begin = jax.vmap(self._begin, in_axes=(-1, -1, -1, None), out_axes=-1)
        self.begin = jax.jit(begin, compiler_options=QUICK_TO_COMPILE)
        self.fly = jax.jit(self._stretch, donate_argnums=0)

    def _shown(self, carried: Any) -> Any:
        """What is looked at in the end."""
        return carried.tally

    def _begin(
        self, bias: Any, brought: Sequence[Brought], own: Own, times: Sequence[Times]
    ) -> tuple[Carried, list[Row]]:
        """Take the first samples of one flight."""
        closed = self._closed(own)
        given = [_given(*each) for each in zip(brought, times, strict=True)]
        first = self.structure.loop.sensor.delay + 1
        state, row = closed.begin(bias, given[:first])
        rows = [row]
        tally = tallied(no_tally(bias, self.structure.events), row, own.schedule)
        for each in given[first:]:
            state, row = closed.step(state, each)
            tally = tallied(tally, row, own.schedule)
            rows.append(row)
        return self._cast(Carried(state, tally)), rows if self._traced else []

    def _step(self, state: Carried, inputs: tuple[Brought, Own], times: Times) -> tuple[Carried, Any]:
        """Take a sample of one flight."""
        brought, own = inputs
        loop, row = self._closed(own).step(state.loop, _given(brought, times))
        new = Carried(loop, tallied(state.tally, row, own.schedule))
        return self._cast(new), row if self._traced else ()

    def _stretch(
        self, state: Carried, brought: Brought, own: Own, times: Times, count: int
    ) -> tuple[Carried, Any]:
        """Fly all flights over ``count`` samples, of which more may be brought, from sums of nothing."""
        sums = jax.tree.map(jnp.zeros_like, state.tally.sums)
        start = state._replace(tally=state.tally._replace(sums=sums))

        def body(carried: Carried, each: tuple[Brought, Times]) -> tuple[Carried, Any]:
            return self._all(carried, (each[0], own), each[1])

        if self._traced:
            return jax.lax.scan(body, start, (brought, times))

        def sample(index: Any, carried: Carried) -> Carried:
            each = jax.tree.map(lambda all_of_it: all_of_it[index], (brought, times))
            return body(carried, each)[0]

        return jax.lax.fori_loop(0, count, sample, start), ()

    def _closed(self, own: Own) -> ClosedLoop:
        return ClosedLoop(with_numbers(self.structure.loop, own.numbers), self.structure.late_start)

    def _cast(self, tree: Any) -> Any:
        """Every float in the precision of the structure: a state must keep its types."""
        dtype = self.structure.dtype

        def cast(leaf: Any) -> Any:
            array = jnp.asarray(leaf)
            return array.astype(dtype) if jnp.issubdtype(array.dtype, jnp.floating) else array

        return jax.tree.map(cast, tree)

    def _shapes(self) -> tuple[Brought, Own, Times]:
        """Shapes and types of what one flight is given."""
        structure = self.structure

        def shape(*axes: int, dtype: Any = structure.dtype) -> jax.ShapeDtypeStruct:
            return jax.ShapeDtypeStruct(axes, dtype)

        one, flag, vector = shape(), shape(dtype=np.bool_), shape(3)
        faults = tuple(
            FaultDraws(vector, vector) if injection.law.is_random and injection.channel != "imu" else None
            for injection in structure.loop.injections
        )
        delivery = Delivery(flag, one, flag, one) if structure.loses else None
        numbers = numbers_of(structure.loop)
        varying = {
            path: shape(*numbers[path].shape, dtype=_kind(numbers[path], structure.dtype))
            for path in structure.varying
        }
        schedule = Schedule(*[shape(structure.events, 3)] * 3)
        direction = {path: varying[path] for path in structure.tuned} or None
        own = Own(varying, schedule, direction)
        return Brought((vector,) * len(DRAWN), faults, delivery), own, Times(one, one, one)


def _given(brought: Brought, times: Times) -> Given:
    return Given(*times, brought.draws, brought.faults, brought.delivery)


def _kind(array: Any, floats: np.dtype[Any]) -> np.dtype[Any]:
    """Type in which an array is computed with: floats in the precision wanted."""
    return floats if array.dtype.kind == "f" else array.dtype
