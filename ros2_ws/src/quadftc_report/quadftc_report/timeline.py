"""When something happens to an axis: windows of faults to shade, onsets of disturbances to mark."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.scenario import Fault, Part
from quadftc_model.samples import AXES
from quadftc_report.description import Mark, Shade

FAULT_WINDOW = "fault window"  # of the attitude; windows on other channels are named by channel and kind
ONSET, ON_OFF = "disturbance onset", "disturbance on, off"
INSTANTS = 200  # at which a disturbance is looked at to see whether it acts on an axis


def shades(faults: Sequence[Fault], events: Sequence[FaultEvent], axis: int, end: float) -> tuple[Shade, ...]:
    """Return the fault windows of an axis up to ``end`` [s], those of the attitude first.

    Windows of one kind that touch are one.

    Parameters
    ----------
    faults : sequence of Fault
        Of these, those on other channels than the attitude count.
    events : sequence of FaultEvent
        When the attitude is faulty.
    axis : int
    end : float
    """
    periods = [(FAULT_WINDOW, event.start, event.stop) for event in events if event.axis == AXES[axis]]
    for fault in faults:
        injection = fault.injection
        if injection.channel != "attitude" and injection.mask[axis]:
            periods.append((_kind(fault), injection.start, injection.stop))
    kinds = [FAULT_WINDOW, *sorted({_kind(fault) for fault in faults} - {FAULT_WINDOW})]
    windows: list[Shade] = []
    for kind, start, stop in sorted(periods, key=lambda period: (kinds.index(period[0]), period[1])):
        rank, last = kinds.index(kind), windows[-1] if windows else None
        if start >= end:
            continue
        if last is not None and last.rank == rank and start <= last.stop:
            windows[-1] = Shade(last.start, max(last.stop, min(stop, end)), kind, rank)
        else:
            windows.append(Shade(start, min(stop, end), kind, rank))
    return tuple(windows)


def marks(disturbances: Sequence[Part], axis: int, end: float) -> tuple[Mark, ...]:
    """Return when disturbances of an axis begin before ``end`` [s], and when they end before it."""
    laws = [part.law for part in disturbances if part.law.start < end]
    label = ON_OFF if any(law.stop < end for law in laws) else ONSET  # the same for all axes
    acting = [law for law in laws if _acts(law, axis, min(law.stop, end))]
    times = {law.start for law in acting} | {law.stop for law in acting if law.stop < end}
    return tuple(Mark(time, label) for time in sorted(times))


def _kind(fault: Fault) -> str:
    injection = fault.injection
    return FAULT_WINDOW if injection.channel == "attitude" else f"{injection.channel} {injection.kind}"


def _acts(law: Any, axis: int, stop: float) -> bool:
    """Whether a disturbance gives a torque about an axis between its start and ``stop`` [s]."""
    shares = np.arange(INSTANTS) / INSTANTS
    return any(float(law.torque(law.start + share * (stop - law.start))[axis]) != 0.0 for share in shares)
