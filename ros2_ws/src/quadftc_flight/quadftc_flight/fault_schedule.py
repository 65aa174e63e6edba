"""When which axis of which sensor is faulty by schedule: the truth that metrics judge a flight by."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, NamedTuple

from pydantic import Field, GetPydanticSchema
from pydantic_core.core_schema import literal_schema

from quadftc_model.samples import AXES
from quadftc_sim.rotor_fault import ROTOR

if TYPE_CHECKING:
    from quadftc_flight.scenario.components import Fault

KINDS = {"bias": "step", "drift": "ramp"}  # fault of the catalogue -> word of the field, if it differs
SENSORS = ("attitude", "gyro", "accelerometer")  # that can be faulty, axis by axis
# as pydantic checks them where they are read from a file
Axis = Annotated[str, GetPydanticSchema(lambda _source, _handler: literal_schema(list(AXES)))]
Sensor = Annotated[str, GetPydanticSchema(lambda _source, _handler: literal_schema(list(SENSORS)))]
Time = Annotated[float, Field(ge=0.0, strict=True, allow_inf_nan=False)]  # s
UNKNOWN_KIND = "fault"  # of a fault of which only the time is known


class FaultWindow(NamedTuple):
    """When the attitude is faulty."""

    start: Time  # [s]
    stop: Time  # [s]; the first moment without the fault
    axes: tuple[Axis, ...]


class FaultEvent(NamedTuple):
    """A time in which one axis of a sensor is faulty without a break."""

    axis: Axis  # of a gyro and an accelerometer: roll is x, pitch y, yaw z
    kind: str  # step, ramp, sine, ...; of faults that overlap, all: step+sine
    start: Time  # [s]
    stop: Time  # [s]; the first moment without the fault
    component: Sensor = "attitude"


def fault_windows(faults: Iterable[Fault], duration: float) -> tuple[FaultWindow, ...]:
    """Return the windows of the faults on the attitude, in a flight of that duration [s]."""
    return merge_windows(
        FaultWindow(fault.injection.start, min(fault.injection.stop, duration), fault.axes)
        for fault in faults
        if fault.injection.channel == "attitude"
    )


def merge_windows(windows: Iterable[FaultWindow]) -> tuple[FaultWindow, ...]:
    """Return the windows in the order of time; those of the same times become one."""
    axes: dict[tuple[float, float], set[str]] = {}
    for start, stop, names in windows:
        axes.setdefault((start, stop), set()).update(names)
    return tuple(FaultWindow(*key, tuple(axis for axis in AXES if axis in axes[key])) for key in sorted(axes))


def fault_events(faults: Iterable[Fault], duration: float) -> tuple[FaultEvent, ...]:
    """Return the events of the faults on a sensor that begin in a flight of that duration [s].

    A gyro or accelerometer that misses an axis is missing as a whole: its message marks no single axis.
    """
    return merge_events(
        FaultEvent(axis, KINDS.get(item.kind, item.kind), item.start, min(item.stop, duration), item.channel)
        for axes, item in ((fault.axes, fault.injection) for fault in faults)
        if item.channel in SENSORS and item.start < duration
        for axis in (AXES if item.channel != "attitude" and item.kind == "nan" else axes)
    )


def rotor_events(faults: Iterable[Fault], duration: float) -> tuple[FaultEvent, ...]:
    """Return the events of the faults on a rotor that begin in a flight of that duration [s].

    The axis of each is the number of the rotor.
    """
    return merge_events(
        FaultEvent(rotor, item.kind, item.start, min(item.stop, duration), ROTOR)
        for rotors, item in ((fault.rotors, fault.injection) for fault in faults)
        if item.start < duration
        for rotor in rotors
    )


def attitude_events(events: Iterable[FaultEvent]) -> list[FaultEvent]:
    """Return those of the attitude."""
    return [event for event in events if event.component == "attitude"]


def events_of_windows(windows: Iterable[FaultWindow]) -> tuple[FaultEvent, ...]:
    """Return the events of windows whose kind of fault is not known."""
    return merge_events(
        FaultEvent(axis, UNKNOWN_KIND, start, stop) for start, stop, axes in windows for axis in axes
    )


def merge_events(events: Iterable[FaultEvent]) -> tuple[FaultEvent, ...]:
    """Return the events in the order of time; those of one axis of a sensor that overlap become one."""
    # in the order of sensors and axes, as of those that begin at once the first comes first
    merged: dict[tuple[str, str], list[FaultEvent]] = {(name, axis): [] for name in SENSORS for axis in AXES}
    for event in sorted(events, key=lambda event: event.start):
        of_axis = merged.setdefault((event.component, event.axis), [])
        if of_axis and event.start < (last := of_axis[-1]).stop:
            kinds = dict.fromkeys([*last.kind.split("+"), event.kind])
            of_axis[-1] = last._replace(kind="+".join(kinds), stop=max(last.stop, event.stop))
        else:
            of_axis.append(event)
    everything = (event for of_axis in merged.values() for event in of_axis)
    return tuple(sorted(everything, key=lambda event: event.start))
