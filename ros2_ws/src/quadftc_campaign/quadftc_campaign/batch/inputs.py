"""Inputs of the steps of a batch: times, random numbers, and which samples arrive.

The random numbers are those that each flight would draw alone, from NumPy's generators.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.loop_step import Delivery, StepInputs, Times
from quadftc_campaign.batch.parts import FlightParts
from quadftc_model.stepper import MAX_GAP, NANOSECONDS_PER_SECOND
from quadftc_sim.fault import FaultInputs
from quadftc_sim.injection import Injection, fault_generators
from quadftc_sim.injector import FaultDraws
from quadftc_sim.sensors import DRAWS


class InputSource:
    """Inputs of the steps of a block of flights, in the order of the samples.

    Parameters
    ----------
    flights : sequence of FlightParts
        Of one structure.
    dtype : dtype
        Of all floats.
    needed : sequence of bool
        Which of the draws for attitude, gyro, accelerometer and gyro bias change anything.
    """

    def __init__(self, flights: Sequence[FlightParts], dtype: np.dtype[Any], needed: Sequence[bool]) -> None:
        self._loop = flights[0].loop
        self._dtype = dtype
        self._needed = needed
        self._generators = [np.random.default_rng(flight.seeds.sensor) for flight in flights]
        bias = np.stack([each.uniform(-1.0, 1.0, 3) for each in self._generators], axis=-1)
        self.bias = bias.astype(dtype)  # (3, flights)
        self._faults = [
            _FaultNumbers(flights, place) if is_random(injection) else None
            for place, injection in enumerate(self._loop.injections)
        ]
        self._delivery = _delivery(flights)
        self._index = 0

    def next(self, count: int, every: bool = False) -> tuple[StepInputs, Times]:
        """Return what ``count`` samples need, or all of it (``every``): arrays (count, ..., flights)."""
        dtype, index = self._dtype, self._index + np.arange(count)
        self._index += count
        taken = index - self._loop.sensor.delay
        start, stop = int(taken[0]), int(taken[-1]) + 1
        faults = tuple(each.between(start, stop, dtype) if each else None for each in self._faults)
        period = self._loop.period_ns
        before, now, of_sample = (
            (np.maximum(each, 0) * period / NANOSECONDS_PER_SECOND).astype(dtype)
            for each in (index - 1, index, taken)
        )
        delivery = self._delivery
        if delivery is not None:
            rows = np.clip(taken, 0, len(delivery.arrives) - 1)
            delivery = Delivery(
                delivery.arrives[rows],
                delivery.dt[rows].astype(dtype),
                delivery.restarts[rows],
                delivery.elapsed[rows].astype(dtype),
            )
        inputs = StepInputs(self._draw(count, every), faults, delivery)
        return inputs, Times(before, now, of_sample)

    def _draw(self, count: int, every: bool) -> tuple[NDArray[Any], ...]:
        """Draw the sensors' numbers; those that nothing needs are drawn too, and replaced by zeros."""
        flights = len(self._generators)
        unused = np.broadcast_to(np.zeros((), self._dtype), (count, 3, flights))
        blocks = tuple(
            np.empty((count, 3, flights), self._dtype) if every or need else unused for need in self._needed
        )
        numbers = np.empty((count, *DRAWS))
        for flight, generator in enumerate(self._generators):
            generator.standard_normal(out=numbers)
            for kind, block in enumerate(blocks):
                if block is not unused:
                    block[:, :, flight] = numbers[:, kind]
        return blocks


def is_random(injection: Injection) -> bool:
    """Whether a step needs random numbers for a fault; one of the whole IMU acts before the flight."""
    return injection.law.is_random and injection.channel != "imu"


class _FaultNumbers:
    """Random numbers of one injection in all flights of a block."""

    def __init__(self, flights: Sequence[FlightParts], place: int) -> None:
        self._rows = [_stepped_rows(flight, flight.loop.injections[place]) for flight in flights]
        self._values = [
            _draw_fault(flight, flight.seeds.numbers[place], len(rows))
            for flight, rows in zip(flights, self._rows, strict=True)
        ]

    def between(self, start: int, stop: int, dtype: np.dtype[Any]) -> FaultDraws:
        """Return those of the samples from ``start`` to ``stop``, (samples, 3, flights); 0 if unused."""
        normal, uniform = np.zeros((2, stop - start, 3, len(self._rows)))
        for flight, (rows, values) in enumerate(zip(self._rows, self._values, strict=True)):
            chosen = slice(*np.searchsorted(rows, (start, stop)))
            normal[rows[chosen] - start, :, flight] = values[0][chosen]
            uniform[rows[chosen] - start, :, flight] = values[1][chosen]
        return FaultDraws(normal.astype(dtype), uniform.astype(dtype))


def _delivery(flights: Sequence[FlightParts]) -> Delivery | None:
    """Find the samples (samples, flights) that faults of the whole IMU withhold; None without such faults."""
    if not any(injection.channel == "imu" for flight in flights for injection in flight.loop.injections):
        return None
    arrives = np.stack([_arrivals(flight) for flight in flights], axis=-1)
    period = flights[0].loop.period_ns
    stamps = (np.arange(len(arrives)) * period)[:, None]
    newest = np.maximum.accumulate(np.where(arrives, stamps, -1), axis=0)
    last = np.vstack([np.full((1, len(flights)), -1), newest[:-1]])  # stamp of the one before; -1: none
    first = np.where(arrives.any(axis=0), np.argmax(arrives, axis=0) * period, 0)
    dt = (stamps - last) / NANOSECONDS_PER_SECOND
    restarts = arrives & ((last < 0) | (dt > MAX_GAP))
    dt = np.where(restarts | ~arrives, period / NANOSECONDS_PER_SECOND, dt)
    return Delivery(arrives, dt, restarts, np.maximum(stamps - first, 0) / NANOSECONDS_PER_SECOND)


def _arrivals(flight: FlightParts) -> NDArray[np.bool_]:
    """Step the faults of the whole IMU through a flight: which of its samples arrive."""
    loop, dt = flight.loop, flight.loop.period_ns / NANOSECONDS_PER_SECOND
    arrives = np.ones(loop.count, np.bool_)
    for injection, number in zip(loop.injections, flight.seeds.numbers, strict=True):
        if injection.channel != "imu" or number == 0:
            continue
        rows = _stepped_rows(flight, injection)
        draws = zip(*_draw_fault(flight, number, len(rows)), strict=True)
        state = injection.law.init(np.zeros(3))
        for row, (normal, uniform) in zip(rows, draws, strict=True):
            time = row * loop.period_ns / NANOSECONDS_PER_SECOND
            inputs = FaultInputs(np.zeros(3), time - injection.start, normal, uniform)
            state, output = injection.law.step(state, inputs, dt)
            if time >= injection.start:
                arrives[row] &= bool(output.valid)
    return arrives


def _stepped_rows(flight: FlightParts, injection: Injection) -> NDArray[np.int64]:
    """The samples for which a fault is stepped."""
    time = np.arange(flight.loop.count) * flight.loop.period_ns / NANOSECONDS_PER_SECOND
    steps = time < injection.stop
    if not injection.law.has_memory:
        steps &= injection.start <= time
    return np.flatnonzero(steps)


def _draw_fault(
    flight: FlightParts, number: int, count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    normal, uniform = fault_generators(flight.seeds.injector, number)
    return normal.standard_normal((count, 3)), uniform.random((count, 3))
