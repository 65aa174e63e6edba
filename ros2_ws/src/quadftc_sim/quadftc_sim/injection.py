"""Injections: which faults act on which axes of the IMU sample, and when."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_model.parameters import build
from quadftc_model.units import quantity
from quadftc_sim.fault import Fault, faults

CHANNEL_UNITS: dict[str, dict[str, str]] = {
    "attitude": {"channel": "rad", "channel_rate": "rad/s"},
    "gyro": {"channel": "rad/s", "channel_rate": "rad/s^2"},
    "accelerometer": {"channel": "m/s^2", "channel_rate": "m/s^3"},
    "imu": {},
}
TRUTH = {  # channel -> topic of its true fault
    "attitude": "fault/injected",
    **{channel: f"fault/injected/{channel}" for channel in ("gyro", "accelerometer")},
}
AXES = {"roll": 0, "pitch": 1, "yaw": 2, "x": 0, "y": 1, "z": 2}
RESERVED = ("channel", "axes", "axis", "start", "stop", "duration")


@dataclasses.dataclass(frozen=True, eq=False)
class Injection:
    """One fault on one channel: from ``start`` to ``stop`` [s] of scenario time, on the axes of ``mask``."""

    kind: str
    channel: str
    mask: NDArray[np.bool_]
    start: float
    stop: float
    law: Fault


def make_injection(kind: str, values: Mapping[str, Any], now: float = 0.0) -> Injection:
    """Make an injection from the name of a fault and raw values, of a scenario, a service or a command.

    The values are ``channel`` (attitude by default, if the fault can be on it), ``axes`` (names; all by
    default), ``start`` [s], ``stop`` [s] or ``duration`` [s], and the fault's own parameters. Times count
    from ``now`` [s].
    """
    fault = faults.get(kind)
    usual = "attitude" if "attitude" in fault.channels else fault.channels[0]
    channel = str(values.get("channel", usual))
    if channel not in CHANNEL_UNITS:
        raise ValueError(f"channel = {channel!r}: expected one of {', '.join(CHANNEL_UNITS)}")
    if channel not in fault.channels:
        raise ValueError(f"channel = {channel!r}: {kind} can be on {', '.join(fault.channels)}")
    mask, window = _mask(kind, fault, values), _window(values, now)
    own = {name: value for name, value in values.items() if name not in RESERVED}
    return Injection(kind, channel, mask, *window, build(fault, own, units=CHANNEL_UNITS[channel]))


def _mask(kind: str, fault: Any, values: Mapping[str, Any]) -> NDArray[np.bool_]:
    given = values.get("axes", values.get("axis", ()))
    if "axes" in values and "axis" in values:
        raise ValueError("axes: given twice, as axis too")
    names: list[Any] = [*given] if isinstance(given, (list, tuple)) else [given]
    if names and fault.whole_channel:
        given = ", ".join(map(str, names))
        raise ValueError(f"axes = {given}: {kind} takes the whole channel; leave axes out")
    mask = np.zeros(3, dtype=bool)
    for name in names or ("x", "y", "z"):
        if not isinstance(name, str) or name not in AXES:
            raise ValueError(f"axes: {name!r} is no axis; expected roll, pitch, yaw or x, y, z")
        mask[AXES[name]] = True
    return mask


def _window(values: Mapping[str, Any], now: float) -> tuple[float, float]:
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


def _time(values: Mapping[str, Any], name: str, default: float) -> float:
    try:
        time = quantity(values.get(name, default), "s")
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if time < 0.0:
        raise ValueError(f"{name} = {time:g} s: must not be negative")
    return time


def fault_generators(seed: int, number: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Return where an injection's normal and uniform numbers come from, which no other injection shifts."""
    return np.random.default_rng([seed, number, 0]), np.random.default_rng([seed, number, 1])
