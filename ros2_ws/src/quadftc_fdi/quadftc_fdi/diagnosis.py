"""Diagnosis of one vehicle's stream of IMU samples: cleaning, start, resumption, and the fault observer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from quadftc_fdi.fault_observer import FaultObserver, LastDiagnosis
from quadftc_model import samples
from quadftc_model.arrays import Vector
from quadftc_model.samples import FaultEstimate, FaultObserverInputs, ImuSample, sanitised
from quadftc_model.stepper import ResumingStepper, seconds


class Diagnosis(ResumingStepper[FaultObserverInputs, FaultEstimate, LastDiagnosis]):
    """A fault observer on a stream.

    It starts at the first sample with attitude and rate, also after a gap and an estimate that cannot be
    used. Every later sample with a new stamp gives an estimate and a corrected sample, whatever is wrong with
    it.
    """

    law: FaultObserver

    def __init__(self, law: FaultObserver) -> None:
        super().__init__(law, _usable_estimate)

    def diagnose(self, stamp_ns: int, sample: ImuSample, torque: Vector) -> FaultEstimate | None:
        """Diagnose a sample [ns] as received; None if its stamp is repeated or went back.

        ``torque`` [N m] is the one that acted since the sample before.
        """
        clean = sanitised(sample)
        inputs = FaultObserverInputs(clean, torque)
        last, dt = self.words_for(stamp_ns), self.time_step(stamp_ns)
        complete = clean.attitude_valid and clean.rate_valid
        if last is not None:
            last = last._replace(since=np.array([_age(stamp_ns, onset_ns) for onset_ns in last.onset_ns]))
            if not all(np.all(np.isfinite(part)) for part in last):
                self.drop_words()
            elif complete and dt is not None:
                return self.take_over(stamp_ns, inputs, self.law.resumed(inputs, last))
        if dt == 0.0 and not complete:
            self.reset()
            return _starting_estimate(clean)
        return self.step(stamp_ns, inputs)


def describe_axes(
    estimate: FaultEstimate, more: Mapping[str, Vector] | None = None
) -> Iterator[tuple[str, int, dict[str, str]]]:
    """Return name, fault state and values for people of each axis of an estimate.

    ``more`` is what the observer says of itself besides, by name.
    """
    columns = (each.tolist() for each in estimate[:4])
    for row, (axis, size, std_dev, state, age) in enumerate(zip(samples.AXES, *columns, strict=True)):
        values = {"size_deg": f"{round(math.degrees(size), 3) + 0.0:.3f}"}  # no -0.000
        if std_dev >= 0.0:
            values["sigma_deg"] = f"{math.degrees(std_dev):.3f}"
        if age >= 0.0:
            values["age_s"] = f"{age:.2f}"
        values |= {name: f"{float(each[row]):.3g}" for name, each in (more or {}).items()}
        yield axis, state, values


def _age(stamp_ns: int, onset_ns: int) -> float:
    return seconds(max(0, stamp_ns - onset_ns)) if onset_ns else 0.0


def _usable_estimate(inputs: FaultObserverInputs, estimate: FaultEstimate) -> FaultEstimate:
    fault, corrected = estimate.fault, estimate.corrected
    usable = samples.is_usable(fault, corrected.q_xyzw, corrected.body_rate)
    return estimate if usable else _starting_estimate(inputs.imu)


def _starting_estimate(clean: ImuSample) -> FaultEstimate:
    """Return the estimate before the observer has started: no fault is known, the sample passes."""
    unknown = np.full(3, -1.0)
    return FaultEstimate(np.zeros(3), unknown, np.full(3, samples.STARTING, np.uint8), unknown, clean)
