# pyright: basic
"""The batch engine: thousands of flights at once, compiled by JAX; of each it keeps a tally.

>>> engine = Engine()
>>> outcomes = engine.fly([parts_of(scenario)], [scenario.fault_events])

One engine keeps one core busy; for more, start a process for each (`quadftc_campaign` does). JAX reads its
settings on its first import: see `quadftc_model.jax_settings`.
"""

from __future__ import annotations

import functools
import traceback
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.compiled import CompiledFlight, PerFlight, SlopeFlight, take
from quadftc_campaign.batch.loop_step import may_start_late
from quadftc_campaign.batch.parts import (
    FlightParts,
    Loop,
    Progress,
    differing,
    numbers_of,
    structure_of,
    with_common_faults,
)
from quadftc_campaign.batch.tally import Outcome, schedule_of
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_model.compiled import UNTRACEABLE
from quadftc_model.jax_settings import keep_compiled_code, settle_precision

LANES = 128  # flights that fly together: their state stays in the cache

Floats = NDArray[np.float64]
Events = Sequence[Sequence[FaultEvent]]
Directions = Sequence[Mapping[str, Floats]]


class Engine:
    """Flies batches; it keeps what it has compiled."""

    def __init__(
        self,
        float32: bool = False,  # precision; one process has one
        lanes: int | None = None,  # flights that fly together; None: as the flights are, up to `LANES`
        free: Sequence[str] = (),  # numbers (`numbers_of`) that may change without another compilation
        staged: bool | None = None,  # whether to rewrite the step (`StagedStep`); None: on a CPU
    ) -> None:
        if lanes is not None and lanes < 1:
            raise ValueError(f"lanes = {lanes}: must be positive")
        settle_precision(float32)
        self._lanes, self._free = lanes, frozenset(free)
        self._dtype = np.dtype(np.float32 if float32 else np.float64)
        self._compiled: dict[Any, CompiledFlight] = {}
        self._staged = jax.default_backend() == "cpu" if staged is None else staged

    def fly(
        self,
        flights: Sequence[FlightParts],
        events: Events,
        progress: Progress = lambda samples: None,
        directions: Directions = (),
        traced: bool = False,
    ) -> list[Outcome]:
        """Fly all flights; ValueError if a part cannot be flown in a batch.

        Each is judged by the faults in ``events``. For slopes of the sums, ``directions`` say how some
        numbers of each flight change, by path (`numbers_of`). With ``traced``, every sample is kept, too.
        """
        flights = with_common_faults(flights)
        groups: dict[Any, list[int]] = {}
        for place, flight in enumerate(flights):
            groups.setdefault(structure_of(flight.loop), []).append(place)
        outcomes: dict[int, Outcome] = {}
        for places in groups.values():
            chosen, judged_by = [flights[i] for i in places], [events[i] for i in places]
            along = [directions[i] for i in places if directions]
            compiled, per_flight = self._prepare(chosen, judged_by, along, traced)
            lanes = self._lanes or lanes_for(len(places))
            for start in range(0, len(places), lanes):
                block = places[start : start + lanes]
                # the last flight fills the lanes that are left
                rows = np.minimum(np.arange(start, start + lanes), start + len(block) - 1)
                in_lanes, numbers = [chosen[row] for row in rows], take(per_flight, rows, axis=-1)
                flown = compiled.fly(in_lanes, numbers, len(block), progress)
                outcomes.update(zip(block, flown, strict=True))
        return [outcomes[place] for place in range(len(flights))]

    def _prepare(
        self, flights: Sequence[FlightParts], events: Events, directions: Directions, traced: bool
    ) -> tuple[CompiledFlight, PerFlight]:
        """Compile flights of one structure; what they do not share is returned, arrays (..., flights)."""
        tuned = tuple(directions[0]) if directions else ()
        numbers = [numbers_of(flight.loop) for flight in flights]
        # where kinds of faults differ, their axes do, if not in these flights: no other compilation for those
        differ = any(number == 0 for flight in flights for number in flight.fault_numbers)
        masks = {path for path in numbers[0] if differ and path.endswith(".mask")}
        varying = differing(numbers, self._free | set(tuned) | masks)
        plant = flights[0].loop.plant
        rotors = plant.command_size if plant.flies else 0
        per_flight = PerFlight(
            {path: np.moveaxis(values, 0, -1) for path, values in varying.items()},
            schedule_of(events, rotors),
            {path: np.stack([direction[path] for direction in directions], axis=-1) for path in tuned},
        )
        late_start = any(may_start_late(flight.loop) for flight in flights)
        fixed = tuple(value.tobytes() for path, value in numbers[0].items() if path not in varying)
        of_rotors = per_flight.schedule.rotors
        most = per_flight.schedule.start.shape[1], None if of_rotors is None else len(of_rotors.start)
        key = (structure_of(flights[0].loop), fixed, tuple(varying), most, late_start, tuned, traced)
        if key not in self._compiled:
            arguments = (flights[0], per_flight, late_start, self._dtype, traced, self._staged)
            try:
                self._compiled[key] = (SlopeFlight if tuned else CompiledFlight)(*arguments)
            except UNTRACEABLE as error:
                raise _name_culprit(error, flights[0].loop, varying) from error
        return self._compiled[key], per_flight


@functools.cache
def engine_of_process(float32: bool, lanes: int, free: tuple[str, ...] = ()) -> Engine:
    """Return the engine of this process for such flights; what it compiles is kept on disk, too."""
    keep_compiled_code()
    return Engine(float32, lanes, free)


def lanes_for(flights: int) -> int:
    """Return how many lanes suit a number of flights: a power of two, up to `LANES`."""
    return min(LANES, 1 << max(flights - 1, 0).bit_length())


def _name_culprit(error: Exception, loop: Loop, varying: Mapping[str, Any]) -> ValueError:
    """Return the error that names the part whose method raised ``error`` while it was traced."""
    # everything in the loop that has a step, by its path
    roles = ("plant", "sensor", "observer", "disturbance_observer", "controller")
    parts: dict[str, Any] = {role: getattr(loop, role) for role in roles}
    parts |= {f"injections.{i}.law": each.law for i, each in enumerate(loop.injections)}
    parts |= {f"references.{i}": each for i, each in enumerate(loop.references)}
    parts |= {f"trajectories.{i}": each for i, each in enumerate(loop.trajectories)}
    parts |= {f"plant.winds.{i}": each for i, each in enumerate(getattr(loop.plant, "winds", ()))}
    if loop.place is not None and loop.position_loop is not None:
        parts |= {"place.sensor": loop.place.sensor, "position_loop.estimator": loop.position_loop.estimator}
        parts["position_loop.controller"] = loop.position_loop.controller
    parts |= {f"plant.disturbances.{i}": each for i, each in enumerate(loop.plant.disturbances)}
    role, where = "", "a part"
    for frame, _ in traceback.walk_tb(error.__traceback__):
        kind = type(frame.f_locals.get("self"))
        for path, part in parts.items():
            if kind is type(part):
                role, where = path, f"{path} ({kind.__name__})"
    numbers = [path for path in varying if path.startswith(f"{role}.")]
    reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
    advice = "a law must not branch on data or ask for numbers; see CONTRIBUTING.md"
    if numbers:
        advice += f". It can if {', '.join(numbers)} are the same in all flights"
    return ValueError(f"{where} cannot be flown in a batch: {reason}; {advice}")
