"""The faults and disturbances of a recording as lines of a small table: when, where, what."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from quadftc_flight.scenario import Fault
from quadftc_model.parameters import parameters_of
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded
from quadftc_report.wording import listing, period, plain
from quadftc_sim.injection import CHANNEL_UNITS

Injection = tuple[str, str, str]


def list_injections(run: Recorded) -> list[Injection]:
    """Return the faults and disturbances that begin before the recording ends: when, where, what.

    Faults of the attitude outside the schedule come last: those of a recording, those injected by hand.
    """
    end = run.duration
    faults = sorted(run.faults, key=lambda fault: fault.injection.start)
    lines = [_fault(fault, end) for fault in faults if fault.injection.start < end]
    for part in run.disturbances:
        if part.law.start < end:
            what = _describe(part.kind, part.law, part.given, AXES, {})
            lines.append((_when(part.law.start, part.law.stop, end), "torque", what))
    scheduled = {(fault.injection.start, axis) for fault in faults for axis in fault.axes}
    for event in run.fault_events:
        if event.start < end and (event.start, event.axis) not in scheduled:
            when = _when(event.start, event.stop, end)
            lines.append((when, f"attitude: {event.axis}", f"{event.kind}, in the recording"))
    inside = [(run.flight.time >= event.start) & (run.flight.time < event.stop) for event in run.fault_events]
    stray = np.abs(run.flight.fault[~np.any([*inside, np.zeros(len(run.flight), np.bool_)], axis=0)])
    largest = math.degrees(np.max(stray, initial=0.0, where=np.isfinite(stray)))
    if largest > 1e-6:
        lines.append(("outside the schedule", "attitude", f"up to {plain(largest)} deg"))
    return lines


def _when(start: float, stop: float, end: float) -> str:
    return period(start, math.inf if stop >= end else stop)


def _fault(fault: Fault, end: float) -> Injection:
    injection = fault.injection
    whole = injection.law.whole_channel or len(fault.axes) == len(AXES)
    units = CHANNEL_UNITS[injection.channel]
    what = _describe(injection.kind, injection.law, fault.given, fault.axes, units)
    where = f"{injection.channel}: {'all axes' if whole else listing(fault.axes)}"
    return _when(injection.start, injection.stop, end), where, what


def _describe(
    kind: str, law: Any, given: Sequence[str], axes: Sequence[str], units: Mapping[str, str]
) -> str:
    """``bias: value 1 deg``; ``sine: amplitude 2 deg, frequency 0.6 rad/s``."""
    texts: list[str] = []
    for spec in parameters_of(law.__class__):
        if spec.name in given and spec.name not in ("start", "stop"):
            unit = spec.unit.format(**units) if units else spec.unit
            angle = "{" in spec.unit and unit.startswith("rad")  # frequencies stay in rad/s
            scale = math.degrees(1.0) if angle else 1.0
            unit = unit.replace("rad", "deg", 1) if angle else unit.removesuffix("1")
            value = _value(getattr(law, spec.name), scale, axes)
            texts.append(f"{spec.name.replace('_', ' ')} {value} {unit}".rstrip())
    return ": ".join(filter(None, [kind, ", ".join(texts)]))


def _value(value: Any, scale: float, axes: Sequence[str]) -> str:
    if isinstance(value, tuple):
        given = zip(AXES, cast("tuple[float, ...]", value), strict=True)
        numbers = [plain(scale * number) for axis, number in given if axis in axes]
        return numbers[0] if len(set(numbers)) == 1 else f"({', '.join(numbers)})"
    return plain(scale * value) if isinstance(value, (int, float)) else str(value)
