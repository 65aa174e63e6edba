"""Random signals as sums of sines: functions of time alone, in whatever order they are asked.

    x(t) = sqrt(2/K) sum_k sin(w_k t + phase_k),    k = 1 ... K

The frequencies w_k are quantiles of the signal's spectrum. So each sine has the same power (Shinozuka and
Deodatis 1991), and x has variance 1. Three such signals, with frequencies of their own, make a vector.
"""

import math

import numpy as np
from numpy.typing import NDArray

from quadftc_model.arrays import Array, Column, Vector, column, cos, sin

COMPONENTS = 32  # K, sines of a signal
SCALE = math.sqrt(2.0 / COMPONENTS)

Floats = NDArray[np.float64]


def spectral_quantiles() -> Floats:
    """Quantiles of the spectrum for the frequencies of three signals, (COMPONENTS, 3), within (0, 1).

    Within a part of the spectrum the signals take turns, so that none has the lower frequencies of all.
    """
    part, signal = np.arange(COMPONENTS)[:, None], np.arange(3)
    return (part + ((part + signal) % 3 + 0.5) / 3.0) / COMPONENTS


def cosines_and_sines(history: float) -> Floats:
    """Weights of the cosine and the sine of w_k t, (2, COMPONENTS, 3), for phases drawn from a number."""
    generator = np.random.default_rng(np.array([history]).view(np.uint32))
    phases = generator.uniform(0.0, 2.0 * math.pi, (COMPONENTS, 3))
    return np.stack([np.sin(phases), np.cos(phases)])


def sum_of_sines(frequencies: Array, weights: Array, time: Column) -> Vector:
    """Sum the weighted cosines and sines, (..., 3), at a time [s] (..., 1).

    Flights of a batch that differ in the weights alone share the cosines and sines.
    """
    angle = frequencies * column(time)  # (..., COMPONENTS, 3)
    return (weights[0] * cos(angle) + weights[1] * sin(angle)).sum(axis=-2)
