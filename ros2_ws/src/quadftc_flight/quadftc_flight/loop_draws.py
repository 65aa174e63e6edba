"""Times and random numbers of a flight, as the nodes of the graph draw them, for many samples at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.loop import ClosedLoop, LoopInputs
from quadftc_model.arrays import rows_of
from quadftc_model.stepper import NANOSECONDS_PER_SECOND, seconds
from quadftc_sim.injection import Injection, fault_generators
from quadftc_sim.injector import FaultDraws
from quadftc_sim.rotor_fault import ROTOR
from quadftc_sim.sensor_draws import Due, SampleDraws, SensorDraws


class FaultNumbers(NamedTuple):
    """Random numbers of an injection for a whole flight."""

    rows: NDArray[np.int64]  # samples (n,) at which it draws
    draws: FaultDraws  # (n, 3)


class LoopDraws:
    """The inputs of a closed loop, in the order of the samples.

    ``seed`` is that of the scenario, ``count`` how many samples are flown. Injections draw by their
    ``numbers``, which count from 1; one of number 0 draws nothing.
    """

    def __init__(
        self, loop: ClosedLoop, seed: int, count: int, numbers: tuple[int, ...] | None = None
    ) -> None:
        self._period_ns, self._delay = round(loop.clock.period_ns), loop.vehicle.imu.delay
        self._random, self._vehicle, self._index = SensorDraws(seed), loop.vehicle, 0
        self._first = self._random.first(loop.vehicle.due(0))
        times = np.arange(count) * self._period_ns / NANOSECONDS_PER_SECOND
        self._faults = draw_faults(loop.injections, times, seed, numbers)

    @classmethod
    def example(cls, loop: ClosedLoop) -> LoopInputs:
        """Return the inputs of one sample."""
        inputs = cls(loop, 0, 1).next(1)
        return rows_of(inputs._replace(first_draws=None), 0)._replace(first_draws=inputs.first_draws)

    def next(self, count: int) -> LoopInputs:
        """Return the inputs of the next ``count`` samples, arrays (count, ...); what all share, without."""
        index = self._index + np.arange(count)
        self._index += count
        taken = np.maximum(index - self._delay, 0)
        before, now, then = (
            each * self._period_ns / NANOSECONDS_PER_SECOND
            for each in (np.maximum(index - 1, 0), index, taken)
        )
        period = seconds(self._period_ns)
        every = self._vehicle.position and self._vehicle.position.every
        there = every is not None
        return LoopInputs(
            before=before,
            now=now,
            dt=np.where(index == 0, 0.0, period),
            taken=then,
            number=taken.astype(np.float64),
            taken_dt=np.where(index <= self._delay, 0.0, period),
            due=Due(index % every == 0 if every is not None else None, None, None),
            draws=SampleDraws(
                self._random.next(count), self._random.next_place(count) if there else None, None, None
            ),
            first_draws=self._first,
            faults=tuple(fault_draws(each, taken) for each in self._faults),
        )


def draw_faults(
    injections: Sequence[Injection],
    time: NDArray[np.float64],
    seed: int,
    numbers: Sequence[int] | None = None,
) -> list[FaultNumbers | None]:
    """Draw the random numbers of injections for samples at scenario times [s] (n,); None: it takes none.

    Injections draw by their ``numbers``, which count from 1; one of number 0 draws nothing.
    """
    places = numbers or range(1, len(injections) + 1)
    return [_draw_fault(each, time, seed, place) for each, place in zip(injections, places, strict=True)]


def _draw_fault(
    injection: Injection, time: NDArray[np.float64], seed: int, number: int
) -> FaultNumbers | None:
    if injection.channel == ROTOR or not injection.law.is_random:
        return None
    steps = time < injection.stop
    if not injection.law.has_memory:
        steps &= injection.start <= time
    rows = np.flatnonzero(steps) if number else np.empty(0, np.int64)
    normal, uniform = fault_generators(seed, number)
    return FaultNumbers(
        rows, FaultDraws(normal.standard_normal((len(rows), 3)), uniform.random((len(rows), 3)))
    )


def fault_draws(numbers: FaultNumbers | None, taken: NDArray[np.int64]) -> FaultDraws | None:
    """Return the numbers of an injection for samples, (count, 3); 0 where it draws none."""
    if numbers is None:
        return None
    place = np.searchsorted(numbers.rows, taken)
    found = np.append(numbers.rows, -1)[place] == taken
    drawn = (np.vstack([each, np.zeros(3)])[place] for each in numbers.draws)
    return FaultDraws(*(np.where(found[:, None], each, 0.0) for each in drawn))
