"""What is brought to the steps of a batch: times, random numbers, and which samples come."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.compiled import Brought, Structure, Times
from quadftc_campaign.batch.draws import FaultNumbers, SensorDraws, Withheld, withheld
from quadftc_campaign.batch.loop import Delivery
from quadftc_campaign.batch.parts import FlightParts
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_sim.injection_step import FaultDraws


class Supply:
    """What is brought to the steps of a block of flights, in the order of the samples.

    Parameters
    ----------
    flights : sequence of FlightParts
        Of one structure.
    structure : Structure
    needed : Brought
        Which of it decides anything.
    """

    def __init__(self, flights: Sequence[FlightParts], structure: Structure, needed: Brought) -> None:
        self._structure = structure
        self._needed = needed
        self._sensors = SensorDraws(flights)
        self.bias = self._sensors.bias.astype(structure.dtype)
        self._faults = [
            FaultNumbers(flights, place) if injection.law.is_random and injection.channel != "imu" else None
            for place, injection in enumerate(structure.loop.injections)
        ]
        self._withheld = withheld(flights) if structure.loses else None
        self._flights = len(flights)
        self._at = 0

    def next(self, count: int, every: bool = False) -> tuple[Brought, Times]:
        """Bring what ``count`` samples need, arrays (count, ..., flights); or everything (``every``)."""
        dtype, flights = self._structure.dtype, self._flights
        at, delay = self._at, self._structure.loop.sensor.delay
        self._at += count
        wanted = [every or need for need in self._needed.draws]
        drawn = self._sensors.next(count, wanted, dtype)
        unused = np.broadcast_to(np.zeros((), dtype), (count, 3, flights))
        draws = tuple(unused if block is None else block for block in drawn)
        taken = np.arange(at - delay, at + count - delay)
        faults = tuple(
            None
            if each is None
            else FaultDraws(*(part.astype(dtype) for part in each.between(taken[0], taken[-1] + 1)))
            for each in self._faults
        )
        period = self._structure.loop.period_ns
        times = [
            (np.maximum(index, 0) * period / NANOSECONDS_PER_SECOND).astype(dtype)
            for index in (taken + delay - 1, taken + delay, taken)
        ]
        delivery = None if self._withheld is None else _delivery(self._withheld, taken, dtype)
        return Brought(draws, faults, delivery), Times(*times)


def _delivery(lost: Withheld, taken: NDArray[np.int64], dtype: np.dtype[Any]) -> Delivery:
    rows = np.clip(taken, 0, len(lost.comes) - 1)
    return Delivery(
        lost.comes[rows], lost.dt[rows].astype(dtype), lost.anew[rows], lost.elapsed[rows].astype(dtype)
    )
