"""A flight log of any format: every signal on its own clock, in SI units and in the axes of REP-103.

A reader converts units and axes once. What the log lacks is missing here, too; nothing is filled in, and no
clock is resampled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
MAIN = ""  # name of the first or only sensor of its kind; others are named by the log, such as "2"


class Event(NamedTuple):
    """What the autopilot itself said."""

    time: float  # since the first sample of the log [s]
    source: str  # such as "MSG", "ERR", "failure_detector_status"
    text: str


class Watched(NamedTuple):
    """A signal that has a limit: the autopilot's own, or that of the log."""

    name: str  # as a sentence begins: "EKF innovation of the height"
    signal: Signal  # (n, 1)
    limit: float
    unit: str = ""
    is_least: bool = False  # the limit is the least that is good, not the most


class Signal(NamedTuple):
    """One signal; samples in the order of their times, which increase strictly."""

    time: Floats  # (n,) since the first sample of the log [s]
    value: Floats  # (n, k); NaN where a sample lacks a component

    def __len__(self) -> int:
        return len(self.time)

    @property
    def rate(self) -> float:
        """One over the median time between two samples [Hz]; 0 for less than two."""
        return 1.0 / float(np.median(np.diff(self.time))) if len(self) > 1 else 0.0

    def whole(self) -> Signal:
        """Its samples that lack no component."""
        rows = np.isfinite(self.value).all(axis=1)
        return Signal(self.time[rows], self.value[rows])

    def integral(self) -> Signal:
        """Its integral since the first sample, straight between samples; what is not known counts as zero."""
        means = 0.5 * (self.value[1:] + self.value[:-1]) * np.diff(self.time)[:, None]
        total = np.concatenate([np.zeros((1, means.shape[1])), np.nancumsum(means, axis=0)])
        return Signal(self.time, total)

    def at(self, time: Floats) -> Floats:
        """Values at other times (m, k), straight between samples; beyond them the nearest."""
        width = self.value.shape[1]
        return np.stack([np.interp(time, self.time, self.value[:, k]) for k in range(width)], axis=-1)


@dataclass(frozen=True, eq=False, kw_only=True)
class FlightLog:
    """What a log holds that a diagnosis can use. Axes: forward, left, up; east, north, up."""

    path: Path
    format: str  # such as "rosbag2", "ULog", "ArduPilot BIN", "Crazyflie uSD"
    start_ns: int = 0  # stamp of the first sample on the clock of the log [ns]
    gyros: Mapping[str, Signal] = field(default_factory=dict[str, Signal])  # name: (n, 3) [rad/s]
    accelerometers: Mapping[str, Signal] = field(default_factory=dict[str, Signal])  # name: (n, 3) [m/s²]
    magnetometers: Mapping[str, Signal] = field(default_factory=dict[str, Signal])  # name: (n, 3)
    field_unit: str = "mG"  # of the magnetometers; "": not known
    barometers: Mapping[str, Signal] = field(default_factory=dict[str, Signal])  # name: (n, 1) height [m]
    # of each satellite receiver, east, north, up: from its first fix [m], and as it measures it [m/s]
    gps_positions: Mapping[str, Signal] = field(default_factory=dict[str, Signal])  # name: (n, 3)
    gps_velocities: Mapping[str, Signal] = field(default_factory=dict[str, Signal])  # name: (n, 3)
    # fix (as NMEA and MAVLink count: 3 is in space), satellites, standard deviation that it claims [m]
    gps_status: Mapping[str, Signal] = field(default_factory=dict[str, Signal])  # name: (n, 3)
    attitude: Signal | None = None  # (n, 4) quaternion x, y, z, w, body to earth
    attitude_from_gyro: bool | None = None  # whether it is computed from a gyro of this log; None: not known
    body_rate: Signal | None = None  # (n, 3) [rad/s]: estimated rate, where no gyro is logged
    position: Signal | None = None  # (n, 3) [m]
    velocity: Signal | None = None  # (n, 3) [m/s]
    acceleration: Signal | None = None  # (n, 3) [m/s²]: estimated, without gravity, earth axes
    flown_position: Signal | None = None  # (n, 3) [m]: what the position controller takes for the position
    flown_acceleration: Signal | None = None  # (n, 2) [m/s²]: and for the acceleration, east and north
    rotor_speeds: Signal | None = None  # (n, rotors), measured [rad/s]
    rotor_commands: Signal | None = None  # (n, rotors), 0 to 1: what the autopilot takes for shares of thrust
    torque_command: Signal | None = None  # (n, 3) [torque_unit]
    torque_unit: str = "N m"  # or "1": shares of the greatest torque, of each axis
    thrust_command: Signal | None = None  # (n, 1), in any unit
    battery: Signal | None = None  # (n, 1) [V]
    vibration: Signal | None = None  # (n, 3), or (n, 1) of all axes [m/s²]: root mean square, before filters
    clips: Signal | None = None  # (n, 1): samples of an accelerometer at its limit, since the start
    vehicle: str = ""  # name of the vehicle file, where the log says it
    rotor_positions: Floats | None = None  # (rotors, 2) [m], or directions alone
    rotor_yaw_signs: Floats | None = None  # (rotors,) of the reaction torque about z
    watched: tuple[Watched, ...] = ()
    events: tuple[Event, ...] = ()  # in the order of their times
    incomplete: str = ""  # what of the log is missing, as it was cut or damaged; empty: nothing
    notes: tuple[str, ...] = ()  # one line each: what was left out, what is damaged, what was assumed

    @property
    def gps_velocity(self) -> Signal | None:
        """Velocity of the first satellite receiver that measures all of it (n, 3) [m/s]; None: of none."""
        whole = (each for each in self.gps_velocities.values() if np.isfinite(each.value).any(axis=0).all())
        return next(whole, None)

    @property
    def end(self) -> float:
        """Time of the last sample of all signals [s]."""
        held: list[Any] = [getattr(self, each.name) for each in fields(self)]
        signals = [each for each in held if isinstance(each, Signal)]
        for named in held:
            signals += named.values() if isinstance(named, dict) else ()
        return max((float(each.time[-1]) for each in signals if len(each)), default=0.0)
