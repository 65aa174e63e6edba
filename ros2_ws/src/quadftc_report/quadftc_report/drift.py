r"""How a fault estimate drifts on a gyro that is biased, measured from the recording.

An observer that integrates the gyro takes its bias b for motion. With the estimate of the angles z = angles -
e, e being the error of the fault estimate, it believes z' = T(z) (omega + b), whereas the vehicle turns by
angles' = T(angles) omega, so that

    e' = T(angles) omega - T(z) (omega + b),    about -b while the vehicle is near level,

T being the kinematics (4) of Wang et al. (2021). Measured e and recorded angles and rates on the right, this
is the slope that the bias alone explains.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import BagError
from quadftc_flight.flight import Flight
from quadftc_flight.run_directory import RecordedRun
from quadftc_model.rotations import euler_rates, wrap
from quadftc_model.samples import AXES

Floats = NDArray[np.float64]

MIN_TIME = 0.5  # s; a shorter stretch of healthy time tells no slope


class AxisDrift(NamedTuple):
    """The drift about one axis."""

    bias: float  # mean of imu/data less plant/rate [deg/s]
    bias_error: float  # standard error of that mean [deg/s]
    slope: float  # fitted to the error of the fault estimate [deg/s]
    expected: float  # the slope that the bias explains, through the kinematics [deg/s]
    error_at_stop: float  # of the fault estimate when the healthy time ends [deg]
    error_at_end: float  # and when the recording ends [deg]


class Drift(NamedTuple):
    """The drift of a run's fault estimate while nothing is wrong with the sensor but its bias."""

    start: float  # [s]
    stop: float  # [s]
    axes: dict[str, AxisDrift]


def measure_drift(run: RecordedRun) -> Drift | None:
    """Measure the drift from the first sample to the first scheduled fault.

    Returns
    -------
    Drift, optional
        None if estimate, truth or gyro were not recorded, or the healthy time is too short.
    """
    flight = run.flight
    stop = min([fault.injection.start for fault in run.scenario.faults], default=math.inf)
    error = wrap(flight.fault_estimate - flight.fault)
    known = np.isfinite(error).all(axis=1) & np.isfinite(flight.angles).all(axis=1)
    healthy = known & (flight.time < stop) & np.isfinite(flight.body_rate).all(axis=1)
    if not healthy.any() or float(np.ptp(flight.time[healthy])) < MIN_TIME:
        return None
    gyro_error = _gyro_error(run, flight.stamp_ns[healthy])
    if len(gyro_error) < 2:
        return None
    bias = gyro_error.mean(axis=0)
    deviation = gyro_error.std(axis=0, ddof=1) / math.sqrt(len(gyro_error))
    time = flight.time[healthy]
    expected = _slope(time, _explained(flight, error, bias)[healthy])
    columns = (bias, deviation, _slope(time, error[healthy]), expected, error[healthy][-1], error[known][-1])
    table = np.degrees(np.stack(columns, axis=1))
    axes = {axis: AxisDrift(*(float(value) for value in row)) for axis, row in zip(AXES, table, strict=True)}
    return Drift(float(time[0]), float(time[-1]), axes)


def _gyro_error(run: RecordedRun, stamps: NDArray[np.int64]) -> Floats:
    """What the gyro said less the true body rate [rad/s] (n, 3), at those stamps that have both."""
    try:
        imu, truth = run.bag.series("imu/data"), run.bag.series("plant/rate")
        said, true = imu["angular_velocity"], truth["vector"]
    except BagError:
        return np.empty((0, 3))
    here = np.flatnonzero(np.isin(imu.stamp_ns, stamps))
    _, rows, others = np.intersect1d(imu.stamp_ns[here], truth.stamp_ns, return_indices=True)
    found = said[here][rows] - true[others]
    return found[np.isfinite(found).all(axis=1)]


def _explained(flight: Flight, error: Floats, bias: Floats) -> Floats:
    """The error [rad] (n, 3) that the bias explains: e' of the module's text, integrated."""
    true = euler_rates(flight.angles, flight.body_rate)
    believed = euler_rates(flight.angles - error, flight.body_rate + bias)
    steps = np.diff(flight.time, prepend=flight.time[0])[:, None]
    return np.cumsum(np.nan_to_num(true - believed) * steps, axis=0)


def _slope(time: Floats, values: Floats) -> Floats:
    """Slopes (3,) of straight lines through the columns of ``values`` (n, 3), least squares."""
    return np.polynomial.polynomial.polyfit(time, values, 1)[1]
