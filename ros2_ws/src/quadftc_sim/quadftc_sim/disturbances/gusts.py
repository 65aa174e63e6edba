"""Torque that wanders: wind gusts, the wash of a wall."""

import functools
import math

import numpy as np

from quadftc_model.arrays import Array, namespace
from quadftc_model.parameters import parameter
from quadftc_sim.disturbance import Disturbance, register

COMPONENTS = 32  # sines of an axis


@register("gusts")
class Gusts(Disturbance):
    """Sines of random phase with the spectrum of a first-order Gauss-Markov process.

        std_dev sqrt(2/K) sum_k sin(w_k t + phase_k),    w_k T = tan(pi/2 q_k),  k = 1 ... K

    The frequencies are quantiles q_k of the spectrum 2 T / (1 + (w T)^2). So each sine has the same power
    (Shinozuka and Deodatis 1991), and the autocorrelation is near exp(-t / T). Each axis has frequencies of
    its own. The same history gives the same gusts.
    """

    std_dev: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), unit="N m", low=0.0, doc="standard deviation about each body axis"
    )
    correlation_time: float = parameter(1.0, unit="s", low=0.01, doc="T, how long a gust lasts")
    history: float = parameter(0.0, unit="1", doc="number from which the phases are drawn")

    @functools.cached_property
    def frequencies(self) -> Array:
        """Angular frequencies w_k [rad/s], (COMPONENTS, 3)."""
        part, axis = np.arange(COMPONENTS)[:, None], np.arange(3)
        # within a part of the spectrum the axes take turns, so that none has the lower frequencies of all
        quantiles = (part + ((part + axis) % 3 + 0.5) / 3.0) / COMPONENTS
        return np.tan(0.5 * math.pi * quantiles) / self.correlation_time

    @functools.cached_property
    def weights(self) -> Array:
        """Amplitudes [N m] of cosine and sine of each frequency, (2, COMPONENTS, 3)."""
        generator = np.random.default_rng(np.array([self.history]).view(np.uint32))
        phases = generator.uniform(0.0, 2.0 * math.pi, (COMPONENTS, 3))
        size = math.sqrt(2.0 / COMPONENTS) * np.array(self.std_dev)
        return size * np.stack([np.sin(phases), np.cos(phases)])

    def shape(self, elapsed: Array) -> Array:
        """Torque [N m] (..., 3) after ``elapsed`` seconds, () or (..., 1)."""
        xp = namespace(elapsed)
        elapsed = xp.asarray(elapsed)
        more = (1,) * (elapsed.ndim - 1)
        angle = xp.reshape(xp.asarray(self.frequencies), (COMPONENTS, *more, 3)) * elapsed
        cosine, sine = xp.reshape(xp.asarray(self.weights), (2, COMPONENTS, *more, 3))
        return (cosine * xp.cos(angle) + sine * xp.sin(angle)).sum(axis=0)
