"""Fault injection: which faults act on which axes of the IMU sample, and when; with the truth of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model.parameters import build
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import ImuSample
from quadftc_model.stepper import seconds
from quadftc_model.units import quantity
from quadftc_sim.fault import Fault, FaultInputs, faults

CHANNEL_UNITS: dict[str, dict[str, str]] = {
    "attitude": {"channel": "rad", "channel_rate": "rad/s"},
    "gyro": {"channel": "rad/s", "channel_rate": "rad/s^2"},
    "accelerometer": {"channel": "m/s^2", "channel_rate": "m/s^3"},
    "imu": {},
}
AXES = {
    name: index for names in (("roll", "pitch", "yaw"), ("x", "y", "z")) for index, name in enumerate(names)
}
RESERVED = ("channel", "axes", "axis", "start", "stop", "duration")

Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Injection:
    """One fault on one channel: from ``start`` to ``stop`` [s] of scenario time, on the axes of ``mask``."""

    kind: str
    channel: str
    mask: NDArray[np.bool_]
    start: float
    stop: float
    law: Fault


class Injected(NamedTuple):
    """What comes out for one sample."""

    sample: ImuSample | None  # None: the sample is withheld
    attitude: Floats  # (3,) true fault of the attitude [rad]; NaN where the channel is no number
    gyro: Floats  # (3,) [rad/s]
    accelerometer: Floats  # (3,) [m/s²]


def make_injection(kind: str, values: Mapping[str, Any], now: float = 0.0) -> Injection:
    """Make an injection from a name and raw values, as a scenario, a service or the command line gives them.

    Parameters
    ----------
    kind : str
        Name of the fault.
    values : mapping
        ``channel`` (attitude by default), ``axes`` (names; all by default), ``start`` [s] from ``now``,
        ``stop`` [s] or ``duration`` [s], and the fault's own parameters.
    now : float
        Scenario time that ``start`` and ``stop`` count from [s].

    Raises
    ------
    ValueError
        Unknown fault, channel, axis or parameter; a time that is negative or ends before it starts.
    """
    fault = faults.get(kind)
    channel = str(values.get("channel", "imu" if fault.channels == ("imu",) else "attitude"))
    if channel not in CHANNEL_UNITS:
        raise ValueError(f"channel = {channel!r}: expected one of {', '.join(CHANNEL_UNITS)}")
    if channel not in fault.channels:
        raise ValueError(f"channel = {channel!r}: {kind} can be on {', '.join(fault.channels)}")
    mask = _mask(kind, fault, values)
    start, stop = _window(values, now)
    own = {name: value for name, value in values.items() if name not in RESERVED}
    law = build(fault, own, units=CHANNEL_UNITS[channel])
    return Injection(kind, channel, mask, start, stop, law)


def _mask(kind: str, fault: Any, values: Mapping[str, Any]) -> NDArray[np.bool_]:
    given = values.get("axes", values.get("axis", ()))
    if "axes" in values and "axis" in values:
        raise ValueError("axes: given twice, as axis too")
    names: list[Any] = [*given] if isinstance(given, (list, tuple)) else [given]
    if names and fault.whole_channel:
        raise ValueError(
            f"axes = {', '.join(map(str, names))}: {kind} takes the whole channel; leave axes out"
        )
    mask = np.zeros(3, dtype=bool)
    for name in names or ("x", "y", "z"):
        if not isinstance(name, str) or name not in AXES:
            raise ValueError(f"axes: {name!r} is no axis; expected roll, pitch, yaw or x, y, z")
        mask[AXES[name]] = True
    return mask


def _window(values: Mapping[str, Any], now: float) -> tuple[float, float]:
    """Start and stop in scenario time, whole nanoseconds as stamps: 0.1 s + 0.2 s is the sample at 0.3 s."""
    start = _time(values, "start", 0.0)
    if "duration" in values:
        if "stop" in values:
            raise ValueError("duration: give either duration or stop")
        duration = _time(values, "duration", math.inf)
        first, last = round(now + start, 9), round(now + start + duration, 9)
        if last <= first:
            raise ValueError(f"duration = {duration:g} s: must be positive")
        return first, last
    stop = _time(values, "stop", math.inf)
    first, last = round(now + start, 9), round(now + stop, 9)
    if last <= first:
        raise ValueError(f"stop = {stop:g} s: must be later than start = {start:g} s")
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


class _Active:
    """An injection with its state and its own random numbers."""

    def __init__(self, injection: Injection, number: int, seed: int) -> None:
        self.injection = injection
        self.state: Any = None
        self._normal, self._uniform = fault_generators(seed, number)
        self._zeros = np.zeros(3)

    def step(self, time: float, healthy: Floats, dt: float) -> tuple[Floats, bool]:
        """Return the channel (3,) at scenario time ``time`` [s] and whether it is there."""
        injection, law = self.injection, self.injection.law
        acts = injection.start <= time < injection.stop
        if not acts and not (law.has_memory and time < injection.start):
            return healthy, True
        if self.state is None:
            self.state = law.init(healthy)
        normal = uniform = self._zeros
        if law.is_random:
            normal, uniform = self._normal.standard_normal(3), self._uniform.random(3)
        inputs = FaultInputs(healthy, time - injection.start, normal, uniform)
        self.state, output = law.step(self.state, inputs, dt)
        if not acts:
            return healthy, True
        return np.where(injection.mask, output.value, healthy), bool(output.valid)


class FaultInjector:
    """All faults of one IMU: scheduled and injected at run time.

    Parameters
    ----------
    seed : int
        Of the random faults (noise, spikes, dropout).
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._active: dict[int, _Active] = {}
        self._count = 0
        self._epoch_ns: int | None = None
        self._stamp_ns = 0

    @property
    def injections(self) -> dict[int, Injection]:
        """The injections that wait or act, by number."""
        return {number: active.injection for number, active in self._active.items()}

    @property
    def active(self) -> dict[int, Injection]:
        """The injections that act on the present sample, by number."""
        now = self.now
        return {number: injection for number, injection in self.injections.items() if injection.start <= now}

    @property
    def now(self) -> float:
        """Scenario time of the last sample [s]; 0 before the first."""
        return 0.0 if self._epoch_ns is None else seconds(self._stamp_ns - self._epoch_ns)

    def add(self, injection: Injection) -> int:
        """Schedule an injection; return its number, from 1."""
        self._count += 1
        self._active[self._count] = _Active(injection, self._count, self._seed)
        return self._count

    def clear(self, number: int = 0) -> int:
        """End one injection, or all (0); return how many ended."""
        numbers = list(self._active) if number == 0 else [number] if number in self._active else []
        for known in numbers:
            del self._active[known]
        return len(numbers)

    def apply(self, stamp_ns: int, sample: ImuSample) -> Injected:
        """Put the faults on one sample of a single vehicle.

        Parameters
        ----------
        stamp_ns : int
            The sample's time [ns]; the first sample's is scenario time 0.
        """
        if self._epoch_ns is None:
            self._epoch_ns = self._stamp_ns = stamp_ns
        dt = seconds(stamp_ns - self._stamp_ns)
        self._stamp_ns = stamp_ns
        time = self.now
        zeros = np.zeros(3)
        if not self._active:
            return Injected(sample, zeros, zeros, zeros)
        self._forget_past(time)
        attitude, attitude_fault, attitude_there = self._attitude(sample, time, dt)
        gyro, gyro_there = self._channel("gyro", sample.body_rate, time, dt)
        force, force_there = self._channel("accelerometer", sample.specific_force, time, dt)
        _, imu_there = self._channel("imu", zeros, time, dt)
        faulty = ImuSample(
            q_xyzw=attitude,
            body_rate=gyro,
            specific_force=force,
            attitude_valid=sample.attitude_valid & attitude_there,
            rate_valid=sample.rate_valid & gyro_there,
            force_valid=sample.force_valid & force_there,
        )
        return Injected(
            faulty if imu_there else None,
            attitude_fault,
            np.subtract(gyro, sample.body_rate),
            np.subtract(force, sample.specific_force),
        )

    def _attitude(self, sample: ImuSample, time: float, dt: float) -> tuple[Floats, Floats, bool]:
        if not any(active.injection.channel == "attitude" for active in self._active.values()):
            return sample.q_xyzw, np.zeros(3), True
        healthy = euler_from_quaternion(sample.q_xyzw)
        angles, there = self._channel("attitude", healthy, time, dt)
        if angles is healthy:
            return sample.q_xyzw, np.zeros(3), there
        return quaternion_from_euler(angles), wrap(angles - healthy), there

    def _channel(self, channel: str, value: Floats, time: float, dt: float) -> tuple[Floats, bool]:
        there = True
        for active in self._active.values():
            if active.injection.channel == channel:
                value, valid = active.step(time, value, dt)
                there = there and valid
        return value, there

    def _forget_past(self, time: float) -> None:
        for number in [n for n, active in self._active.items() if active.injection.stop <= time]:
            del self._active[number]
