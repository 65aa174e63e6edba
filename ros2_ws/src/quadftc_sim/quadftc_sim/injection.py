"""Injections: which faults act on which axes of the IMU sample or on which rotors, and when."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_model.hints import nearest
from quadftc_model.parameters import build, parameters_of
from quadftc_model.registry import Registry
from quadftc_model.units import quantity
from quadftc_sim.fault import Fault, faults
from quadftc_sim.rotor_fault import ROTOR, rotor_faults

CHANNEL_UNITS: dict[str, dict[str, str]] = {
    "attitude": {"channel": "rad", "channel_rate": "rad/s"},
    "gyro": {"channel": "rad/s", "channel_rate": "rad/s^2"},
    "accelerometer": {"channel": "m/s^2", "channel_rate": "m/s^3"},
    "imu": {},
    ROTOR: {},
}
TRUTH = {  # channel -> topic of its true fault
    "attitude": "fault/injected",
    **{channel: f"fault/injected/{channel}" for channel in ("gyro", "accelerometer")},
}
AXES = {"roll": 0, "pitch": 1, "yaw": 2, "x": 0, "y": 1, "z": 2}
# bare numbers from here on are asked about: degrees are meant, or a mistake
ABSURD = {"rad": 0.75, "rad/s": 35.0, "rad/s^2": 100.0}  # 43 deg; 2000 deg/s, the range of a gyro
LATEST = 9.2e9  # s; stamps, in 64-bit nanoseconds, end there
SCHEDULE = ("channel", "start", "stop", "duration")
RESERVED = (*SCHEDULE, "axes", "axis", "rotors")


@dataclasses.dataclass(frozen=True, eq=False)
class Injection:
    """One fault on one channel: from ``start`` to ``stop`` [s] of scenario time, on the elements of ``mask``.

    These are the three axes, or of the channel `ROTOR` the n rotors.
    """

    kind: str
    channel: str
    mask: NDArray[np.bool_]
    start: float
    stop: float
    law: Any  # a `Fault`, or a `RotorFault`

    @property
    def elements(self) -> tuple[str, ...]:
        """What it is on: axes, named as roll, pitch, yaw on every sensor, or rotors, numbered from 1 on."""
        faulty, axes = np.flatnonzero(self.mask).tolist(), tuple(AXES)
        return tuple(str(row + 1) if self.channel == ROTOR else axes[row] for row in faulty)

    def for_period(self, period: float) -> Injection:
        """Return the injection for samples that are ``period`` [s] apart: itself, if it is one for any."""
        law = self.law if self.channel == ROTOR else self.law.for_period(period)
        return self if law is self.law else dataclasses.replace(self, law=law)


def registry_of(kind: object, values: Mapping[str, object]) -> Registry[Any]:
    """Return the registry of a fault by its name and raw values: it is on a rotor if they say so.

    Without a channel, a name that only rotor faults have says so too.
    """
    if "channel" in values:
        on_rotors = values["channel"] == ROTOR
    else:
        on_rotors = "rotors" in values or (kind in rotor_faults.names() and kind not in faults.names())
    return rotor_faults if on_rotors else faults


def make_injection(kind: str, values: Mapping[str, object], now: float = 0.0, rotors: int = 0) -> Injection:
    """Make an injection from the name of a fault and raw values, of a scenario, a service or a command.

    The values are ``channel`` (attitude by default, if the fault can be on it), ``axes`` (names; all by
    default) or ``rotors`` (numbers from 1 on), ``start`` [s], ``stop`` [s] or ``duration`` [s], and the
    fault's own parameters. Times count from ``now`` [s]. A vehicle in free flight has so many ``rotors``.
    """
    fault = registry_of(kind, values).get(kind)
    usual = "attitude" if "attitude" in fault.channels else fault.channels[0]
    channel = str(values.get("channel", usual))
    if channel not in CHANNEL_UNITS:
        raise ValueError(f"channel = {channel!r}: expected one of {', '.join(CHANNEL_UNITS)}")
    if channel not in fault.channels:
        raise ValueError(f"channel = {channel!r}: {kind} can be on {', '.join(fault.channels)}")
    own = {name: value for name, value in values.items() if name not in RESERVED}
    known = [*(spec.name for spec in parameters_of(fault)), *RESERVED]
    for name in own:
        if name not in known:
            raise ValueError(f"{name}: unknown parameter{nearest(name, known)}; known: {', '.join(known)}")
    mask = _rotor_mask(kind, values, rotors) if channel == ROTOR else _mask(kind, fault, values)
    window = _window(values, now)
    return Injection(kind, channel, mask, *window, build(fault, own, units=CHANNEL_UNITS[channel]))


def _rotor_mask(kind: str, values: Mapping[str, object], count: int) -> NDArray[np.bool_]:
    """Return which rotors (n,) are meant: those of ``rotors``, whole numbers from 1 on, or texts of such."""
    if count == 0:
        raise ValueError(f"channel = {ROTOR!r}: only in free flight: expected 'plant: {{kind: free_flight}}'")
    for name in ("axes", "axis"):
        if name in values and values[name] not in ((), []):
            raise ValueError(f"{name}: {kind} on a rotor has none; expected rotors, such as [1]")
    given = values.get("rotors", ())
    numbers: list[Any] = [*given] if isinstance(given, (list, tuple)) else [given]
    if not numbers:
        raise ValueError(f"rotors: missing; expected numbers from 1 to {count}, such as [1]")
    mask = np.zeros(count, dtype=bool)
    for each in numbers:
        number = int(each) if isinstance(each, str) and each.isdecimal() else each
        whole = (
            isinstance(number, (int, float)) and not isinstance(number, bool) and number in range(count + 1)
        )
        if not whole or number == 0:
            raise ValueError(f"rotors: {each!r} is no rotor; expected numbers from 1 to {count}")
        mask[int(number) - 1] = True
    return mask


def _mask(kind: str, fault: type[Fault], values: Mapping[str, object]) -> NDArray[np.bool_]:
    if "rotors" in values:
        raise ValueError(f"rotors: {kind} is on a sensor; expected 'channel: {ROTOR}', or axes")
    given = values.get("axes", values.get("axis", ()))
    if "axes" in values and "axis" in values:
        raise ValueError("axes: given twice, as axis too")
    names: list[object] = [*given] if isinstance(given, (list, tuple)) else [given]
    if names and fault.whole_channel:
        given = ", ".join(map(str, names))
        raise ValueError(f"axes = {given}: {kind} takes the whole channel; leave axes out")
    mask = np.zeros(3, dtype=bool)
    for name in names or ("x", "y", "z"):
        if not isinstance(name, str) or name not in AXES:
            raise ValueError(f"axes: {name!r} is no axis; expected roll, pitch, yaw or x, y, z")
        mask[AXES[name]] = True
    return mask


def _window(values: Mapping[str, object], now: float) -> tuple[float, float]:
    """Start and stop in scenario time, whole nanoseconds as stamps: 0.1 s + 0.2 s is the sample at 0.3 s."""
    start = _time(values, "start", 0.0)
    if "duration" in values and "stop" in values:
        raise ValueError("duration: give either duration or stop")
    name, since = ("duration", now + start) if "duration" in values else ("stop", now)
    end = _time(values, name, math.inf)
    first, last = round(now + start, 9), round(since + end, 9)
    if last <= first:
        wanted = "positive" if name == "duration" else f"later than start = {start:g} s"
        raise ValueError(f"{name} = {end:g} s: must be {wanted}")
    return first, last


def _time(values: Mapping[str, object], name: str, default: float) -> float:
    try:
        time = quantity(values.get(name, default), "s")
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if time < 0.0:
        raise ValueError(f"{name} = {time:g} s: must not be negative")
    if name in values and time > LATEST:
        raise ValueError(f"{name} = {time:g} s: must be at most {LATEST:g} s, where stamps end")
    return time


def fault_generators(seed: int, number: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Return where an injection's normal and uniform numbers come from, which no other injection shifts."""
    return np.random.default_rng([seed, number, 0]), np.random.default_rng([seed, number, 1])


def ask_for_size(kind: str, values: Mapping[str, object]) -> None:
    """Refuse a fault that a person typed, by a ValueError, if it has no size: it would do nothing."""
    sizes = [
        spec
        for spec in parameters_of(registry_of(kind, values).get(kind))
        if np.all(np.isin(spec.default, (0.0, math.inf)))
    ]
    if sizes and not any(spec.name in values for spec in sizes):
        raise ValueError(f"{sizes[0].name}: missing; without it, {kind} is no fault")


def ask_for_units(kind: str, values: Mapping[str, object]) -> None:
    """Refuse a number without a unit that a person typed, by a ValueError, where it is absurd in SI."""
    fault = registry_of(kind, values).get(kind)
    usual = "attitude" if "attitude" in fault.channels else fault.channels[0]
    units = CHANNEL_UNITS.get(str(values.get("channel", usual)), {})
    for spec in parameters_of(fault):
        unit = units.get(spec.unit.strip("{}"), "")
        raw = values.get(spec.name, ())
        parts: list[Any] = [*raw] if isinstance(raw, (list, tuple)) else [raw]
        for text in parts:
            try:
                number = float(text)
            except (TypeError, ValueError):  # it has a unit, or is wrong in another way
                continue
            if abs(number) >= ABSURD.get(unit, math.inf):
                other = unit.replace("rad", "deg")
                size = f"{math.degrees(number):.0f} {other}"
                wanted = f"write {spec.name}={text}{other} or {spec.name}={text}{unit}"
                raise ValueError(f"{spec.name} = {text}: without a unit this is {size}; {wanted}")
