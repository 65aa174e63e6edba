# pyright: basic
"""The batch engine of JAX: many flights at once on a GPU.

It flies the same laws as `quadftc_campaign.batch.engine`, traced as a whole. Numbers that all flights share
are constants of the compiled code, the others are arrays with a value per flight.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from collections.abc import Collection, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from quadftc_campaign.batch.engine import BatchFlight, Outcome, Progress, outcome_of
from quadftc_campaign.batch.judged_loop import JudgedLoop, JudgedState
from quadftc_compile.recipe import name_of
from quadftc_flight.loop import LoopInputs
from quadftc_model.arrays import AnyArray, Array, Scalar, chosen
from quadftc_model.composition import PlainCalls
from quadftc_model.numbers import numbers_of, structure_of, with_numbers
from quadftc_sim.injection import Injection

LANES = 2048  # flights that fly together at most
STRETCH = 500  # samples of one call of the compiled function; between calls sums are taken out
NEVER = math.inf  # s; start of a fault that only other flights of the batch have
SHARED = ("before", "now", "dt", "taken", "number", "taken_dt", "due")  # times, the same in all flights
BEGINNERS = "judge.", "loop.injections."  # begin at their first sample, whatever their state was before

_precisions: set[bool] = set()  # whether this process computes in single precision, once it is known

T = TypeVar("T")  # nested tuples of arrays
Numbers = dict[str, Array]  # by path, arrays (flights, ...)


class JaxEngine:
    """Flies batches; it keeps what it has compiled."""

    def __init__(
        self,
        float32: bool = False,  # precision; one process has one
        lanes: int | None = None,  # flights that fly together; None: as the flights are, up to `LANES`
    ) -> None:
        if lanes is not None and lanes < 1:
            raise ValueError(f"lanes = {lanes}: must be positive")
        settle_precision(float32)
        self._lanes = lanes
        self._dtype = np.dtype(np.float32 if float32 else np.float64)
        self._compiled: dict[Hashable, CompiledFlight] = {}

    def fly(self, flights: Sequence[BatchFlight], progress: Progress = lambda samples: None) -> list[Outcome]:
        """Fly all flights; ValueError if a law cannot be traced."""
        flights = with_common_faults(flights)
        groups: dict[Hashable, list[int]] = {}
        for place, flight in enumerate(flights):
            groups.setdefault(flight.structure, []).append(place)
        outcomes: dict[int, Outcome] = {}
        for key, places in groups.items():
            compiled, varying = self._prepare(key, [flights[place] for place in places])
            lanes = self._lanes or lanes_for(len(places))
            for start in range(0, len(places), lanes):
                block = places[start : start + lanes]
                # the last flight fills the lanes that are left
                rows = np.minimum(np.arange(start, start + lanes), start + len(block) - 1)
                in_lanes = [flights[places[row]] for row in rows]
                flown = compiled.fly(in_lanes, take(varying, rows), len(block), progress)
                outcomes.update(zip(block, flown, strict=True))
        return [outcomes[place] for place in range(len(flights))]

    def _prepare(self, structure: Hashable, flights: Sequence[BatchFlight]) -> tuple[CompiledFlight, Numbers]:
        """Return flights of one structure compiled, and the numbers of their laws that they do not share."""
        numbers = [numbers_of(flight.loop) for flight in flights]
        # the schedule differs, if not in these flights, and where kinds of faults differ, so do their axes
        differ = any(0 in flight.numbers for flight in flights if flight.numbers is not None)
        free = {
            path for path in numbers[0] if path.startswith("judge.") or (differ and path.endswith(".mask"))
        }
        varying = differing(numbers, free)
        fixed = tuple(value.tobytes() for path, value in numbers[0].items() if path not in varying)
        key = structure, fixed, tuple(varying)
        if key not in self._compiled:
            self._compiled[key] = CompiledFlight(flights[0].loop, self._dtype)
        return self._compiled[key], varying


@functools.cache
def engine_of_process(float32: bool, lanes: int | None = None) -> JaxEngine:
    """Return the engine of this process for such flights; what it compiles is kept on disk, too."""
    keep_compiled_code()
    return JaxEngine(float32, lanes)


def settle_precision(float32: bool) -> None:
    """Set the precision of this process, for good, as JAX keeps constants; ValueError if it has another."""
    if _precisions and float32 not in _precisions:
        there, wanted = ("float64", "float32") if float32 else ("float32", "float64")
        raise ValueError(f"precision {wanted}: this process computes in {there}; start another")
    _precisions.add(float32)
    jax.config.update("jax_enable_x64", not float32)


def keep_compiled_code() -> None:
    """Have JAX keep on disk what it compiles, for later processes."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for name, value in (
        ("jax_compilation_cache_dir", str(cache / "quadftc" / "jax")),
        ("jax_persistent_cache_min_compile_time_secs", 0.5),
    ):
        jax.config.update(name, value)


def lanes_for(flights: int) -> int:
    """Return how many lanes suit a number of flights: a power of two, up to `LANES`."""
    return min(LANES, 1 << max(flights - 1, 0).bit_length())


class TracedCalls(PlainCalls):
    """Calls the laws while they are traced; ValueError names the one that cannot be."""

    def step(self, name: str, state: object, inputs: object, dt: Scalar) -> tuple[object, Any]:
        """Step a law by ``dt`` [s]; where that is 0, the law begins.

        Both states are computed and one is chosen: a GPU would copy them to branch.
        """
        law = self._laws[name]
        try:
            before = chosen(dt == 0.0, law.init(inputs), state)
            return law.step(before, inputs, dt)
        except (TypeError, jax.errors.UnexpectedTracerError) as error:
            reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
            what = f"{name} ({name_of(law)})"
            advice = "a law must not branch on data or ask for numbers; see CONTRIBUTING.md"
            raise ValueError(f"{what} cannot be traced by JAX: {reason}; {advice}") from error


class CompiledFlight:
    """Functions that fly all flights of one structure."""

    def __init__(self, loop: JudgedLoop, dtype: np.dtype[np.floating]) -> None:
        self._loop, self._dtype = loop, dtype
        axes: Any = LoopInputs._make(None if name in SHARED else 0 for name in LoopInputs._fields)
        self._step_all = jax.vmap(self._step, in_axes=(0, axes, 0, None))
        self.fly_stretch = jax.jit(self._fly_stretch, donate_argnums=0)

    def fly(
        self, flights: Sequence[BatchFlight], numbers: Numbers, count: int, progress: Progress
    ) -> list[Outcome]:
        """Fly a block of flights, one in each lane; outcomes are wanted of the first ``count``."""
        draws, total = [flight.draws for flight in flights], flights[0].samples
        counts = [min(STRETCH, total - start) for start in range(0, total, STRETCH)]
        stretches = (self._join([each.next(samples) for each in draws]) for samples in counts)
        state, sums, inputs = self._begin(flights, numbers), None, next(stretches)
        numbers = self._cast(numbers)
        for samples in counts:
            state = self.fly_stretch(state, inputs, numbers, samples)
            inputs = next(stretches, inputs)  # drawn while the device computes
            part = to_float64(state.judge.tally.sums)
            sums = part if sums is None else jax.tree.map(np.add, sums, part)
            progress(samples * count)
        tally = to_float64(state.judge.tally)._replace(sums=sums)
        return [outcome_of(flight, take(tally, lane)) for lane, flight in enumerate(flights[:count])]

    def _join(self, drawn: Sequence[LoopInputs]) -> LoopInputs:
        """Join the inputs of some samples of all flights: (samples, ...), or (flights, samples, ...).

        All stretches are as long, so that nothing is compiled for the last one alone.
        """
        first, joined = drawn[0], dict[str, object]()
        rows = np.minimum(np.arange(STRETCH), np.size(first.now) - 1)

        def fill(array: Array) -> Array:
            return array if len(array) == STRETCH else array[rows]

        def stack(*arrays: Array) -> Array:
            kind = self._dtype if arrays[0].dtype.kind == "f" else None
            return np.stack(arrays, dtype=kind, casting="same_kind")

        for name in LoopInputs._fields:
            each = [getattr(one, name) for one in drawn]
            if name in SHARED:
                joined[name] = jax.tree.map(lambda array: _cast_float(fill(array), self._dtype), each[0])
            elif name == "first_draws":  # the same at all samples
                joined[name] = jax.tree.map(stack, *each)
            else:
                joined[name] = jax.tree.map(lambda *arrays: stack(*map(fill, arrays)), *each)
        return first._replace(**joined)

    def _begin(self, flights: Sequence[BatchFlight], numbers: Numbers) -> JudgedState:
        """Return what flights begin with, computed once for those that differ in `BEGINNERS` alone."""
        paths = [path for path in numbers if not path.startswith(BEGINNERS)]
        keys = [tuple(numbers[path][lane].tobytes() for path in paths) for lane in range(len(flights))]
        with np.errstate(all="ignore"):
            different = {key: flight.loop for key, flight in zip(keys, flights, strict=True)}
            states = {key: loop.init(PlainCalls(loop.laws)) for key, loop in different.items()}
        return self._cast(jax.tree.map(lambda *leaves: np.stack(leaves), *map(states.get, keys)))

    def _step(self, state: JudgedState, stretch: LoopInputs, numbers: Numbers, index: Scalar) -> JudgedState:
        """Take a sample of one flight, at an index of a stretch."""
        loop = with_numbers(self._loop, numbers)
        samples = stretch._replace(first_draws=None)
        inputs = take(samples, index)._replace(first_draws=stretch.first_draws)
        after, _ = loop.step(TracedCalls(loop.laws), state, inputs)
        return self._cast(after)

    def _fly_stretch(
        self, state: JudgedState, inputs: LoopInputs, numbers: Numbers, count: int
    ) -> JudgedState:
        """Fly all flights over the first ``count`` samples of the inputs, with sums that begin at zero."""
        tally = state.judge.tally
        tally = tally._replace(sums=jax.tree.map(jnp.zeros_like, tally.sums))
        start = state._replace(judge=state.judge._replace(tally=tally))

        def body(index: Scalar, state: JudgedState) -> JudgedState:
            return self._step_all(state, inputs, numbers, index)

        return jax.lax.fori_loop(0, count, body, start)

    def _cast(self, tree: T) -> T:
        """Put every float in the precision of the flights: a state must keep its types."""
        return jax.tree.map(lambda leaf: _cast_float(jnp.asarray(leaf), self._dtype), tree)


def with_common_faults(flights: Sequence[BatchFlight]) -> list[BatchFlight]:
    """Give all flights the same kinds of faults in the same order; one that a flight lacks never acts.

    So flights that differ only in the kinds of their faults are compiled and flown together, and others with
    these kinds need no other compilation. Their schedules get one shape, too.
    """
    # by place among the faults and structure: the fault of each flight, with its number
    slots: list[dict[tuple[int, Hashable], tuple[Injection, int]]] = []
    for flight in flights:
        injections = flight.loop.loop.injections
        numbers = flight.numbers or tuple(range(1, len(injections) + 1))
        pairs = enumerate(zip(injections, numbers, strict=True))
        slots.append({(place, structure_of(fault)): (fault, number) for place, (fault, number) in pairs})
    there = {slot: fault for faults in slots for slot, (fault, _) in faults.items()}
    order = sorted(there, key=lambda slot: (slot[0], repr(slot[1])))
    absent = {slot: (dataclasses.replace(there[slot], start=NEVER, stop=NEVER), 0) for slot in order}
    filled: list[BatchFlight] = []
    for flight, faults in zip(flights, slots, strict=True):
        pairs = [faults.get(slot, never) for slot, never in absent.items()]
        loop = dataclasses.replace(flight.loop.loop, injections=tuple(fault for fault, _ in pairs))
        judged = dataclasses.replace(flight.loop, loop=loop)
        filled.append(flight._replace(loop=judged, numbers=tuple(number for _, number in pairs)))
    return filled


def differing(flights: Sequence[Mapping[str, AnyArray]], free: Collection[str] = ()) -> dict[str, AnyArray]:
    """Stack the numbers that differ between flights, and those that are ``free``: (flights, ...)."""
    first = flights[0]
    return {
        path: np.stack([flight[path] for flight in flights])
        for path, value in first.items()
        if path in free or any(flight[path].tobytes() != value.tobytes() for flight in flights[1:])
    }


def take(arrays: T, index: object) -> T:
    """Return what is at an index of the first axis in each array of a tree."""
    return jax.tree.map(lambda array: array[index], arrays)


def to_float64(arrays: T) -> T:
    """Return a tree of arrays as NumPy arrays, floats in double precision."""
    return jax.tree.map(lambda array: _cast_float(np.asarray(array), np.dtype(np.float64)), arrays)


def _cast_float(array: Array, dtype: np.dtype[np.floating]) -> Array:
    return array.astype(dtype) if jnp.issubdtype(array.dtype, jnp.floating) else array
