"""What was done to the vehicle in a scenario, in words: faults and disturbances with kind, size and time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from quadftc_flight.flight import Flight
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import Fault, Part, Scenario
from quadftc_model.parameters import Parameter, parameters_of
from quadftc_model.samples import AXES
from quadftc_report.wording import each_axis, listing, period, plain
from quadftc_sim.injection import CHANNEL_UNITS

_READINGS = {
    "attitude": "the attitude reading",
    "gyro": "the gyro",
    "accelerometer": "the accelerometer",
    "imu": "the whole IMU",
}
_IN_DEGREES = {"rad": "deg", "rad/s^2": "deg/s^2"}  # angular frequencies stay in rad/s
_SCHEDULE = ("start", "stop")
_STRAY = 1e-6  # rad; a fault outside its schedule that is larger was injected by hand


def faults_text(faults: Sequence[Fault], duration: float, until: float) -> str:
    """Tell the faults that begin before ``until`` [s], in a flight of that duration [s]; empty: none."""
    groups: dict[tuple[float, float, str], list[Fault]] = {}
    for fault in faults:
        injection = fault.injection
        if injection.start < until:
            groups.setdefault((injection.start, injection.stop, injection.channel), []).append(fault)
    parts = [
        f"{period(start, _end(stop, duration))} {_READINGS.get(channel, channel)} is faulty: "
        + "; ".join(_fault(fault) for fault in group)
        for (start, stop, channel), group in sorted(groups.items(), key=lambda item: item[0])
    ]
    return ". ".join(f"{part[0].upper()}{part[1:]}" for part in parts)


def disturbances_text(scenario: Scenario, until: float) -> str:
    """Tell the disturbance torques that begin before ``until`` [s]; empty if there is none."""
    parts: list[str] = []
    for part in scenario.disturbances:
        start, stop = float(getattr(part.law, "start", 0.0)), float(getattr(part.law, "stop", math.inf))
        if start < until:
            torque = _law(part, AXES, {}).replace(part.kind, f"{part.kind} torque", 1)
            parts.append(f"{period(start, _end(stop, scenario.duration))}: {torque}")
    return "; ".join(parts)


def largest_disturbance(run: RecordedRun) -> dict[str, float]:
    """Return the largest recorded disturbance of each axis, as a torque [N m]; empty if none is known."""
    sizes = np.abs(run.flight.disturbance * run.scenario.plant.inertia)
    if not np.isfinite(sizes).any():
        return {}
    return {axis: float(size) for axis, size in zip(AXES, np.nanmax(sizes, axis=0), strict=True)}


def stray_fault(flight: Flight, scenario: Scenario) -> float | None:
    """Return the largest recorded fault of the attitude [rad] outside every scheduled one, if any."""
    outside = np.ones(len(flight), np.bool_)
    for window in scenario.fault_windows:
        outside &= (flight.time < window.start) | (flight.time >= window.stop)
    sizes = np.abs(flight.fault[outside])
    sizes = sizes[np.isfinite(sizes)]
    return float(sizes.max()) if len(sizes) and sizes.max() > _STRAY else None


def _end(stop: float, duration: float) -> float:
    return math.inf if stop >= duration else stop


def _fault(fault: Fault) -> str:
    units = CHANNEL_UNITS[fault.injection.channel]
    words = _law(Part(fault.injection.kind, fault.injection.law, fault.given), fault.axes, units)
    if fault.injection.law.whole_channel or len(fault.axes) == len(AXES):
        return words
    return f"{words} on {listing(fault.axes)}"


def _law(part: Part, axes: Sequence[str], units: dict[str, str]) -> str:
    """``bias of 1 deg``; ``sine of amplitude 2 deg and frequency 0.6 rad/s``."""
    law: Any = part.law
    specs = {spec.name: spec for spec in parameters_of(law.__class__)}
    given = [name for name in part.given if name in specs and name not in _SCHEDULE]
    values = [(name, _value(specs[name], getattr(part.law, name), axes, units)) for name in given]
    if not values:
        return part.kind
    if len(values) == 1:
        return f"{part.kind} of {values[0][1]}"
    return f"{part.kind} of " + listing([f"{name.replace('_', ' ')} {text}" for name, text in values])


def _value(spec: Parameter, value: Any, axes: Sequence[str], units: dict[str, str]) -> str:
    unit = spec.unit.format(**units) if units else spec.unit
    scale = 1.0
    if unit in _IN_DEGREES or (unit == "rad/s" and "{" in spec.unit):
        scale, unit = 180.0 / math.pi, _IN_DEGREES.get(unit, "deg/s")
    unit = "" if unit == "1" else unit
    if not isinstance(value, tuple):
        return f"{plain(scale * value)} {unit}".rstrip() if isinstance(value, (int, float)) else str(value)
    numbers = cast("tuple[float, ...]", value)
    chosen = {axis: scale * float(number) for axis, number in zip(AXES, numbers, strict=True)}
    chosen = {axis: chosen[axis] for axis in axes}
    if len(set(chosen.values())) == 1:
        return f"{plain(next(iter(chosen.values())))} {unit}".rstrip()
    return each_axis(chosen, unit)
