r"""Is the accelerometer healthy? Axis by axis: what it reads against gravity at the estimated attitude.

On a test stand the specific force is that of gravity, g R' e_z. In flight it is thrust and drag. The
difference is learned as an offset and as noise, so that only what is unlike the flight so far is a fault.
Nothing is judged or learned while another sensor is in doubt: the attitude may be wrong then.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_fdi.isolation import reading_test
from quadftc_fdi.isolation.reading_test import Deviation, ReadingTest
from quadftc_model.arrays import Flag, Mask, Vector, any_of, changed_where, exp, namespace
from quadftc_model.samples import STANDARD_GRAVITY

PRIOR, FLOOR, NOISY = 0.5, 0.03, 1e-3  # m/s²; noise at first, at least; below, a sensor may repeat itself
OFFSET = 0.2  # m/s²; 1 sigma of what a healthy one may read too much for long: 1 deg is 0.17 m/s²
LEARNED, AVERAGED = 20.0, 0.3  # s; over which the offset is learned, and is tested
ALARM = 4.0  # 1; standard deviations of the average that make a fault


class AccelerometerMonitor(NamedTuple):
    """What is known of the accelerometer."""

    test: ReadingTest
    offset: Vector  # learned [m/s²]
    mean: Vector  # average of the deviation [m/s²]
    faulty: Mask
    fault: Deviation  # of a faulty one [m/s²]


def start_accelerometer(force: Vector) -> AccelerometerMonitor:
    """Start at a reading [m/s²]."""
    zeros = namespace(force).zeros_like(force)
    test, fault = reading_test.start_test(force, PRIOR), reading_test.no_deviation(force)
    return AccelerometerMonitor(test, zeros, zeros, zeros > 1.0, fault)


def step_accelerometer(
    state: AccelerometerMonitor, force: Vector, valid: Flag, vertical: Vector, doubtful: Mask, dt: float
) -> AccelerometerMonitor:
    """Advance by ``dt`` [s] to a reading [m/s²], with the earth's vertical in body axes.

    ``doubtful``: attitude or gyro is in doubt.
    """
    xp = namespace(force)
    there, quiet = (force == force) & valid[..., None], ~any_of(doubtful)
    deviation = force - STANDARD_GRAVITY * vertical - state.offset
    square, zero = deviation * deviation, 0.0 * deviation
    test, verdict = reading_test.test_reading(state.test, force, there, square, zero, FLOOR, NOISY, dt)
    used = verdict.good & quiet & ~state.faulty
    mean = state.mean + (1.0 - exp(-dt / AVERAGED)) * used * (deviation - state.mean)
    far = used & (mean * mean > ALARM**2 * OFFSET**2) & (test.time > reading_test.EARLY)
    alarm = ~state.faulty & (verdict.stuck | (verdict.odd & (quiet | ~there)) | far)
    faulty = state.faulty | alarm
    test = reading_test.learn_noise(test, square, zero, used & ~alarm, FLOOR, dt)
    variance = xp.maximum(test.variance, FLOOR**2)
    faulty, fault = changed_where(
        faulty,
        lambda: reading_test.follow_deviation(
            state.fault,
            faulty,
            alarm,
            there & ~verdict.stuck,
            test.suspicion,
            deviation,
            variance + OFFSET**2,
            zero + OFFSET**2,
            dt,
        ),
        (faulty, state.fault),
    )
    gain = dt / (LEARNED + dt)
    offset = state.offset + gain * (used & ~alarm) * deviation
    return AccelerometerMonitor(test, offset, mean * ~faulty, faulty, fault)
