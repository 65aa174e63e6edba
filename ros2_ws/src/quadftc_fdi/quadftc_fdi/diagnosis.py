"""Diagnosis of one vehicle's stream of IMU samples: cleaning, the start, and the fault observer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.fault_observer import FaultObserver, LastWords
from quadftc_model.samples import STARTING, FaultEstimate, FaultObserverInputs, ImuSample, sanitised
from quadftc_model.stepper import Stepper, Timing


class Diagnosis:
    """A fault observer on a stream.

    It starts, and starts anew after a gap, at the first sample that has both attitude and rate. Every later
    sample with a new stamp gives an estimate and a corrected sample, whatever is wrong with it.
    """

    def __init__(self, law: FaultObserver) -> None:
        self._stepper: Stepper[FaultObserverInputs, FaultEstimate] = Stepper(law)

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

    def reset(self) -> None:
        """Start anew at the next sample."""
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
            zeros, unknown = np.zeros(3), np.full(3, -1.0)
            return FaultEstimate(zeros, unknown, np.full(3, STARTING, np.uint8), unknown, clean)
        return self._stepper.step(stamp_ns, FaultObserverInputs(clean, torque))
