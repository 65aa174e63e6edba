# pyright: basic
"""The batch engine: thousands of flights at once, compiled by JAX, what is kept of each a tally.

>>> engine = Engine()
>>> outcomes = engine.fly([parts_of(scenario)], [scenario.fault_events])

One engine keeps one core busy; for more, start a process for each (`quadftc_campaign` does). JAX reads
its settings when it is imported first: see `quadftc_campaign.batch.environment`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.compiled import CompiledFlight, Own, Structure
from quadftc_campaign.batch.flown import Outcome, doubled, flown, lane_of
from quadftc_campaign.batch.loop import Row
from quadftc_campaign.batch.parts import FlightParts, differing, numbers_of, structure_of, with_common_faults
from quadftc_campaign.batch.refusal import UNTRACEABLE, refusal
from quadftc_campaign.batch.session import settle_precision
from quadftc_campaign.batch.slopes import SlopeFlight, slope_of_sums
from quadftc_campaign.batch.tally import Schedule, Sums, most_events, schedule_of
from quadftc_campaign.batch.trace import flight_of
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import Flight
from quadftc_sim.assembly import EPOCH_NS

LANES = 128  # flights that are flown together: their state stays in the cache

Floats = NDArray[np.float64]


def lanes_for(flights: int) -> int:
    """Return how many lanes suit a number of flights: a power of two, up to `LANES`."""
    return min(LANES, 1 << max(flights - 1, 0).bit_length())


class Sloped(NamedTuple):
    """What is left of one flight, and how its sums change along a direction of its numbers."""

    outcome: Outcome
    slope: Sums


class Traced(NamedTuple):
    """One flight with every sample."""

    outcome: Outcome
    flight: Flight


def _no_progress(samples: int) -> None:
    """Say nothing."""


class Engine:
    """Flies batches; what it has compiled, it keeps.

    Parameters
    ----------
    float32 : bool
        Single precision in place of double; the same for all engines of a process.
    lanes : int, optional
        Flights that are flown together; compiled for so many, a batch of fewer is filled up. Default: as the
        flights are, up to `LANES`.
    free : sequence of str
        Paths of numbers (`numbers_of`) for which nothing is compiled anew when they change from one call to
        the next; those that differ between the flights of a call need not be named.
    """

    def __init__(self, float32: bool = False, lanes: int | None = None, free: Sequence[str] = ()) -> None:
        if lanes is not None and lanes < 1:
            raise ValueError(f"lanes = {lanes}: must be positive")
        settle_precision(float32)
        self._float32 = float32
        self._lanes = lanes
        self._free = frozenset(free)
        self._compiled: dict[Any, CompiledFlight] = {}
        self._on_cpu = jax.default_backend() == "cpu"

    @property
    def device(self) -> str:
        """The device that computes, in words."""
        found = jax.devices()[0]
        return f"{found.platform} ({found.device_kind})"

    def fly(
        self,
        flights: Sequence[FlightParts],
        events: Sequence[Sequence[FaultEvent]],
        progress: Callable[[int], None] = _no_progress,
    ) -> list[Outcome]:
        """Fly all flights.

        Parameters
        ----------
        flights : sequence of FlightParts
        events : sequence of sequences of FaultEvent
            The faults that each is judged by.
        progress : callable
            Called with the number of samples flown since the last call.

        Returns
        -------
        list of Outcome

        Raises
        ------
        ValueError
            If a part cannot be flown in a batch.
        """
        outcomes: list[Outcome | None] = [None] * len(flights)
        for compiled, places, chosen, own in self._tasks(with_common_faults(flights), events):
            found, _ = flown(compiled, chosen, own, len(places), progress)
            for place, outcome in zip(places, found, strict=True):
                outcomes[place] = outcome
        return [outcome for outcome in outcomes if outcome is not None]

    def trace(
        self,
        flights: Sequence[FlightParts],
        events: Sequence[Sequence[FaultEvent]],
        epoch_ns: int = EPOCH_NS,
    ) -> list[Traced]:
        """Fly flights and keep every sample, as `quadftc_flight.closed_loop.fly` does; else as `fly`.

        Parameters
        ----------
        flights, events : sequences
        epoch_ns : int
            Stamp of the first sample [ns].
        """
        found: dict[int, Traced] = {}
        for compiled, places, chosen, own in self._tasks(with_common_faults(flights), events, traced=True):
            pieces: list[Row] = []
            outcomes, _ = flown(compiled, chosen, own, len(places), _no_progress, pieces.append)
            row: Row = jax.tree.map(lambda *parts: np.concatenate(parts), *pieces)
            for lane, (place, outcome) in enumerate(zip(places, outcomes, strict=True)):
                one: Row = jax.tree.map(lambda leaf: leaf[..., lane], row)  # noqa: B023
                found[place] = Traced(outcome, flight_of(one, chosen[lane].loop.period_ns, epoch_ns))
        return [found[place] for place in range(len(flights))]

    def slopes(
        self,
        flights: Sequence[FlightParts],
        events: Sequence[Sequence[FaultEvent]],
        directions: Sequence[Mapping[str, Floats]],
        progress: Callable[[int], None] = _no_progress,
    ) -> list[Sloped]:
        """Fly flights, each with the slope of its sums along a direction; else as `fly`.

        Parameters
        ----------
        flights, events : sequences
        directions : sequence of mappings
            For each flight, how some of its numbers change, by path (`numbers_of`); of all flights the same
            paths.
        progress : callable
        """
        found: dict[int, Sloped] = {}
        tasks = self._tasks(with_common_faults(flights), events, directions=directions)
        for compiled, places, chosen, own in tasks:
            outcomes, state = flown(compiled, chosen, own, len(places), progress)
            slope = doubled(slope_of_sums(state))
            for lane, (place, outcome) in enumerate(zip(places, outcomes, strict=True)):
                found[place] = Sloped(outcome, lane_of(slope, lane))
        return [found[place] for place in range(len(flights))]

    def _tasks(
        self,
        flights: Sequence[FlightParts],
        events: Sequence[Sequence[FaultEvent]],
        traced: bool = False,
        directions: Sequence[Mapping[str, Floats]] | None = None,
    ) -> Iterator[tuple[CompiledFlight, list[int], list[FlightParts], Own]]:
        """Blocks of flights of one structure."""
        groups: dict[Any, list[int]] = {}
        for index, flight in enumerate(flights):
            groups.setdefault(structure_of(flight.loop), []).append(index)
        for key, members in groups.items():
            numbers = [numbers_of(flights[index].loop) for index in members]
            tuned = tuple(directions[0]) if directions else ()
            varying = differing(numbers, self._free | set(tuned))
            chosen = [flights[index] for index in members]
            most = max(map(most_events, (events[index] for index in members)))
            compiled = self._compile(key, chosen, tuple(varying), most, numbers[0], traced, tuned)
            schedules = [schedule_of(events[index], most) for index in members]
            lanes = self._lanes or lanes_for(len(members))
            for start in range(0, len(members), lanes):
                block = list(range(start, min(start + lanes, len(members))))
                full = block + [block[-1]] * (lanes - len(block))
                along = [directions[members[i]] for i in full] if directions else []
                own = Own(
                    {path: np.moveaxis(values[full], 0, -1) for path, values in varying.items()},
                    Schedule(*(np.stack([schedules[i][kind] for i in full], axis=-1) for kind in range(3))),
                    {path: np.stack([one[path] for one in along], axis=-1) for path in tuned} or None,
                )
                yield compiled, [members[i] for i in block], [chosen[i] for i in full], own

    def _compile(
        self,
        key: Any,
        flights: Sequence[FlightParts],
        varying: tuple[str, ...],
        events: int,
        numbers: dict[str, Any],
        traced: bool,
        tuned: tuple[str, ...],
    ) -> CompiledFlight:
        loop = flights[0].loop
        structure = Structure(
            loop=loop,
            varying=varying,
            events=events,
            late_start=any(map(_may_start_late, flights)),
            loses=any(injection.channel == "imu" for injection in loop.injections),
            float32=self._float32,
            tuned=tuned,
        )
        fixed = tuple(value.tobytes() for path, value in numbers.items() if path not in varying)
        whole_key = (key, varying, events, structure.late_start, fixed, traced, tuned)
        if whole_key not in self._compiled:
            try:
                kind = SlopeFlight if tuned else CompiledFlight
                self._compiled[whole_key] = kind(structure, traced, self._on_cpu)
            except UNTRACEABLE as error:
                raise refusal(error, loop, varying) from error
        return self._compiled[whole_key]


def _may_start_late(flight: FlightParts) -> bool:
    """Whether a fault acts on the first sample that may leave nothing to begin with."""
    return any(
        injection.start <= 0.0 and injection.channel in ("attitude", "gyro", "imu")
        for injection in flight.loop.injections
    )
