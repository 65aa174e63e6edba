"""Stretches in which the vehicle stands still: what a sensor reads then is known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.whitening import Floats

LASTS = 2.0  # s


class Rest(NamedTuple):
    """A stretch at rest."""

    start: float  # s
    end: float  # s
    mean: Floats  # (3,) what the sensor reads


def rests_of(flight: Flight, sensor: Signal, scatter: float) -> list[Rest]:
    """Find blocks of `LASTS` in which a sensor (n, 3) scatters by less, and the vehicle does not fly."""
    count = round(LASTS * sensor.rate)
    if count < 10 or len(sensor) < count:
        return []
    blocks = len(sensor) // count
    values = sensor.value[: blocks * count].reshape(blocks, count, -1)
    times = sensor.time[: blocks * count].reshape(blocks, count)
    quiet = (values.std(axis=1) < scatter).all(axis=1)
    if flight.phases_known:
        quiet &= ~flight.in_flight(times.ravel()).reshape(times.shape).any(axis=1)
    return [
        Rest(float(times[k, 0]), float(times[k, -1]), values[k].mean(axis=0)) for k in np.flatnonzero(quiet)
    ]
