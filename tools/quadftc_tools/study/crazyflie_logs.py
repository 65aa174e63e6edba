"""Logs of a Crazyflie's uSD card as samples for an observer, with the acceleration that the torque gives.

Per axis, with the commanded torque per inertia u [rad/s²] and the rotors' lag T of the vehicle's file,

    v' = (u - v) / T

`Recorded.drive` is the mean of v since the sample before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import BagError
from quadftc_model.arrays import AnyArray
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.rotors import torque_from_commands
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.readers.crazyflie import ANGLES, FIRST, QUATERNIONS, Source
from quadftc_replay.readers.signals import columns as stack
from quadftc_replay.usdlog import read_usdlog

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

VEHICLE = "crazyflie_2x"
STALE = 10  # rows; the first few of a log are older than their stamps
TURNING = 0.2  # 1; mean motor command of rotors that turn
TAKE_OFF = 1.5  # s; from motors on to flight
CRASH, BEFORE = 0.5, 0.3  # rad/s between two rows; s, how long before it counts as the ground
THRUST, FULL_THRUST = "controller.cmd_thrust", 65535.0  # of logs without motor commands


class Recorded(NamedTuple):
    """A recorded flight as samples."""

    time: Floats  # (n,) [s]
    gyro: Floats  # (n, 3) [rad/s]
    q_xyzw: Floats | None  # (n, 4)
    drive: Floats  # (n, 3) mean acceleration by the torque since the row before [rad/s²]
    flying: Mask  # (n,)


def read_driven(path: Path, attitude: bool) -> Recorded:
    """Read a log with torques, or with motor commands for the mixer of the vehicle's file."""
    time, rate, columns = _read_event(path)
    vehicle, motors = load_vehicle(VEHICLE), _take(columns, FIRST["rotor_commands"])
    torque = _take(columns, FIRST["torque_command"])
    if torque is None:
        if motors is None:
            raise BagError(f"{path}: neither torque nor motor commands; expected one of them")
        torque = torque_from_commands(vehicle, motors)
    drive = lagged_torque(time, torque / vehicle.inertia, vehicle.rotors.time_constant)
    q_xyzw = _take(columns, QUATERNIONS) if attitude else None
    if attitude and q_xyzw is None and (angles := _take(columns, ANGLES)) is not None:
        q_xyzw = quaternion_from_euler(angles)
    return Recorded(time, rate, q_xyzw, np.vstack([np.zeros(3), drive]), in_flight(time, rate, motors))


def read_without_torque(path: Path) -> Recorded:
    """Read a log that has body rates and a thrust command; its flight is while the thrust is first on."""
    time, rate, columns = _read_event(path)
    if THRUST not in columns:
        raise BagError(f"{path}: no {THRUST}")
    on = np.asarray(columns[THRUST]) / FULL_THRUST > TURNING
    first = int(np.argmax(on))
    landed = time[first + int(np.argmin(on[first:]))]
    flying = (time > time[first] + TAKE_OFF) & (time < landed)
    return Recorded(time, rate, None, np.zeros_like(rate), flying)


def _read_event(path: Path) -> tuple[Floats, Floats, Mapping[str, AnyArray]]:
    """Return time [s], body rate and variables of the event that has most rows of a body rate."""
    events = read_usdlog(path).events.values()
    fit = [event for event in events if _take(event.columns, FIRST["gyros"]) is not None]
    if not fit:
        raise BagError(f"{path}: no body rate")
    stamp_ns, columns = max(fit, key=lambda event: len(event.stamp_ns))
    good = np.diff(stamp_ns, prepend=stamp_ns[0] - 1) > 0
    if (np.diff(stamp_ns) < 0).any():
        raise BagError(f"{path}: time goes back")
    columns = {name: values[good] for name, values in columns.items()}
    rate = _take(columns, FIRST["gyros"])
    assert rate is not None  # the event was chosen so
    return (stamp_ns[good] - stamp_ns[0]) / NANOSECONDS_PER_SECOND, rate, columns


def _take(columns: Mapping[str, AnyArray], sources: Sequence[Source]) -> Floats | None:
    """Return the first of some sources that was logged, scaled to SI."""
    found = next((source for source in sources if all(name in columns for name in source.names)), None)
    return None if found is None else stack(columns, found.names) * found.scale


def in_flight(time: Floats, rate: Floats, motors: Floats | None) -> Mask:
    """Return the rows in flight: those between take-off and crash, where motors tell; (n,)."""
    flying = np.arange(len(time)) >= STALE
    if motors is None:
        return flying
    turning = np.flatnonzero(motors.mean(axis=1) > TURNING)
    crashes = time[1:][np.abs(np.diff(rate, axis=0)).max(axis=1) > CRASH]
    end = min(crashes[0] - BEFORE if len(crashes) else np.inf, time[turning[-1]])
    return flying & (time > time[turning[0]] + TAKE_OFF) & (time < end)


def lagged_torque(time: Floats, torque: Floats, lag: float) -> Floats:
    """Mean of v between each row and the next (n - 1, 3) [rad/s²].

    ``torque`` is per inertia (n, 3), held from row to row; the rotors have settled on it at the first.
    """
    steps = np.diff(time)
    settled = torque[0].copy()
    means = np.empty((len(steps), 3))
    for row, dt in enumerate(steps.tolist()):
        error, share = torque[row] - settled, dt / lag
        means[row] = torque[row] + error * np.expm1(-share) / share
        settled -= error * np.expm1(-share)
    return means
