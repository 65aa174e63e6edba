"""What the observer `isolating` says of each sensor, axis by axis."""

from __future__ import annotations

import numpy as np

from quadftc_fdi.isolation.accelerometer_monitor import AccelerometerMonitor
from quadftc_fdi.isolation.gyro_monitor import GyroMonitor
from quadftc_fdi.isolation.hypotheses import Hypotheses
from quadftc_fdi.isolation.reading_test import EARLY, SOME, Deviation, ReadingTest
from quadftc_model import samples
from quadftc_model.arrays import Array, Flag, Mask, States, Vector, changed_where, namespace
from quadftc_model.samples import FAULT_KINDS, FaultEstimate, SensorEstimate

OFFSET, STUCK, NOISE, ABSENT = (FAULT_KINDS.index(name) for name in ("offset", "stuck", "noise", "absent"))
NOISY = 6.0  # 1; squared changes from reading to reading, in variances, of noise that is a fault
HEALTHY = np.uint8(samples.HEALTHY)
SHOWN = 0.1  # s; a sensor that has looked healthy for so long is shown as recovering


def name_attitude(
    estimate: FaultEstimate, hypotheses: Hypotheses, gap: Vector, missing: Mask
) -> SensorEstimate:
    """Say what is known of the attitude; ``missing``: it has been absent of late, for ``gap`` [s]."""
    xp = namespace(estimate.fault)
    faulty = hypotheses.certain | hypotheses.ambiguous
    none = hypotheses.gyro, faulty.astype(xp.uint8)
    probability, kind = changed_where(
        faulty, lambda: (faulty * (1.0 - hypotheses.gyro), (faulty * OFFSET).astype(xp.uint8)), none
    )
    known = estimate.state, estimate.fault, estimate.std_dev, estimate.onset_age
    said = SensorEstimate(*known, probability, kind, hypotheses.ambiguous)
    absent = missing & ~faulty

    def name_absent() -> SensorEstimate:
        return said._replace(
            state=xp.where(absent, samples.FAULTY, said.state).astype(xp.uint8),
            std_dev=xp.where(absent, -1.0, said.std_dev),
            onset_age=xp.where(absent, gap, said.onset_age),
            probability=xp.where(absent, 1.0, said.probability),
            kind=xp.where(absent, ABSENT, said.kind).astype(xp.uint8),
        )

    return changed_where(absent, name_absent, said)


def name_gyro(
    monitor: GyroMonitor,
    test: ReadingTest,
    which: slice,
    valid: Flag,
    estimate: FaultEstimate,
    hypotheses: Hypotheses,
) -> SensorEstimate:
    """Say what is known of the gyro, some channels of the test; where ambiguous, as of the attitude."""
    xp = namespace(monitor.trace.deviation)
    std_dev = xp.sqrt(monitor.filter.rr + test.variance[..., which])
    said = _name(test, which, monitor.faulty, monitor.fault, std_dev, valid)

    def name_ambiguous() -> SensorEstimate:
        ambiguous = hypotheses.ambiguous & ~monitor.faulty
        return SensorEstimate(
            xp.where(ambiguous, samples.FAULTY, said.state).astype(xp.uint8),
            xp.where(ambiguous, monitor.trace.deviation, said.size),
            std_dev,
            xp.where(ambiguous, estimate.onset_age, said.onset_age),
            xp.where(ambiguous, hypotheses.gyro, said.probability),
            xp.where(ambiguous, OFFSET, said.kind).astype(xp.uint8),
            ambiguous,
        )

    return changed_where(hypotheses.ambiguous, name_ambiguous, said)


def name_accelerometer(
    monitor: AccelerometerMonitor, test: ReadingTest, which: slice, valid: Flag
) -> SensorEstimate:
    """Say what is known of the accelerometer, some channels of the test."""
    std_dev = namespace(monitor.mean).sqrt(test.variance[..., which])
    return _name(test, which, monitor.faulty, monitor.fault, std_dev, valid)


def _name(
    test: ReadingTest, which: slice, faulty: Mask, fault: Deviation, std_dev: Vector, valid: Flag
) -> SensorEstimate:
    xp, suspect, starting = (
        namespace(std_dev),
        test.outliers[..., which] > SOME,
        test.time[..., which] <= EARLY,
    )

    def name_trusted() -> States:
        trusted = xp.where(suspect, samples.SUSPECT, samples.HEALTHY)
        return xp.where(starting, samples.STARTING, trusted).astype(xp.uint8)

    trusted = changed_where(suspect | starting, name_trusted, faulty + HEALTHY)
    # of a healthy axis, the deviation is zero
    healthy = SensorEstimate(
        trusted, fault.mean, std_dev, faulty - 1.0, fault.mean, faulty.astype(xp.uint8), faulty
    )

    def name_faulty() -> SensorEstimate:
        out = xp.where(fault.calm > SHOWN, samples.RECOVERING, samples.FAULTY)
        return healthy._replace(
            state=xp.where(faulty, out, trusted).astype(xp.uint8),
            onset_age=xp.where(faulty, fault.age, -1.0),
            probability=1.0 * faulty,
            kind=(faulty * _kind(test.repeats[..., which], fault, valid)).astype(xp.uint8),
            ambiguous=faulty & ~faulty,
        )

    return changed_where(faulty, name_faulty, healthy)


def _kind(repeats: Vector, fault: Deviation, valid: Flag) -> Array:
    xp = namespace(fault.mean)
    kind = xp.where(repeats > 1.0, STUCK, xp.where(fault.scatter > NOISY, NOISE, OFFSET))
    return xp.where(valid[..., None], kind, ABSENT)
