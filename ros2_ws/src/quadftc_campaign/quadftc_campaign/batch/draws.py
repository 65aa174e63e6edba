"""The random numbers and the withheld samples of a batch: those that each flight would have alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.parts import FlightParts
from quadftc_model.stepper import MAX_GAP, NANOSECONDS_PER_SECOND
from quadftc_sim.fault import FaultInputs
from quadftc_sim.injection import Injection, fault_generators
from quadftc_sim.sensors import DRAWS

Floats = NDArray[np.float64]


class SensorDraws:
    """Random numbers of the IMUs of some flights, in the order of the samples.

    Parameters
    ----------
    flights : sequence of FlightParts
    """

    def __init__(self, flights: Sequence[FlightParts]) -> None:
        self._generators = [np.random.default_rng(flight.seeds.sensor) for flight in flights]
        self.bias = np.stack(
            [each.uniform(-1.0, 1.0, 3) for each in self._generators], axis=-1
        )  # (3, flights)

    def next(
        self, count: int, wanted: Sequence[bool], dtype: np.dtype[np.floating]
    ) -> list[NDArray[np.floating] | None]:
        """Draw for ``count`` samples.

        Parameters
        ----------
        count : int
        wanted : sequence of bool
            Which of attitude, gyro, accelerometer, bias; the others are drawn and thrown away.
        dtype : dtype

        Returns
        -------
        list
            (count, 3, flights) or None for each of the four.
        """
        flights = len(self._generators)
        found: list[NDArray[np.floating] | None] = [
            np.empty((count, 3, flights), dtype) if want else None for want in wanted
        ]
        numbers = np.empty((count, *DRAWS))
        for index, generator in enumerate(self._generators):
            generator.standard_normal(out=numbers)
            for kind, block in enumerate(found):
                if block is not None:
                    block[:, :, index] = numbers[:, kind]
        return found


class Withheld(NamedTuple):
    """When the samples of a batch come, each (samples, flights); a row for each sample taken."""

    comes: NDArray[np.bool_]
    dt: Floats  # since the last one that came [s]
    anew: NDArray[np.bool_]  # the first, or after a gap over which nothing is carried
    elapsed: Floats  # since the first one that came [s]


def withheld(flights: Sequence[FlightParts]) -> Withheld | None:
    """Find the samples that faults of the whole IMU withhold; None if there are no such faults."""
    if not any(injection.channel == "imu" for flight in flights for injection in flight.loop.injections):
        return None
    comes = np.stack([_comes(flight) for flight in flights], axis=-1)
    period = flights[0].loop.period_ns
    stamps = (np.arange(len(comes)) * period)[:, None]
    before = np.maximum.accumulate(np.where(comes, stamps, -1), axis=0)
    last = np.vstack([np.full((1, len(flights)), -1), before[:-1]])
    first = np.where(comes.any(axis=0), np.argmax(comes, axis=0) * period, 0)
    dt = (stamps - last) / NANOSECONDS_PER_SECOND
    anew = comes & ((last < 0) | (dt > MAX_GAP))
    elapsed = np.maximum(stamps - first, 0) / NANOSECONDS_PER_SECOND
    return Withheld(comes, np.where(anew | ~comes, period / NANOSECONDS_PER_SECOND, dt), anew, elapsed)


def _comes(flight: FlightParts) -> NDArray[np.bool_]:
    loop = flight.loop
    comes = np.ones(loop.count, np.bool_)
    for injection, number in zip(loop.injections, flight.seeds.numbers, strict=True):
        if injection.channel != "imu" or number == 0:
            continue
        rows = _rows(flight, injection)
        normal, uniform = _fault_numbers(flight, number, len(rows))
        state = injection.law.init(np.zeros(3))
        for index, row in enumerate(rows):
            time = row * loop.period_ns / NANOSECONDS_PER_SECOND
            inputs = FaultInputs(np.zeros(3), time - injection.start, normal[index], uniform[index])
            state, output = injection.law.step(state, inputs, loop.period_ns / NANOSECONDS_PER_SECOND)
            if time >= injection.start:
                comes[row] &= bool(output.valid)
    return comes


class FaultNumbers:
    """Random numbers of one injection in all flights of a batch.

    Parameters
    ----------
    flights : sequence of FlightParts
    place : int
        Of the injection.
    """

    def __init__(self, flights: Sequence[FlightParts], place: int) -> None:
        self._rows = [_rows(flight, flight.loop.injections[place]) for flight in flights]
        numbers = [flight.seeds.numbers[place] for flight in flights]
        self._values = [
            _fault_numbers(flight, number, len(rows))
            for flight, number, rows in zip(flights, numbers, self._rows, strict=True)
        ]

    def between(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Normal and uniform numbers (samples, 3, flights) from ``start`` to ``stop``; 0 if unused."""
        normal = np.zeros((stop - start, 3, len(self._rows)))
        uniform = np.zeros_like(normal)
        for flight, (rows, values) in enumerate(zip(self._rows, self._values, strict=True)):
            if len(rows) == 0:
                continue
            first, last = max(start, int(rows[0])), min(stop, int(rows[-1]) + 1)
            if first < last:
                here = slice(first - start, last - start)
                there = slice(first - int(rows[0]), last - int(rows[0]))
                normal[here, :, flight], uniform[here, :, flight] = values[0][there], values[1][there]
        return normal, uniform


def _rows(flight: FlightParts, injection: Injection) -> NDArray[np.int64]:
    """The samples for which a fault is stepped."""
    time = np.arange(flight.loop.count) * flight.loop.period_ns / NANOSECONDS_PER_SECOND
    runs = time < injection.stop
    if not injection.law.has_memory:
        runs &= injection.start <= time
    return np.flatnonzero(runs)


def _fault_numbers(flight: FlightParts, number: int, count: int) -> tuple[Floats, Floats]:
    normal, uniform = fault_generators(flight.seeds.injector, number)
    return normal.standard_normal((count, 3)), uniform.random((count, 3))
