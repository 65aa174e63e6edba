"""Where a vehicle is by satellites and by the pressure of the air.

A receiver's position counts in metres from its first fix in space, by the radii of curvature of WGS 84 there.
Height by pressure is that of the standard atmosphere (ISO 2533).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from quadftc_replay.flight_log import Floats
from quadftc_replay.readers.signals import Signals, Stamps
from quadftc_sim.barometer import standard_height

SEMI_MAJOR, ECCENTRICITY_SQUARED = 6_378_137.0, 6.694379990e-3  # m, 1; of WGS 84
IN_SPACE = 3  # fix with which a position has a height, as NMEA and MAVLink count


class Fixes(NamedTuple):
    """What a receiver says, sample by sample; NaN where it does not say."""

    latitude: Floats  # (n,) [deg]
    longitude: Floats  # (n,) [deg]
    height: Floats  # (n,) [m]
    velocity: Floats  # (n, 3) [m/s], east, north, up
    fix: Floats  # (n,)
    satellites: Floats  # (n,)
    accuracy: Floats  # (n,) standard deviation of the position [m]


def add_receiver(signals: Signals, stamp_ns: Stamps, said: Fixes, source: str, name: str = "") -> None:
    """Add position, velocity and status of a receiver; what it says without a fix in space is left out."""
    fixed = np.isfinite(said.latitude) & np.isfinite(said.longitude)
    fixed &= ~(said.fix < IN_SPACE) & ((said.latitude != 0.0) | (said.longitude != 0.0))
    position = np.where(fixed[:, None], _local(said, fixed), np.nan)
    signals.add("gps_positions", stamp_ns, position, source, name)
    velocity = np.where(fixed[:, None], said.velocity, np.nan)
    if np.any(np.nan_to_num(velocity)):
        signals.add("gps_velocities", stamp_ns, velocity, source, name)
    status = np.stack([said.fix, said.satellites, said.accuracy], axis=-1)
    signals.add("gps_status", stamp_ns, status, source, name)


def _local(said: Fixes, fixed: np.ndarray) -> Floats:
    """East, north and up from the first fix (n, 3) [m]."""
    if not fixed.any():
        return np.full((len(fixed), 3), np.nan)
    first = int(np.argmax(fixed))
    turned = (said.longitude - said.longitude[first] + 180.0) % 360.0 - 180.0
    away = np.stack([turned, said.latitude - said.latitude[first]], axis=-1)
    metres = metres_per_degree(float(said.latitude[first]))
    return np.column_stack([away * metres, said.height - said.height[first]])


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Return how far a degree of longitude and one of latitude reach at a latitude [deg]."""
    angle = math.radians(latitude)
    flattened = 1.0 - ECCENTRICITY_SQUARED * math.sin(angle) ** 2
    east = SEMI_MAJOR / math.sqrt(flattened) * math.cos(angle)
    north = SEMI_MAJOR * (1.0 - ECCENTRICITY_SQUARED) / flattened**1.5
    return math.radians(east), math.radians(north)


def pressure_height(pressure: ArrayLike) -> Floats:
    """Return the height [m] of a pressure [Pa]; NaN where it is none."""
    value = np.asarray(pressure, np.float64)
    return np.asarray(standard_height(np.where(value > 0.0, value, np.nan)))
