"""The parts of one flight, and which of their numbers differ between the flights of a batch.

A part is a frozen dataclass. Its texts, whole numbers and switches are its *structure*: a step is compiled
for them. Its floats and arrays are *numbers*, each with a path (``plant.vehicle.inertia``). Flights of one
structure fly together: numbers that all flights share stay constants, the others become arrays with a value
per flight.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from quadftc_control.controller import Controller
from quadftc_control.position_loop import PositionLoop
from quadftc_control.reference import Reference
from quadftc_control.trajectory import Trajectory
from quadftc_fdi.disturbance_observer import DisturbanceObserver
from quadftc_fdi.fault_observer import FaultObserver
from quadftc_sim.injection import Injection
from quadftc_sim.plant import Plant
from quadftc_sim.position_sensor import PositionSensor
from quadftc_sim.sensors import ImuSensor

NEVER = math.inf  # s; start of a fault that only other flights of the batch have

Numbers = NDArray[Any]
Progress = Callable[[int], None]  # gets the number of samples flown since its last call
T = TypeVar("T")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Place:
    """A position sensor beside an IMU."""

    sensor: PositionSensor
    every: int  # samples of the IMU to one of it
    behind: int  # samples of the IMU that one is late


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
    # in free flight
    place: Place | None = None
    position_loop: PositionLoop | None = None
    trajectories: tuple[Trajectory, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class FlightParts:
    """One flight of a batch."""

    loop: Loop
    seed: int  # of the sensor's and the injector's random numbers
    fault_numbers: tuple[int, ...]  # of each injection, as the injector counts them; 0: not in this flight


def with_common_faults(flights: Sequence[FlightParts]) -> list[FlightParts]:
    """Give all flights the same kinds of faults in the same order; one that a flight lacks never acts.

    So flights that differ only in the kinds of their faults are compiled and flown together, and others with
    these kinds need no other compilation.
    """
    # by place among the faults and structure: the fault of each flight, with its number
    slots = [
        {
            (place, structure_of(fault)): (fault, number)
            for place, (fault, number) in enumerate(zip(one.loop.injections, one.fault_numbers, strict=True))
        }
        for one in flights
    ]
    there = {slot: fault for faults in slots for slot, (fault, _) in faults.items()}
    order = sorted(there, key=lambda slot: (slot[0], repr(slot[1])))
    absent = {slot: (dataclasses.replace(there[slot], start=NEVER, stop=NEVER), 0) for slot in order}
    filled: list[FlightParts] = []
    for flight, faults in zip(flights, slots, strict=True):
        pairs = [faults.get(slot, never) for slot, never in absent.items()]
        loop = dataclasses.replace(flight.loop, injections=tuple(fault for fault, _ in pairs))
        filled.append(FlightParts(loop, flight.seed, tuple(number for _, number in pairs)))
    return filled


def structure_of(part: Any) -> Any:
    """Return what two parts must have in common to fly together; hashable."""
    return tuple(
        (path, number.shape, number.dtype.kind)
        if number is not None
        else (path, type(node).__qualname__, None if _is_container(node) else node)
        for path, node, number in _walk(part)
    )


def numbers_of(part: Any) -> dict[str, Numbers]:
    """Return the numbers of a part, by path."""
    return {path: number for path, _, number in _walk(part) if number is not None}


def with_numbers(part: Any, values: Mapping[str, Any], path: str = "") -> Any:
    """Return the part at a path with other numbers, unchecked: they may be tracers of JAX."""
    if path in values:
        return values[path]
    start = f"{path}." if path else ""
    if not any(name.startswith(start) for name in values):
        return part
    inside = {name: with_numbers(each, values, f"{start}{name}") for name, each in _children(part)}
    if isinstance(part, tuple):
        return tuple(inside.values())
    changed = copy.copy(part)
    for name, value in inside.items():
        object.__setattr__(changed, name, value)
    return changed


def in_precision(part: T, dtype: np.dtype[Any]) -> T:
    """Return the part with all arrays of floats in a precision; single floats have none."""
    arrays = {
        path: number.astype(dtype)
        for path, node, number in _walk(part)
        if isinstance(node, np.ndarray) and number is not None and number.dtype.kind == "f"
    }
    return with_numbers(part, arrays)


def differing(flights: Sequence[Mapping[str, Numbers]], free: Collection[str] = ()) -> dict[str, Numbers]:
    """Stack the numbers that differ between flights, and those that are ``free``: (flights, ...)."""
    first = flights[0]
    return {
        path: np.stack([flight[path] for flight in flights])
        for path, value in first.items()
        if path in free or any(flight[path].tobytes() != value.tobytes() for flight in flights[1:])
    }


def _walk(part: Any, path: str = "") -> Iterator[tuple[str, Any, Numbers | None]]:
    """Yield every node of a part from the root on: path, node, and the numbers of a leaf."""
    number = _as_number(part)
    yield path, part, number
    if number is None:
        for name, inside in _children(part):
            yield from _walk(inside, f"{path}.{name}" if path else name)


def _as_number(part: Any) -> Numbers | None:
    """Return a float, an array, or a tuple of floats, as an array; None for anything else."""
    if isinstance(part, (float, np.ndarray)):
        return np.asarray(part)
    if isinstance(part, tuple) and part and all(isinstance(each, float) for each in part):  # pyright: ignore
        return np.asarray(part, np.float64)
    return None


def _children(part: Any) -> list[tuple[str, Any]]:
    if isinstance(part, tuple):
        return [(str(index), each) for index, each in enumerate(part)]  # pyright: ignore
    return [(name, getattr(part, name)) for name in _names(type(part))] if _is_container(part) else []  # pyright: ignore


def _is_container(part: Any) -> bool:
    return isinstance(part, tuple) or dataclasses.is_dataclass(part)


@functools.cache
def _names(kind: type) -> list[str]:
    """Names of the fields of a part, and of its cached properties (a mixer, say)."""
    members = [(name, value) for each in kind.__mro__ for name, value in vars(each).items()]
    derived = [name for name, value in members if isinstance(value, functools.cached_property)]
    return [*(field.name for field in dataclasses.fields(kind)), *derived]
