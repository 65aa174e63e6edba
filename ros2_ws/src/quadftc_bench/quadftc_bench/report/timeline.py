"""When something happens to an axis: windows of faults to shade, onsets of disturbances to mark."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadftc_bench.report.description import Mark, Shade
from quadftc_bench.scenario import Fault, Scenario

FAULT_WINDOW = "fault window"  # of the attitude; windows on other channels are named by channel and kind
ONSET, ON_OFF = "disturbance onset", "disturbance on, off"
INSTANTS = 200  # at which a disturbance is looked at to see whether it acts on an axis


def shades(scenario: Scenario, axis: int, end: float) -> tuple[Shade, ...]:
    """Return the fault windows of an axis up to ``end`` [s], those of the attitude first.

    Windows of one kind that touch are one.
    """
    kinds = sorted({_kind(fault) for fault in scenario.faults} | {FAULT_WINDOW}, key=_order)
    windows: list[Shade] = []
    for fault in sorted(scenario.faults, key=lambda fault: (_order(_kind(fault)), fault.injection.start)):
        start, stop = fault.injection.start, min(fault.injection.stop, end)
        if not fault.injection.mask[axis] or start >= end:
            continue
        rank, last = kinds.index(_kind(fault)), windows[-1] if windows else None
        if last is not None and last.rank == rank and start <= last.stop:
            windows[-1] = Shade(last.start, max(last.stop, stop), last.label, rank)
        else:
            windows.append(Shade(start, stop, _kind(fault), rank))
    return tuple(windows)


def marks(scenario: Scenario, axis: int, end: float) -> tuple[Mark, ...]:
    """Return when disturbances of an axis begin before ``end`` [s], and when they end before it."""
    laws = [part.law for part in scenario.disturbances if part.law.start < end]
    label = ON_OFF if any(law.stop < end for law in laws) else ONSET  # the same for all axes
    acting = [law for law in laws if _acts(law, axis, min(law.stop, end))]
    times = {law.start for law in acting} | {law.stop for law in acting if law.stop < end}
    return tuple(Mark(time, label) for time in sorted(times))


def _kind(fault: Fault) -> str:
    injection = fault.injection
    return FAULT_WINDOW if injection.channel == "attitude" else f"{injection.channel} {injection.kind}"


def _order(kind: str) -> tuple[bool, str]:
    return kind != FAULT_WINDOW, kind


def _acts(law: Any, axis: int, stop: float) -> bool:
    """Whether a disturbance gives a torque about an axis between its start and ``stop`` [s]."""
    shares = np.arange(INSTANTS) / INSTANTS
    return any(float(law.torque(law.start + share * (stop - law.start))[axis]) != 0.0 for share in shares)
