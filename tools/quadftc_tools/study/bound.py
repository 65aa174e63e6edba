r"""How well a fault can be estimated at all: the posterior Cramer-Rao bound of the simulation.

On each axis the problem is linear and Gaussian, with the angle theta and the gyro bias b:

    theta' = m - b - n,    b' = n_b,    y = theta + f + v

f is zero but during the fault, whose onset is known and whose course is not, so that y tells nothing of theta
then. No estimator has a smaller mean square error than the filter of Kalman (1960), whose covariance P is
carried through the healthy times with, and through the faults without y. The fault is y - theta; its white
noise v can be averaged over a time T in which the fault does not change, so

    bound(t)^2 = P_theta(t) + sigma^2 dt / min(T, t)        t: time since the onset

The axes are taken by themselves, and the kinematics as those of small angles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from quadftc_sim.sensors import ImuSensor

Floats = NDArray[np.float64]

AVERAGING = 0.06  # s; T: over this `supervised` averages the estimate of a fault


def attitude_std_dev(
    sensor: ImuSensor, dt: float, count: int, windows: Sequence[tuple[float, float]]
) -> Floats:
    """Return the least standard deviation of the attitude [rad] (count,) of an axis with faults.

    Samples come every ``dt`` [s]; in each of the ``windows`` [s] the attitude is faulty.
    """
    time = np.arange(count) * dt
    faulty = np.zeros(count, np.bool_)
    for start, stop in windows:
        first, last = np.searchsorted(time, (start - 0.5 * dt, stop - 0.5 * dt)).tolist()
        faulty[first:last] = True
    white, walk = sensor.attitude_noise**2, sensor.gyro_noise**2 * dt
    bias_walk = sensor.gyro_bias_walk**2 * dt
    angle, cross, bias = white, 0.0, sensor.gyro_bias**2 / 3.0  # of P; the bias is uniform
    variances = np.empty(count)
    for row, unseen in enumerate(faulty.tolist()):
        if row:
            angle, cross = angle - 2.0 * dt * cross + dt**2 * bias + walk, cross - dt * bias
            bias += bias_walk
            if not unseen:
                gain = 1.0 / (angle + white)
                bias -= gain * cross**2
                angle, cross = angle * white * gain, cross * white * gain
        variances[row] = angle
    return np.sqrt(variances)


def fault_bound(
    sensor: ImuSensor,
    dt: float,
    windows: Sequence[tuple[float, float]],
    ages: Sequence[float],
    averaging: float = AVERAGING,
) -> Floats:
    """Return the bound of the estimate of a fault [rad], a row for each window (w, a).

    The attitude is faulty in the ``windows`` [s], given in the order of time. ``ages`` (a,) are times since
    the onset [s]; one beyond the fault stands for its last sample. ``averaging`` is T [s].
    """
    count = round(windows[-1][1] / dt)
    attitude = attitude_std_dev(sensor, dt, count, windows)
    rows: list[Floats] = []
    for start, stop in windows:
        since = np.minimum(np.asarray(ages), stop - start - dt)
        there = attitude[np.round((start + since) / dt).astype(np.intp)]
        averaged = np.maximum(np.minimum(averaging, since), dt)
        rows.append(np.sqrt(there**2 + sensor.attitude_noise**2 * dt / averaged))
    return np.stack(rows)
