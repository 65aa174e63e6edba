"""Torque that wanders: wind gusts, the wash of a wall."""

import math

import numpy as np

from quadftc_model.arrays import Column, Vector
from quadftc_model.numbers import prepared
from quadftc_model.parameters import parameter
from quadftc_sim.disturbance import Disturbance, register
from quadftc_sim.random_sines import SCALE, Floats, cosines_and_sines, spectral_quantiles, sum_of_sines


@register("gusts")
class Gusts(Disturbance):
    """Sines of random phase with the spectrum of a first-order Gauss-Markov process.

        w_k T = tan(pi/2 q_k),  k = 1 ... K

    The frequencies are quantiles q_k of the spectrum 2 T / (1 + (w T)^2): :mod:`quadftc_sim.random_sines`.
    So the autocorrelation is near exp(-t / T). The same history gives the same gusts.
    """

    std_dev: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), unit="N m", low=0.0, doc="standard deviation about each body axis"
    )
    correlation_time: float = parameter(1.0, unit="s", low=0.01, doc="T, how long a gust lasts")
    history: float = parameter(0.0, unit="1", doc="number from which the phases are drawn")

    @prepared
    def frequencies(self) -> Floats:
        """Angular frequencies w_k [rad/s], (COMPONENTS, 3)."""
        return np.tan(0.5 * math.pi * spectral_quantiles()) / self.correlation_time

    @prepared
    def weights(self) -> Floats:
        """Amplitudes [N m] of cosine and sine of each frequency, (2, COMPONENTS, 3)."""
        return SCALE * np.array(self.std_dev) * cosines_and_sines(self.history)

    def shape(self, elapsed: Column) -> Vector:
        """Torque [N m] (..., 3) after ``elapsed`` seconds (..., 1)."""
        return sum_of_sines(self.frequencies, self.weights, elapsed)
