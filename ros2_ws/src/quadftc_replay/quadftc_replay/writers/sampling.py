"""What both autopilots' logs take of a flight log: samples at a rate, stamps, degrees, shares of torque."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quadftc_replay.flight_log import FlightLog, Floats, Signal
from quadftc_replay.readers.positioning import metres_per_degree

BOOT = 1.0  # s; from the start of the system to the first sample
HOME = (47.397742, 8.545594, 488.0)  # deg, deg, m; where PX4's simulations begin
UNKNOWN = (3.0, 255.0, np.nan)  # fix in space, satellites as MAVLink has it, accuracy: where nobody says
SLACK = 1e-6  # s; rounding of stamps
RPM = 30.0 / math.pi  # of 1 rad/s


def thin(signal: Signal, rate: float) -> Signal:
    """Take what is newest at each tick of a rate [Hz]; rows that lack a component are left out."""
    time, value = signal.whole()
    if not len(time):
        return Signal(time, value)
    ticks = np.arange(time[0], time[-1] + SLACK, 1.0 / rate)
    rows = np.unique(np.searchsorted(time, ticks + SLACK, side="right") - 1)
    return Signal(time[rows], value[rows])


def microseconds(time: Floats) -> NDArray[np.int64]:
    """Stamps since the start of the system [µs] (n,)."""
    return np.rint(1e6 * (time + BOOT)).astype(np.int64)


def degrees_from(position: Floats) -> Floats:
    """Latitude, longitude [deg] and height [m] (n, 3) of east, north, up from `HOME` (n, 3) [m]."""
    east, north = metres_per_degree(HOME[0])
    return HOME + position[:, [1, 0, 2]] / [north, east, 1.0]


def status_at(log: FlightLog, name: str, time: Floats) -> Floats:
    """Fix, satellites and accuracy [m] that a receiver claims (n, 3); `UNKNOWN` where it does not say."""
    status = log.gps_status.get(name)
    said = np.full((len(time), 3), np.nan) if status is None else status.at(time)
    return np.where(np.isnan(said), UNKNOWN, said)


def torque_and_thrust(log: FlightLog) -> tuple[Signal | None, Signal | None]:
    """Torque (n, 3) and thrust (n, 1) that are asked for, as shares of the greatest; None if not known.

    Where the log has the torque in N m, the commands c of rotors at places (x, y) give the shares. The share
    of roll is the sum of c y over that of |y|. Pitch takes -x in place of y, yaw the senses of rotation.
    """
    commands, places, signs = log.rotor_commands, log.rotor_positions, log.rotor_yaw_signs
    if log.torque_unit == "1" and log.torque_command is not None:
        return log.torque_command, log.thrust_command
    if commands is None or places is None or signs is None:
        return None, None
    arms = np.stack([places[:, 1], -places[:, 0], signs], axis=1)
    torque = commands.value @ arms / np.abs(arms).sum(axis=0)
    return Signal(commands.time, torque), Signal(commands.time, commands.value.mean(axis=1, keepdims=True))


def throttle_of_thrust(share: Floats, curve: float) -> Floats:
    """Share of the throttle r with (1 - c) r + c r² = share; the way back of `thrust_of_throttle`."""
    return (np.sqrt((1.0 - curve) ** 2 + 4.0 * curve * share) - (1.0 - curve)) / (2.0 * curve)


def heading(velocity: Floats) -> Floats:
    """Course over ground (n,), clockwise from north [deg], of a velocity east, north, up (n, 3)."""
    return np.degrees(np.arctan2(velocity[:, 0], velocity[:, 1])) % 360.0
