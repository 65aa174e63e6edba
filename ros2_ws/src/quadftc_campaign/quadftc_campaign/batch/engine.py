# pyright: basic
"""The batch engine: thousands of flights at once, compiled by JAX; of each it keeps a tally.

>>> engine = Engine()
>>> outcomes = engine.fly([parts_of(scenario)], [scenario.fault_events])

One engine keeps one core busy; for more, start a process for each (`quadftc_campaign` does). JAX reads its
settings on its first import: see `quadftc_campaign.batch.jax_settings`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.block import fly_block, lane_of, to_float64
from quadftc_campaign.batch.compiled import CompiledFlight, PerFlight, Structure
from quadftc_campaign.batch.jax_settings import settle_precision
from quadftc_campaign.batch.loop_step import Row
from quadftc_campaign.batch.parts import (
    FlightParts,
    Loop,
    differing,
    numbers_of,
    structure_of,
    with_common_faults,
)
from quadftc_campaign.batch.slopes import SlopeFlight, slope_of_sums
from quadftc_campaign.batch.tally import Outcome, Schedule, Sums, most_events, schedule_of
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import NO_STATE, Flight, onset_ns
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_sim.assembly import EPOCH_NS

LANES = 128  # flights that fly together: their state stays in the cache
UNTRACEABLE = (TypeError, AttributeError, NotImplementedError, ValueError)

Floats = NDArray[np.float64]
Events = Sequence[Sequence[FaultEvent]]


def lanes_for(flights: int) -> int:
    """Return how many lanes suit a number of flights: a power of two, up to `LANES`."""
    return min(LANES, 1 << max(flights - 1, 0).bit_length())


class Sloped(NamedTuple):
    """One flight, and how its sums change along a direction of its numbers."""

    outcome: Outcome
    slope: Sums


class Traced(NamedTuple):
    """One flight with every sample."""

    outcome: Outcome
    flight: Flight


class _Block(NamedTuple):
    """Flights of one structure that fly together; the last one fills the lanes that are left."""

    compiled: CompiledFlight
    places: list[int]  # of the flights among all
    flights: list[FlightParts]  # one for each lane
    per_flight: PerFlight


class Engine:
    """Flies batches; it keeps what it has compiled.

    Parameters
    ----------
    float32 : bool
        Single precision in place of double; the same for all engines of a process.
    lanes : int, optional
        Flights that fly together; a batch of fewer is filled up. Default: as the flights are, up to `LANES`.
    free : sequence of str
        Paths of numbers (`numbers_of`) that may change from one call to the next without another compilation;
        those that differ between the flights of a call need not be named.
    staged : bool, optional
        Whether to rewrite the step (`quadftc_campaign.batch.staged_step`). Default: on a CPU.
    """

    def __init__(
        self,
        float32: bool = False,
        lanes: int | None = None,
        free: Sequence[str] = (),
        staged: bool | None = None,
    ) -> None:
        if lanes is not None and lanes < 1:
            raise ValueError(f"lanes = {lanes}: must be positive")
        settle_precision(float32)
        self._float32 = float32
        self._lanes = lanes
        self._free = frozenset(free)
        self._compiled: dict[Any, CompiledFlight] = {}
        self._staged = jax.default_backend() == "cpu" if staged is None else staged

    @property
    def device(self) -> str:
        """The device that computes, in words."""
        device = jax.devices()[0]
        return f"{device.platform} ({device.device_kind})"

    def fly(
        self, flights: Sequence[FlightParts], events: Events, progress: Callable[[int], None] = lambda _: None
    ) -> list[Outcome]:
        """Fly all flights.

        Parameters
        ----------
        flights : sequence of FlightParts
        events : sequence of sequences of FaultEvent
            The faults that each is judged by.
        progress : callable
            Called with the number of samples flown since the last call.

        Raises
        ------
        ValueError
            If a part cannot be flown in a batch.
        """
        outcomes: dict[int, Outcome] = {}
        for block in self._blocks(flights, events):
            flown, _ = fly_block(block.compiled, block.flights, block.per_flight, len(block.places), progress)
            outcomes.update(zip(block.places, flown, strict=True))
        return [outcomes[place] for place in range(len(flights))]

    def trace(self, flights: Sequence[FlightParts], events: Events, epoch_ns: int = EPOCH_NS) -> list[Traced]:
        """Fly flights and keep every sample, as `quadftc_flight.closed_loop.fly` does; else as `fly`.

        Parameters
        ----------
        flights, events : sequences
        epoch_ns : int
            Stamp of the first sample [ns].
        """
        traced: dict[int, Traced] = {}
        for compiled, places, chosen, per_flight in self._blocks(flights, events, traced=True):
            pieces: list[Row] = []
            outcomes, _ = fly_block(compiled, chosen, per_flight, len(places), keep=pieces.append)
            rows: Row = jax.tree.map(lambda *parts: np.concatenate(parts), *pieces)
            for lane, (place, outcome) in enumerate(zip(places, outcomes, strict=True)):
                of_lane: Row = jax.tree.map(lambda leaf: leaf[..., lane], rows)  # noqa: B023
                traced[place] = Traced(outcome, _flight_of(of_lane, chosen[lane].loop.period_ns, epoch_ns))
        return [traced[place] for place in range(len(flights))]

    def slopes(
        self,
        flights: Sequence[FlightParts],
        events: Events,
        directions: Sequence[Mapping[str, Floats]],
        progress: Callable[[int], None] = lambda _: None,
    ) -> list[Sloped]:
        """Fly flights, each with the slope of its sums along a direction; else as `fly`.

        Parameters
        ----------
        flights, events : sequences
        directions : sequence of mappings
            For each flight, how some of its numbers change, by path (`numbers_of`); all have the same paths.
        progress : callable
        """
        sloped: dict[int, Sloped] = {}
        for compiled, places, chosen, per_flight in self._blocks(flights, events, directions=directions):
            outcomes, state = fly_block(compiled, chosen, per_flight, len(places), progress)
            slope = to_float64(slope_of_sums(state))
            for lane, (place, outcome) in enumerate(zip(places, outcomes, strict=True)):
                sloped[place] = Sloped(outcome, lane_of(slope, lane))
        return [sloped[place] for place in range(len(flights))]

    def _blocks(
        self,
        flights: Sequence[FlightParts],
        events: Events,
        traced: bool = False,
        directions: Sequence[Mapping[str, Floats]] = (),
    ) -> Iterator[_Block]:
        """Divide flights into blocks of one structure."""
        flights = with_common_faults(flights)
        groups: dict[Any, list[int]] = {}
        for index, flight in enumerate(flights):
            groups.setdefault(structure_of(flight.loop), []).append(index)
        tuned = tuple(directions[0]) if directions else ()
        for key, members in groups.items():
            chosen = [flights[index] for index in members]
            numbers = [numbers_of(flight.loop) for flight in chosen]
            varying = differing(numbers, self._free | set(tuned))
            most = max(most_events(events[index]) for index in members)
            structure = Structure(
                loop=chosen[0].loop,
                varying=tuple(varying),
                events=most,
                late_start=any(map(_may_start_late, chosen)),
                float32=self._float32,
                tuned=tuned,
            )
            compiled = self._compile(key, structure, numbers[0], traced)
            schedules = [schedule_of(events[index], most) for index in members]
            lanes = self._lanes or lanes_for(len(members))
            for start in range(0, len(members), lanes):
                block = list(range(start, min(start + lanes, len(members))))
                full = block + [block[-1]] * (lanes - len(block))
                along = [directions[members[i]] for i in full] if directions else []
                per_flight = PerFlight(
                    {path: np.moveaxis(values[full], 0, -1) for path, values in varying.items()},
                    Schedule(*(np.stack([schedules[i][kind] for i in full], axis=-1) for kind in range(3))),
                    {path: np.stack([one[path] for one in along], axis=-1) for path in tuned} or None,
                )
                yield _Block(compiled, [members[i] for i in block], [chosen[i] for i in full], per_flight)

    def _compile(
        self, key: Any, structure: Structure, numbers: Mapping[str, Any], traced: bool
    ) -> CompiledFlight:
        """Return the compiled flight of a structure, with the numbers that do not vary as constants."""
        fixed = tuple(value.tobytes() for path, value in numbers.items() if path not in structure.varying)
        rest = (structure.varying, structure.events, structure.late_start, structure.tuned)
        whole_key = (key, fixed, rest, traced)
        if whole_key not in self._compiled:
            try:
                kind = SlopeFlight if structure.tuned else CompiledFlight
                self._compiled[whole_key] = kind(structure, traced, self._staged)
            except UNTRACEABLE as error:
                raise _name_culprit(error, structure) from error
        return self._compiled[whole_key]


def _may_start_late(flight: FlightParts) -> bool:
    """Whether a fault acts on the first sample that may leave nothing to begin with."""
    return any(
        injection.start <= 0.0 and injection.channel in ("attitude", "gyro", "imu")
        for injection in flight.loop.injections
    )


def _name_culprit(error: Exception, structure: Structure) -> ValueError:
    """Return the error that names the part whose method raised ``error`` while it was traced."""
    role, part = "a part", None
    step = error.__traceback__
    while step is not None:
        caller = step.tb_frame.f_locals.get("self")
        for path, each in _parts(structure.loop):
            if caller is not None and type(caller) is type(each):
                role, part = path, each
        step = step.tb_next
    where = role if part is None else f"{role} ({type(part).__name__})"
    varying = [path for path in structure.varying if path.startswith(f"{role}.")]
    reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
    advice = "a law must not branch on data or ask for numbers; see CONTRIBUTING.md"
    if varying:
        advice += f". It can if {', '.join(varying)} are the same in all flights"
    return ValueError(f"{where} cannot be flown in a batch: {reason}; {advice}")


def _parts(loop: Loop) -> Iterator[tuple[str, Any]]:
    """Everything in the loop that has a step, by its path."""
    for role in ("plant", "sensor", "observer", "disturbance_observer", "controller"):
        yield role, getattr(loop, role)
    yield from ((f"injections.{i}.law", each.law) for i, each in enumerate(loop.injections))
    yield from ((f"references.{i}", each) for i, each in enumerate(loop.references))
    yield from ((f"plant.disturbances.{i}", each) for i, each in enumerate(loop.plant.disturbances))


def _flight_of(row: Row, period_ns: int, epoch_ns: int) -> Flight:
    """Make a flight of the rows (samples, ...) of one lane."""
    there = np.asarray(row.delivered, np.bool_)
    stamp_ns = epoch_ns + period_ns * np.arange(len(there))
    estimate, output, column = row.estimate, row.output, there[:, None]
    onsets = onset_ns(stamp_ns[:, None], np.asarray(estimate.onset_age, np.float64))
    motion = {name: getattr(row, name) for name in ("angles", "body_rate", "disturbance")}
    known = {name: getattr(row, name) for name in ("reference", "fault", "disturbance_estimate")}
    known |= {name: getattr(output, name) for name in ("torque", "error", "sliding_variable")}
    known |= {"fault_estimate": estimate.fault, "fault_std_dev": estimate.std_dev}
    return Flight(
        stamp_ns=stamp_ns,
        time=(stamp_ns - epoch_ns) / NANOSECONDS_PER_SECOND,
        delivered=there,
        fault_state=np.where(column, estimate.state, NO_STATE).astype(np.uint8),
        fault_onset_ns=np.where(column, onsets, 0),
        saturated=column & output.saturated,
        **{name: np.asarray(values, np.float64) for name, values in motion.items()},
        **{name: np.where(column, np.asarray(values, np.float64), np.nan) for name, values in known.items()},
    )
