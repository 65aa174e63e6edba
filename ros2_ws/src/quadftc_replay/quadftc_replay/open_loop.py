"""A fault observer on recorded samples with faults on them: which law gets what of which.

    samples -> faults -> fault observer

Compare `quadftc_flight.loop`, the closed loop. Whatever is computed, a law computes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_fdi.fault_observer import FaultObserver
from quadftc_fdi.observation import Observation, ObservationInputs
from quadftc_flight.loop import SampleClock, said_at_first
from quadftc_flight.loop_draws import draw_faults, fault_draws
from quadftc_model.arrays import Flag, Scalar, Vector, rows_of
from quadftc_model.composition import Calls
from quadftc_model.guarded import Guarded, GuardedOutput
from quadftc_model.samples import FaultEstimate, ImuSample, level_sample
from quadftc_model.stepper import NANOSECONDS_PER_SECOND, seconds
from quadftc_replay.imu_recording import Recording
from quadftc_sim.injection import Injection
from quadftc_sim.injector import FaultDraws, Faulty, begin, inject, laws_of, without_faults


class OpenInputs(NamedTuple):
    """A recorded sample, and the random numbers of its faults."""

    sample: ImuSample
    torque: Vector  # that acted since the sample before [N m]
    driven: Flag  # the torque is known
    since_first: Scalar  # stamp of the sample minus that of the first [ns], a whole number
    time: Scalar  # the same in seconds [s]
    dt: Scalar  # since the sample before [s]; 0 at the first
    faults: tuple[FaultDraws | None, ...]  # of each injection


class OpenState(NamedTuple):
    """States of the laws, and what was said of the last sample that was not withheld."""

    injections: tuple[object, ...]
    clock: object
    observer: object
    estimate: GuardedOutput[FaultEstimate]


class OpenOutput(NamedTuple):
    """What became of a sample; nothing new is said of one that is withheld."""

    faulty: Faulty
    estimate: GuardedOutput[FaultEstimate]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class OpenLoop:
    """Faults and a fault observer; a `quadftc_model.composition.Composition`."""

    injections: tuple[Injection, ...]  # those for the period, see `Injection.for_period`
    observer: Guarded[ObservationInputs, FaultEstimate]
    clock: SampleClock = dataclasses.field(default_factory=lambda: SampleClock(period_ns=1.0))

    @property
    def laws(self) -> Mapping[str, Any]:
        """The laws by name."""
        return {**laws_of(self.injections), "clock": self.clock, "observer": self.observer}

    def init(self, calls: Calls) -> OpenState:
        """Return a state to begin with: no sample has come."""
        injections = begin(calls, self.injections)
        return OpenState(
            injections, calls.init("clock"), calls.init("observer"), said_at_first(self.observer)
        )

    def step(self, calls: Calls, state: OpenState, inputs: OpenInputs) -> tuple[OpenState, OpenOutput]:
        """Put the faults on the next sample, and diagnose it if it is not withheld."""
        times = inputs.time, inputs.dt
        faulty = without_faults(inputs.sample, None)
        if self.injections:
            injections, faulty = inject(
                calls, self.injections, state.injections, inputs.sample, None, *times, inputs.faults
            )
            state = state._replace(injections=injections)
        state = calls.branch(
            faulty.present, lambda: self._diagnose(calls, state, faulty.sample, inputs), lambda: state
        )
        return state, OpenOutput(faulty, state.estimate)

    def _diagnose(self, calls: Calls, state: OpenState, sample: ImuSample, inputs: OpenInputs) -> OpenState:
        clock, times = calls.step("clock", state.clock, inputs.since_first, 1.0)
        seen = ObservationInputs(sample, inputs.torque, driven=inputs.driven)
        observer, estimate = calls.step("observer", state.observer, seen, times.dt)
        return state._replace(clock=clock, observer=observer, estimate=estimate)


def open_loop_of(recording: Recording, law: FaultObserver, injections: Sequence[Injection]) -> OpenLoop:
    """Return the open loop of a recording; its first two samples say the period of faults."""
    first, second = recording.stamp_ns[:2].tolist()
    fixed = tuple(each.for_period(seconds(second - first)) for each in injections)
    return OpenLoop(injections=fixed, observer=Guarded(Observation(law)))


class OpenDraws:
    """The inputs of an open loop, in the order of the samples; ``seed`` is that of the random faults."""

    def __init__(self, recording: Recording, injections: Sequence[Injection], seed: int) -> None:
        stamps = recording.stamp_ns
        self._recording = recording
        self._since = (stamps - stamps[0]).astype(np.float64)
        self._time = self._since / NANOSECONDS_PER_SECOND
        self._dt = np.diff(stamps, prepend=stamps[:1]) / NANOSECONDS_PER_SECOND
        self._faults = draw_faults(injections, self._time, seed)

    def rows(self, begin: int, stop: int) -> OpenInputs:
        """Return the inputs of some samples, arrays (n, ...)."""
        rows, recording = slice(begin, stop), self._recording
        return OpenInputs(
            sample=rows_of(recording.imu, rows),
            torque=recording.torque[rows],
            driven=np.bool_(recording.driven),
            since_first=self._since[rows],
            time=self._time[rows],
            dt=self._dt[rows],
            faults=tuple(fault_draws(each, np.arange(begin, stop)) for each in self._faults),
        )

    def example(self) -> OpenInputs:
        """Return the inputs of one sample."""
        zeros = np.zeros(3)
        draws = tuple(None if each is None else FaultDraws(zeros, zeros) for each in self._faults)
        return OpenInputs(level_sample(), zeros, np.True_, 0.0, 0.0, 0.0, draws)
