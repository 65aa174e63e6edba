"""Angular acceleration of a real vehicle from its torque commands, fitted to a recorded flight.

Per axis, with the commanded torque per inertia u [rad/s²], the rotors' lag T and a gain g,

    v' = (u - v) / T,    omega' = g v + d

d, the disturbance, is taken for constant in a flight: the fit removes its mean. T is chosen from `LAGS`, g by
least squares, both on means over `WINDOW`: the difference of two gyro samples is noise for the most part.
What inertia and rotors of the vehicle really are, is in g.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LAGS = np.array([2, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 60, 70, 85, 100, 120, 150]) * 1e-3  # s
WINDOW = 0.02  # s


class Motion(NamedTuple):
    """A part of a flight, row by row."""

    time: Floats  # (n,) [s]
    body_rate: Floats  # (n, 3) [rad/s]
    torque: Floats  # (n, 3) commanded from this row on, per inertia [rad/s²]

    def part(self, rows: slice) -> Motion:
        """Return some rows."""
        return Motion(*(column[rows] for column in self))


class AccelerationModel(NamedTuple):
    """What the fit found, per axis."""

    lag: Floats  # (3,) T [s]
    gain: Floats  # (3,) g


def lagged_torque(motion: Motion, lags: Floats) -> Floats:
    """Mean of v between each row and the next (n - 1, ...), for lags that broadcast with the three axes.

    The command is held from row to row, and the rotors have settled on it at the first.
    """
    steps = np.diff(motion.time)
    settled = np.broadcast_to(motion.torque[0], np.broadcast_shapes(np.shape(lags), (3,))).copy()
    means = np.empty((len(steps), *settled.shape))
    for row, dt in enumerate(steps.tolist()):
        error, share = motion.torque[row] - settled, dt / lags
        means[row] = motion.torque[row] + error * np.expm1(-share) / share
        settled -= error * np.expm1(-share)
    return means


def acceleration(motion: Motion) -> Floats:
    """Mean acceleration between each row and the next (n - 1, 3) [rad/s²]."""
    return np.diff(motion.body_rate, axis=0) / np.diff(motion.time)[:, None]


def fit_model(motions: Sequence[Motion]) -> AccelerationModel:
    """Fit the model to parts of flights together."""
    lags = LAGS[:, None]
    pairs = [
        (_centred(lagged_torque(each, lags), each), _centred(acceleration(each), each)) for each in motions
    ]
    across = np.sum([np.einsum("klj,kj->lj", torque, rate) for torque, rate in pairs], axis=0)
    power = np.sum([np.einsum("klj,klj->lj", torque, torque) for torque, _ in pairs], axis=0)
    best = np.argmax(across**2 / power, axis=0)  # what each lag explains of the sum of squares
    axes = np.arange(3)
    return AccelerationModel(LAGS[best], (across / power)[best, axes])


def predict(model: AccelerationModel, motion: Motion) -> Floats:
    """Mean acceleration between each row and the next (n - 1, 3), but for d [rad/s²]."""
    return model.gain * lagged_torque(motion, model.lag)


def explained(model: AccelerationModel, motion: Motion) -> Floats:
    """Share of the variance of the acceleration, in means over `WINDOW`, that the model explains (3,): R²."""
    measured = _centred(acceleration(motion), motion)
    rest = measured - _centred(predict(model, motion), motion)
    return 1.0 - rest.var(axis=0) / measured.var(axis=0)


def _centred(values: Floats, motion: Motion) -> Floats:
    """Moving means over `WINDOW`, less their mean."""
    count = max(1, round(WINDOW / float(np.median(np.diff(motion.time)))))
    sums = np.cumsum(np.concatenate([np.zeros((1, *values.shape[1:])), values]), axis=0)
    means = (sums[count:] - sums[:-count]) / count
    return means - means.mean(axis=0)
