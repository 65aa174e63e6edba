"""Inputs of the steps of a batch: times, samples that arrive, and random numbers as of each flight alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.loop_step import Delivery, FirstDraws, StepInputs, Times
from quadftc_campaign.batch.parts import FlightParts
from quadftc_model.stepper import MAX_GAP, NANOSECONDS_PER_SECOND, seconds
from quadftc_sim.fault import FaultInputs
from quadftc_sim.injection import Injection, fault_generators
from quadftc_sim.injector import FaultDraws
from quadftc_sim.sensor_draws import DRAWS, PLACE, WHITE, SensorDraws, TurnOn

# samples (n,) for which a fault is stepped, and its normal and uniform numbers, (2, n, 3)
FaultNumbers = tuple[NDArray[np.int64], NDArray[np.float64]]
ALL_DRAWS = (True,) * DRAWS[0]  # see `quadftc_sim.sensor_draws`


class InputSource:
    """Inputs of the steps of a block of flights of one structure, in the order of the samples."""

    def __init__(self, flights: Sequence[FlightParts], dtype: np.dtype[Any]) -> None:
        self._loop, self._dtype = flights[0].loop, dtype
        self._random = [SensorDraws(flight.seed) for flight in flights]
        turn_on = zip(*(each.turn_on for each in self._random), strict=True)
        imu = TurnOn(*(np.stack(column, axis=-1).astype(dtype) for column in turn_on))
        place = self._draw_place(1)
        self.first = FirstDraws(imu, None if place is None else place[0])  # (..., flights)
        # a fault of the whole IMU acts before the flight, in the delivery
        self._faults = [
            [_draw_fault(flight, place) for flight in flights]
            if fault.law.is_random and fault.channel != "imu"
            else None
            for place, fault in enumerate(self._loop.injections)
        ]
        self._delivery = _delivery(flights, dtype)
        self._index = 0

    def next(self, count: int, needed: Sequence[bool] = ALL_DRAWS) -> tuple[StepInputs, Times]:
        """Return the inputs of ``count`` samples, (count, ..., flights); draws not ``needed`` are zero."""
        index = self._index + np.arange(count)
        self._index += count
        taken = index - self._loop.sensor.delay
        faults = tuple(
            None if each is None else self._between(each, int(taken[0]), count) for each in self._faults
        )
        stamps_ns = (np.maximum(each, 0) * self._loop.period_ns for each in (index - 1, index, taken))
        before, now, then = ((each / NANOSECONDS_PER_SECOND).astype(self._dtype) for each in stamps_ns)
        delivery = self._delivery
        if delivery is not None:
            rows = np.clip(taken, 0, len(delivery.arrives) - 1)
            delivery = Delivery(*(each[rows] for each in delivery))
        due = None if self._loop.place is None else index % self._loop.place.every == 0
        drawn = StepInputs(self._draw(count, needed), faults, delivery, self._draw_place(count))
        return drawn, Times(before, now, then, due)

    def _draw_place(self, count: int) -> NDArray[Any] | None:
        """Draw the numbers of the position sensor, (count, rows, 3, flights); None without one."""
        if self._loop.place is None:
            return None
        drawn = np.empty((count, PLACE, 3, len(self._random)), self._dtype)
        for flight, random in enumerate(self._random):
            drawn[..., flight] = random.next_place(count)
        return drawn

    def _draw(self, count: int, needed: Sequence[bool]) -> tuple[NDArray[Any], ...]:
        """Draw the sensors' numbers; those that nothing needs are zero."""
        shape = (count, 3, len(self._random))
        unused = np.broadcast_to(np.zeros((), self._dtype), shape)
        blocks = tuple(np.empty(shape, self._dtype) if need else unused for need in needed)
        slow = any(needed[WHITE:])  # a stream is drawn whole, or not at all
        for flight, random in enumerate(self._random):
            numbers = random.next(count, slow)
            for kind, block in enumerate(blocks):
                if block is not unused:
                    block[:, :, flight] = numbers[:, kind]
        return blocks

    def _between(self, drawn: Sequence[FaultNumbers], start: int, count: int) -> FaultDraws:
        """Return the numbers of an injection for ``count`` samples, (count, 3, flights); 0 if unused."""
        numbers = np.zeros((2, count, 3, len(drawn)))
        for flight, (rows, values) in enumerate(drawn):
            chosen = slice(*np.searchsorted(rows, (start, start + count)))
            numbers[..., flight][:, rows[chosen] - start] = values[:, chosen]
        return FaultDraws(*numbers.astype(self._dtype))


def _delivery(flights: Sequence[FlightParts], dtype: np.dtype[Any]) -> Delivery | None:
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
    dt = np.where(restarts | ~arrives, seconds(period), dt)
    elapsed = np.maximum(stamps - first, 0) / NANOSECONDS_PER_SECOND
    return Delivery(arrives, dt.astype(dtype), restarts, elapsed.astype(dtype))


def _arrivals(flight: FlightParts) -> NDArray[np.bool_]:
    """Step the faults of the whole IMU through a flight: which of its samples arrive."""
    loop = flight.loop
    arrives = np.ones(loop.count, np.bool_)
    for place, (injection, number) in enumerate(zip(loop.injections, flight.fault_numbers, strict=True)):
        if injection.channel != "imu" or number == 0:
            continue
        rows, draws = _draw_fault(flight, place)
        state = injection.law.init(np.zeros(3))
        for row, normal, uniform in zip(rows.tolist(), *draws, strict=True):
            time = row * loop.period_ns / NANOSECONDS_PER_SECOND
            inputs = FaultInputs(np.zeros(3), time - injection.start, normal, uniform)
            state, output = injection.law.step(state, inputs, seconds(loop.period_ns))
            if time >= injection.start:
                arrives[row] &= bool(output.valid)
    return arrives


def _draw_fault(flight: FlightParts, place: int) -> FaultNumbers:
    """Draw the random numbers of an injection for a whole flight."""
    injection: Injection = flight.loop.injections[place]
    time = np.arange(flight.loop.count) * flight.loop.period_ns / NANOSECONDS_PER_SECOND
    steps = time < injection.stop
    if not injection.law.has_memory:
        steps &= injection.start <= time
    rows = np.flatnonzero(steps)
    normal, uniform = fault_generators(flight.seed, flight.fault_numbers[place])
    return rows, np.stack([normal.standard_normal((len(rows), 3)), uniform.random((len(rows), 3))])
