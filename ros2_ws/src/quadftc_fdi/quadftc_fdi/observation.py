"""A fault observer on samples as they are received.

What cannot be used of a sample is marked as absent, and in free flight the commands of the rotors become
torque and thrust. The fault observer node and the closed loop without ROS run this law, guarded
(`quadftc_model.guarded`).
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from quadftc_fdi.fault_observer import FaultObserver, LastDiagnosis, await_start, is_usable_estimate
from quadftc_model.arrays import Flag, Vector
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import (
    NO_PLACE,
    FaultEstimate,
    FaultObserverInputs,
    ImuSample,
    PositionSample,
    RotorReading,
    level_sample,
    sanitised,
)


class ObservationInputs(NamedTuple):
    """A sample as it is received, and what acted since the sample before.

    On the test stand there is a torque, in free flight there are rotors and position; the others are None.
    """

    sample: ImuSample
    torque: Vector | None = None  # [N m]
    rotors: RotorReading | None = None
    position: PositionSample | None = None
    driven: Flag = np.True_  # the torque is known; if not, it is given as zero


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """A fault observer on received samples."""

    observer: FaultObserver
    flies: bool = False  # what it is compiled for before a sample comes: free flight, or the test stand

    @property
    def named_after(self) -> FaultObserver:
        """What it is called after where it is compiled."""
        return self.observer

    def init(self, inputs: ObservationInputs) -> Any:
        """Return the state of the observer at the first sample."""
        return self.observer.init(self.seen(inputs))

    def step(self, state: Any, inputs: ObservationInputs, dt: float) -> tuple[Any, FaultEstimate]:
        """Advance the observer by ``dt`` [s] to a sample."""
        return self.observer.step(state, self.seen(inputs), dt)

    def resumed(self, inputs: ObservationInputs, last: LastDiagnosis) -> Any:
        """Return the state that resumes at a sample where another observer of this kind has died."""
        return self.observer.resumed(self.seen(inputs), last)

    def ready(self, inputs: ObservationInputs) -> Flag:
        """Whether the observer can start at a sample: it has attitude and body rate."""
        clean = sanitised(inputs.sample)
        return clean.attitude_valid & clean.rate_valid

    def usable(self, output: FaultEstimate) -> Flag:
        """Whether all numbers of an estimate can be used."""
        return is_usable_estimate(output)

    def fallback(self, inputs: ObservationInputs, output: FaultEstimate) -> FaultEstimate:
        """Return what is said in place of an estimate: that of an observer that has not started."""
        return await_start(sanitised(inputs.sample), output)

    def example(self) -> ObservationInputs:
        """Return inputs as they will come, for the compiler."""
        if not self.flies:
            return ObservationInputs(level_sample(), np.zeros(3))
        vehicle = self.observer.vehicle
        speeds = np.full(len(vehicle.rotors.positions), vehicle.hover_speed)
        rotors = RotorReading(speeds, speeds, np.True_)
        return ObservationInputs(level_sample(), rotors=rotors, position=NO_PLACE)

    def example_words(self) -> LastDiagnosis:
        """Return last words as they may come, for the compiler."""
        zeros = np.zeros(3)
        return LastDiagnosis(zeros, zeros, zeros > 0.0, zeros, zeros)

    def seen(self, inputs: ObservationInputs) -> FaultObserverInputs:
        """Return what the observer sees of a sample."""
        sample, torque, rotors, position, driven = inputs
        thrust = None
        if rotors is not None:
            torque, thrust = wrench_from_speeds(self.observer.vehicle, rotors.command)
        assert torque is not None
        return FaultObserverInputs(sanitised(sample), torque, thrust, position, rotors, driven)
