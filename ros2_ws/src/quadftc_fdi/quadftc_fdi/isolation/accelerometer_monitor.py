r"""Is the accelerometer healthy? Axis by axis: what it reads against gravity at the estimated attitude.

On a test stand the specific force is that of gravity, g R' e_z. In flight it is thrust and drag. The
difference is learned as an offset and as noise, so that only what is unlike the flight so far is a fault.
Nothing is judged or learned while another sensor is in doubt: the attitude may be wrong then.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_fdi.isolation import reading_test
from quadftc_fdi.isolation.reading_test import Deviation, Verdict
from quadftc_model.arrays import Mask, Scalar, Vector, any_of, namespace, where
from quadftc_model.samples import STANDARD_GRAVITY

NOISE, LEAST = 0.5, 0.03  # m/s²; of a reading at first, and at least: vibration comes and goes
OFFSET = 0.2  # m/s²; 1 sigma of what a healthy one may read too much for long: 1 deg is 0.17 m/s²
LEARNED, AVERAGED = 20.0, 0.3  # s; over which the offset is learned, and is tested
ALARM = 4.0  # 1; standard deviations of the average that make a fault


class AccelerometerMonitor(NamedTuple):
    """What is known of the accelerometer."""

    offset: Vector  # learned [m/s²]
    mean: Vector  # average of the deviation [m/s²]
    faulty: Mask
    fault: Deviation  # of a faulty one [m/s²]


def start_accelerometer(force: Vector) -> AccelerometerMonitor:
    """Start at a reading [m/s²]."""
    zeros = namespace(force).zeros_like(force)
    return AccelerometerMonitor(zeros, zeros, zeros > 1.0, reading_test.no_deviation(force))


def deviation_of(state: AccelerometerMonitor, force: Vector, vertical: Vector) -> Vector:
    """What a reading [m/s²] has too much, with the earth's vertical in body axes."""
    return force - STANDARD_GRAVITY * vertical - state.offset


def step_accelerometer(
    state: AccelerometerMonitor,
    deviation: Vector,
    noise: Vector,
    suspicion: Vector,
    there: Mask,
    verdict: Verdict,
    doubtful: Mask,
    dt: Scalar,
) -> tuple[AccelerometerMonitor, Mask]:
    """Advance by ``dt`` [s] to a reading of `deviation_of`; also return where its noise may be learned.

    ``noise`` is the variance of a reading, ``suspicion`` [s] how long there have been outliers. ``doubtful``:
    attitude or gyro is in doubt.
    """
    quiet = ~any_of(doubtful)
    used = verdict.good & quiet & ~state.faulty
    share = -namespace(deviation).expm1(-dt / AVERAGED)  # to the last digit of a short step, too
    mean = state.mean + share * where(used, deviation - state.mean, 0.0)
    far = used & (mean * mean > (ALARM * OFFSET) ** 2)
    alarm = ~state.faulty & (verdict.stuck | (verdict.odd & (quiet | ~there)) | far)
    alive, known = there & ~verdict.stuck, noise + OFFSET**2
    faulty, fault = reading_test.follow_deviation(
        state.fault, state.faulty | alarm, alarm, alive, suspicion, deviation, noise, known, dt
    )
    used = used & ~alarm
    offset = state.offset + (dt / (LEARNED + dt)) * where(used, deviation, 0.0)
    return AccelerometerMonitor(offset, where(faulty, 0.0, mean), faulty, fault), used
