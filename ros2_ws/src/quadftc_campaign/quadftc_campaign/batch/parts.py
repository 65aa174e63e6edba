"""The parts of one flight, and which of their numbers differ between the flights of a batch.

A part is a frozen dataclass. Its texts, whole numbers and switches are its *structure*, over which a step is
compiled; its floats and arrays are *numbers*, each known by its path (``plant.vehicle.inertia``). Flights of
one structure are flown together: numbers that all of them share stay what they are, the others become arrays
with one value a flight.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_control.controller import Controller
from quadftc_control.reference import Reference
from quadftc_fdi.disturbance_observer import DisturbanceObserver
from quadftc_fdi.fault_observer import FaultObserver
from quadftc_sim.injection import Injection
from quadftc_sim.plant import Plant
from quadftc_sim.sensors import ImuSensor

NEVER = math.inf  # s; start of a fault that another flight of the batch has in its place

Numbers = NDArray[Any]
Slot = tuple[int, Any]  # place among the faults, structure


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Loop:
    """Everything that acts in the closed loop of one flight."""

    plant: Plant
    sensor: ImuSensor
    injections: tuple[Injection, ...]
    observer: FaultObserver
    disturbance_observer: DisturbanceObserver
    controller: Controller
    references: tuple[Reference, ...]
    period_ns: int
    count: int  # samples


@dataclasses.dataclass(frozen=True, eq=False)
class Seeds:
    """What the random numbers of a flight come from."""

    sensor: int
    injector: int
    numbers: tuple[int, ...]  # of each injection, as the injector counts them; 0: not in this flight


@dataclasses.dataclass(frozen=True, eq=False)
class FlightParts:
    """One flight of a batch."""

    loop: Loop
    seeds: Seeds


def with_common_faults(flights: Sequence[FlightParts]) -> list[FlightParts]:
    """Give all flights the same kinds of faults in the same order, those that a flight has not never acting.

    So flights that differ only in the kinds of their faults are compiled and flown together.
    """
    slots = [_slots(flight) for flight in flights]
    templates: dict[Slot, Injection] = {}
    for flight, own in zip(flights, slots, strict=True):
        for slot, place in own.items():
            templates.setdefault(slot, flight.loop.injections[place])
    order = sorted(templates, key=lambda slot: slot[0])
    never = [dataclasses.replace(templates[slot], start=NEVER, stop=NEVER) for slot in order]
    return [_with_faults(flight, own, order, never) for flight, own in zip(flights, slots, strict=True)]


def _slots(flight: FlightParts) -> dict[Slot, int]:
    """Which kind of fault is at which place."""
    return {(place, structure_of(one)): place for place, one in enumerate(flight.loop.injections)}


def _with_faults(
    flight: FlightParts, own: Mapping[Slot, int], order: Sequence[Slot], never: Sequence[Injection]
) -> FlightParts:
    places = [own.get(slot) for slot in order]
    injections = tuple(
        absent if place is None else flight.loop.injections[place]
        for place, absent in zip(places, never, strict=True)
    )
    numbers = tuple(0 if place is None else flight.seeds.numbers[place] for place in places)
    return FlightParts(
        dataclasses.replace(flight.loop, injections=injections),
        dataclasses.replace(flight.seeds, numbers=numbers),
    )


def structure_of(part: Any) -> Any:
    """What two parts must have in common to be flown together; hashable."""
    return tuple(_static(part, ""))


def numbers_of(part: Any) -> dict[str, Numbers]:
    """The numbers of a part, by path."""
    return dict(_numbers(part, ""))


def with_numbers(part: Any, values: Mapping[str, Any]) -> Any:
    """Return the part with other numbers, unchecked: they may be those of a compiler."""
    return _replaced(part, "", values) if values else part


def in_precision(part: Any, dtype: np.dtype[Any]) -> Any:
    """Return the part with all arrays of floats in a precision; single floats have none."""
    arrays = {
        path: number.astype(dtype)
        for path, number, raw in ((path, np.asarray(raw), raw) for path, raw in _leaves(part, ""))
        if isinstance(raw, np.ndarray) and number.dtype.kind == "f"
    }
    return with_numbers(part, arrays)


def differing(flights: Sequence[Mapping[str, Numbers]], free: Collection[str] = ()) -> dict[str, Numbers]:
    """The numbers that differ between flights, and those that are ``free``, stacked (flights, ...)."""
    first = flights[0]
    return {
        path: np.stack([flight[path] for flight in flights])
        for path, value in first.items()
        if path in free or any(flight[path].tobytes() != value.tobytes() for flight in flights[1:])
    }


def _numbers(part: Any, path: str) -> Iterator[tuple[str, Numbers]]:
    return ((name, np.asarray(raw)) for name, raw in _leaves(part, path))


def _leaves(part: Any, path: str) -> Iterator[tuple[str, Any]]:
    """The numbers of a part as they are there: floats, arrays, tuples of floats."""
    if _as_number(part) is not None:
        yield path, part
        return
    for name, inside in _inside(part):
        yield from _leaves(inside, f"{path}.{name}" if path else name)


def _static(part: Any, path: str) -> Iterator[Any]:
    number = _as_number(part)
    if number is not None:
        yield path, number.shape, number.dtype.kind
        return
    inside = list(_inside(part))
    yield path, type(part).__qualname__, None if inside or _is_container(part) else part
    for name, each in inside:
        yield from _static(each, f"{path}.{name}" if path else name)


def _replaced(part: Any, path: str, values: Mapping[str, Any]) -> Any:
    if path in values:
        return values[path]
    if not any(name.startswith(f"{path}." if path else "") for name in values):
        return part
    changed = {
        name: new
        for name, inside in _inside(part)
        if (new := _replaced(inside, f"{path}.{name}" if path else name, values)) is not inside
    }
    if not changed:
        return part
    if isinstance(part, tuple):
        return tuple(changed.get(str(index), each) for index, each in enumerate(part))  # pyright: ignore
    new_part = copy.copy(part)
    for name, value in changed.items():
        object.__setattr__(new_part, name, value)
    return new_part


def _as_number(part: Any) -> Numbers | None:
    """A float, an array, or a vector of floats, as an array; None for anything else."""
    if isinstance(part, (float, np.ndarray)):
        return np.asarray(part)
    if isinstance(part, tuple) and part and all(isinstance(each, float) for each in part):  # pyright: ignore
        return np.asarray(part, np.float64)
    return None


def _inside(part: Any) -> list[tuple[str, Any]]:
    if isinstance(part, tuple):
        return [(str(index), each) for index, each in enumerate(part)]  # pyright: ignore
    if not dataclasses.is_dataclass(part):
        return []
    return [(name, getattr(part, name)) for name in _names(type(part))]


def _is_container(part: Any) -> bool:
    return isinstance(part, tuple) or dataclasses.is_dataclass(part)


@functools.cache
def _names(kind: type) -> tuple[str, ...]:
    """Names of the fields of a part, and of what it computes once from them (a mixer, say)."""
    derived = (
        name
        for each in kind.__mro__
        for name, value in vars(each).items()
        if isinstance(value, functools.cached_property)
    )
    return (*(field.name for field in dataclasses.fields(kind)), *derived)
