"""The fault injector: the faults of one IMU, scheduled or injected at run time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model.samples import ImuSample
from quadftc_model.stepper import seconds
from quadftc_sim.injection import Injection, fault_generators
from quadftc_sim.injection_step import FaultDraws, InjectionState, begin, inject

Floats = NDArray[np.float64]


class Injected(NamedTuple):
    """What comes out for one sample."""

    sample: ImuSample | None  # None: the sample is withheld
    attitude: Floats  # (3,) true fault of the attitude [rad]; NaN where the channel is not a number
    gyro: Floats  # (3,) [rad/s]
    accelerometer: Floats  # (3,) [m/s²]


class _Scheduled:
    """An injection with its state and random numbers of its own."""

    def __init__(self, injection: Injection, number: int, seed: int) -> None:
        self.injection = injection
        self.state: InjectionState | None = None
        self._normal, self._uniform = fault_generators(seed, number)

    def runs(self, time: float) -> bool:
        """Whether the fault acts at a scenario time [s], or has to see the sample for its memory."""
        injection = self.injection
        return time < injection.stop and (injection.start <= time or injection.law.has_memory)

    def draw(self) -> FaultDraws | None:
        """Return the random numbers of the next sample."""
        if not self.injection.law.is_random:
            return None
        return FaultDraws(self._normal.standard_normal(3), self._uniform.random(3))


class FaultInjector:
    """All faults of one IMU.

    Parameters
    ----------
    seed : int
        Of the random faults (noise, spikes, dropout).
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._scheduled: dict[int, _Scheduled] = {}
        self._count = 0
        self._epoch_ns: int | None = None
        self._stamp_ns = 0

    @property
    def injections(self) -> dict[int, Injection]:
        """The injections that wait or act, by number."""
        return {number: each.injection for number, each in self._scheduled.items()}

    @property
    def active(self) -> dict[int, Injection]:
        """The injections that act on the present sample, by number."""
        now = self.now
        return {number: injection for number, injection in self.injections.items() if injection.start <= now}

    @property
    def now(self) -> float:
        """Scenario time of the last sample [s]; 0 before the first."""
        return 0.0 if self._epoch_ns is None else seconds(self._stamp_ns - self._epoch_ns)

    def add(self, injection: Injection) -> int:
        """Schedule an injection; return its number, from 1."""
        self._count += 1
        self._scheduled[self._count] = _Scheduled(injection, self._count, self._seed)
        return self._count

    def clear(self, number: int = 0) -> int:
        """End one injection, or all (0); return how many ended."""
        numbers = list(self._scheduled) if number == 0 else [number] if number in self._scheduled else []
        for known in numbers:
            del self._scheduled[known]
        return len(numbers)

    def apply(self, stamp_ns: int, sample: ImuSample) -> Injected:
        """Put the faults on one sample of a single vehicle.

        Parameters
        ----------
        stamp_ns : int
            The sample's time [ns]; the first sample's is scenario time 0.
        """
        if self._epoch_ns is None:
            self._epoch_ns = self._stamp_ns = stamp_ns
        dt = seconds(stamp_ns - self._stamp_ns)
        self._stamp_ns = stamp_ns
        time = self.now
        for number in [n for n, each in self._scheduled.items() if each.injection.stop <= time]:
            del self._scheduled[number]
        running = [each for each in self._scheduled.values() if each.runs(time)]
        zeros = np.zeros(3)
        if not running:  # mostly; the step costs as much as an observer
            return Injected(sample, zeros, zeros, zeros)
        injections = [each.injection for each in running]
        states = [each.state or start for each, start in zip(running, begin(injections, sample), strict=True)]
        after, faulty = inject(injections, states, sample, time, dt, [each.draw() for each in running])
        for each, state in zip(running, after, strict=True):
            each.state = state
        return Injected(
            faulty.sample if faulty.present else None, faulty.attitude, faulty.gyro, faulty.accelerometer
        )
