"""The faults that a diagnosis is judged by: on which axis of the attitude, of which kind, and when."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from quadftc_model.samples import AXES

if TYPE_CHECKING:  # a scenario takes these events for its checks
    from quadftc_flight.scenario import Fault

KINDS = {"bias": "step", "drift": "ramp"}  # fault of the catalogue -> word of the field, if it differs
UNKNOWN_KIND = "fault"  # of a fault of which only the time is known


class FaultEvent(NamedTuple):
    """A time in which one axis of the attitude is faulty without a break."""

    axis: str
    kind: str  # step, ramp, sine, ...; of faults that overlap, all: step+sine
    start: float  # [s]
    stop: float  # [s]; the first moment without the fault


def fault_events(faults: Iterable[Fault], duration: float) -> tuple[FaultEvent, ...]:
    """Return the events of scheduled faults.

    Parameters
    ----------
    faults : iterable of Fault
        Those on other channels than the attitude do not count.
    duration : float
        Of the flight [s]; what begins later does not count, what ends later is cut.

    Returns
    -------
    tuple of FaultEvent
        In the order of time. Faults of one axis that overlap are one event.
    """
    injections = [(fault.axes, fault.injection) for fault in faults]
    return joined_events(
        FaultEvent(
            axis, KINDS.get(injection.kind, injection.kind), injection.start, min(injection.stop, duration)
        )
        for axes, injection in injections
        if injection.channel == "attitude" and injection.start < duration
        for axis in axes
    )


def events_of_windows(windows: Iterable[tuple[float, float, Iterable[str]]]) -> tuple[FaultEvent, ...]:
    """Return the events of windows (start [s], stop [s], axes) whose kind of fault is not known."""
    return joined_events(
        FaultEvent(axis, UNKNOWN_KIND, start, stop) for start, stop, axes in windows for axis in axes
    )


def joined_events(events: Iterable[FaultEvent]) -> tuple[FaultEvent, ...]:
    """Return the events in the order of time; those of one axis that overlap are one."""
    found: list[FaultEvent] = []
    ordered = sorted(events, key=lambda event: (AXES.index(event.axis), event.start))
    for _, group in itertools.groupby(ordered, key=lambda event: event.axis):
        first, *others = group
        found.append(first)
        for event in others:
            last = found[-1]
            if event.start < last.stop:
                kinds = dict.fromkeys([*last.kind.split("+"), event.kind])
                found[-1] = last._replace(kind="+".join(kinds), stop=max(last.stop, event.stop))
            else:
                found.append(event)
    return tuple(sorted(found, key=lambda event: (event.start, AXES.index(event.axis))))
