"""When the attitude is faulty by schedule, on which axes, and with which kind of fault."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple, Protocol

from quadftc_model.samples import AXES

if TYPE_CHECKING:
    from quadftc_sim.injection import Injection

KINDS = {"bias": "step", "drift": "ramp"}  # fault of the catalogue -> word of the field, if it differs
UNKNOWN_KIND = "fault"  # of a fault of which only the time is known


class Scheduled(Protocol):
    """A scheduled fault, as a scenario has it."""

    @property
    def injection(self) -> Injection:
        """Which fault acts on which channel, and when."""
        ...

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes it acts on, named roll, pitch, yaw on every channel."""
        ...


class FaultWindow(NamedTuple):
    """When the attitude is faulty by schedule."""

    start: float  # [s]
    stop: float  # [s]
    axes: tuple[str, ...]


class FaultEvent(NamedTuple):
    """A time in which one axis of the attitude is faulty without a break."""

    axis: str
    kind: str  # step, ramp, sine, ...; of faults that overlap, all: step+sine
    start: float  # [s]
    stop: float  # [s]; the first moment without the fault


def fault_windows(faults: Iterable[Scheduled], duration: float) -> tuple[FaultWindow, ...]:
    """Return every distinct pair of start and stop [s] of faults of the attitude, in the order of time."""
    return merged_windows(
        FaultWindow(fault.injection.start, min(fault.injection.stop, duration), fault.axes)
        for fault in faults
        if fault.injection.channel == "attitude"
    )


def merged_windows(windows: Iterable[FaultWindow]) -> tuple[FaultWindow, ...]:
    """Return windows in the order of time; those of the same times become one."""
    axes: dict[tuple[float, float], set[str]] = {}
    for start, stop, names in windows:
        axes.setdefault((start, stop), set()).update(names)
    return tuple(
        FaultWindow(start, stop, tuple(axis for axis in AXES if axis in axes[start, stop]))
        for start, stop in sorted(axes)
    )


def fault_events(faults: Iterable[Scheduled], duration: float) -> tuple[FaultEvent, ...]:
    """Return the events of scheduled faults.

    Parameters
    ----------
    faults : iterable of Scheduled
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
