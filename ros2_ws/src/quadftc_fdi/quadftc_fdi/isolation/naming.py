"""What the observer `isolating` says of each sensor, axis by axis."""

from __future__ import annotations

from quadftc_fdi.isolation.accelerometer_monitor import AccelerometerMonitor
from quadftc_fdi.isolation.gyro_monitor import GyroMonitor
from quadftc_fdi.isolation.hypotheses import Hypotheses
from quadftc_fdi.isolation.reading_test import EARLY, SOME, Deviation, ReadingTest
from quadftc_model import samples
from quadftc_model.arrays import Flag, Mask, Vector, column, namespace, sqrt, where
from quadftc_model.samples import FAULT_KINDS, FaultEstimate, SensorEstimate

OFFSET, STUCK, NOISE, ABSENT = (FAULT_KINDS.index(name) for name in ("offset", "stuck", "noise", "absent"))
NOISY = 6.0  # 1; squared changes from reading to reading, in variances, of noise that is a fault
SHOWN = 0.1  # s; a sensor that has looked healthy for so long is shown as recovering


def name_attitude(
    estimate: FaultEstimate, hypotheses: Hypotheses, gap: Vector, missing: Mask
) -> SensorEstimate:
    """Say what is known of the attitude; ``missing``: it has been absent of late, for ``gap`` [s]."""
    xp, faulty = namespace(estimate.fault), hypotheses.certain | hypotheses.ambiguous
    absent = missing & ~faulty
    return SensorEstimate(
        where(absent, samples.FAULTY, estimate.state).astype(xp.uint8),
        estimate.fault,
        where(absent, -1.0, estimate.std_dev),
        where(absent, gap, estimate.onset_age),
        where(absent, 1.0, faulty * (1.0 - hypotheses.gyro)),
        where(absent, ABSENT, faulty * OFFSET).astype(xp.uint8),
        hypotheses.ambiguous,
    )


def name_gyro(
    monitor: GyroMonitor,
    test: ReadingTest,
    which: slice,
    valid: Flag,
    estimate: FaultEstimate,
    hypotheses: Hypotheses,
) -> SensorEstimate:
    """Say what is known of the gyro, some channels of the test; where ambiguous, as of the attitude."""
    xp, ambiguous = namespace(monitor.trace.deviation), hypotheses.ambiguous & ~monitor.faulty
    std_dev = sqrt(monitor.filter.rr + test.variance[..., which])
    said = _name(test, which, monitor.faulty, monitor.fault, std_dev, valid)
    return SensorEstimate(
        where(ambiguous, samples.FAULTY, said.state).astype(xp.uint8),
        where(ambiguous, monitor.trace.deviation, said.size),
        std_dev,
        where(ambiguous, estimate.onset_age, said.onset_age),
        where(ambiguous, hypotheses.gyro, said.probability),
        where(ambiguous, OFFSET, said.kind).astype(xp.uint8),
        ambiguous,
    )


def name_accelerometer(
    monitor: AccelerometerMonitor, test: ReadingTest, which: slice, valid: Flag
) -> SensorEstimate:
    """Say what is known of the accelerometer, some channels of the test."""
    std_dev = sqrt(test.variance[..., which])
    return _name(test, which, monitor.faulty, monitor.fault, std_dev, valid)


def _name(
    test: ReadingTest, which: slice, faulty: Mask, fault: Deviation, std_dev: Vector, valid: Flag
) -> SensorEstimate:
    xp = namespace(std_dev)
    suspect, starting = test.outliers[..., which] > SOME, test.time[..., which] <= EARLY
    trusted = where(starting, samples.STARTING, where(suspect, samples.SUSPECT, samples.HEALTHY))
    distrusted = where(fault.calm > SHOWN, samples.RECOVERING, samples.FAULTY)
    changing = where(fault.scatter > NOISY, NOISE, OFFSET)
    kind = where(column(valid), where(test.repeats[..., which] > 1.0, STUCK, changing), ABSENT)
    return SensorEstimate(
        where(faulty, distrusted, trusted).astype(xp.uint8),
        fault.mean,  # zero where there is no fault
        std_dev,
        where(faulty, fault.age, -1.0),
        1.0 * faulty,
        where(faulty, kind, 0).astype(xp.uint8),
        xp.zeros_like(faulty),
    )
