"""Diagnosis of one vehicle's stream of IMU samples: cleaning, the start, and the fault observer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.fault_observer import FaultObserver, LastWords
from quadftc_model.samples import (
    STARTING,
    FaultEstimate,
    FaultObserverInputs,
    ImuSample,
    is_usable,
    sanitised,
)
from quadftc_model.stepper import Stepper, Timing


class Diagnosis:
    """A fault observer on a stream.

    It starts at the first sample that has both attitude and rate, and restarts so after a gap and after an
    estimate that cannot be used. Every later sample with a new stamp gives an estimate and a corrected
    sample, whatever is wrong with it.
    """

    def __init__(self, law: FaultObserver) -> None:
        self._stepper: Stepper[FaultObserverInputs, FaultEstimate] = Stepper(law, _usable_estimate)

    @property
    def stamp_ns(self) -> int | None:
        """Stamp of the last sample used [ns]."""
        return self._stepper.stamp_ns

    @property
    def law(self) -> FaultObserver:
        """The observer; a new one goes on with the state of the old."""
        return self._stepper.law  # type: ignore[return-value]

    @law.setter
    def law(self, law: FaultObserver) -> None:
        self._stepper.law = law

    @property
    def replaced(self) -> int:
        """How many estimates so far could not be used."""
        return self._stepper.replaced

    def reset(self) -> None:
        """Restart at the next sample."""
        self._stepper.reset()

    def resume(
        self, stamp_ns: int, sample: ImuSample, torque: NDArray[np.float64], last: LastWords
    ) -> FaultEstimate | None:
        """Diagnose a sample from what another diagnosis has left; None if it needs another sample for that.

        Parameters
        ----------
        stamp_ns, sample, torque
            As of `step`.
        last : LastWords
        """
        clean = sanitised(sample)
        if not (clean.attitude_valid and clean.rate_valid and self._stepper.timing(stamp_ns).accepted):
            return None
        inputs = FaultObserverInputs(clean, torque)
        return self._stepper.resume(stamp_ns, inputs, self.law.resumed(inputs, last))

    def step(self, stamp_ns: int, sample: ImuSample, torque: NDArray[np.float64]) -> FaultEstimate | None:
        """Diagnose a sample; None if its stamp is repeated or went back.

        Parameters
        ----------
        stamp_ns : int
            The sample's time [ns].
        sample : ImuSample
            As received, of one vehicle.
        torque : array (3,)
            Torque that acted since the sample before [N m].
        """
        clean = sanitised(sample)
        starts = self._stepper.timing(stamp_ns) in (Timing.FIRST, Timing.RESTART)
        if starts and not (clean.attitude_valid and clean.rate_valid):
            self._stepper.reset()
            return _starting_estimate(clean)
        return self._stepper.step(stamp_ns, FaultObserverInputs(clean, torque))


def _usable_estimate(inputs: FaultObserverInputs, estimate: FaultEstimate) -> FaultEstimate:
    corrected = estimate.corrected
    if is_usable(estimate.fault, corrected.q_xyzw, corrected.body_rate):
        return estimate
    return _starting_estimate(inputs.imu)


def _starting_estimate(clean: ImuSample) -> FaultEstimate:
    """What is said before the observer has started: no fault is known, the sample passes as it is."""
    unknown = np.full(3, -1.0)
    return FaultEstimate(np.zeros(3), unknown, np.full(3, STARTING, np.uint8), unknown, clean)
