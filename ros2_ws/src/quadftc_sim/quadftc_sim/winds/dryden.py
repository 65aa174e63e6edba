"""Turbulence near the ground."""

import math

import numpy as np

from quadftc_model.arrays import Column, Vector, namespace
from quadftc_model.numbers import prepared
from quadftc_model.parameters import parameter
from quadftc_sim.random_sines import SCALE, Floats, cosines_and_sines, spectral_quantiles, sum_of_sines
from quadftc_sim.wind import Wind, register

FOOT = 0.3048  # m


@register("dryden")
class Dryden(Wind):
    """Turbulence with the Dryden spectra of the low-altitude model of MIL-F-8785C (1980), 3.7.3.4.

        L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2 [ft]
        sigma_w = 0.1 W_20, sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4
        Phi_u = 2 sigma_u² / pi (L/V) / (1 + x²),    Phi_v,w = sigma² / pi (L/V) (1 + 3 x²) / (1 + x²)²

    with x = w L / V, over w > 0. u lies along the mean wind, v to its left, w up; none knows the others.
    The field is frozen: it passes with the constant ``airspeed`` V, at the constant ``height`` h. W_20 is the
    mean wind at 20 ft: 7.7 m/s light, 15 m/s moderate, 23 m/s severe. The wind ``constant`` adds the mean.

    Each component is a sum of sines (:mod:`quadftc_sim.random_sines`). The same history gives the same wind.
    """

    wind_speed: float = parameter(5.0, unit="m/s", low=0.0, high=100.0, doc="W_20, mean wind at 6 m")
    height: float = parameter(6.0, unit="m", low=10.0 * FOOT, high=1000.0 * FOOT, doc="h, above ground")
    airspeed: float = parameter(5.0, unit="m/s", low=0.1, high=100.0, doc="V, by which the field passes")
    direction: float = parameter(0.0, unit="rad", doc="to which the mean wind blows, from east to north")
    history: float = parameter(0.0, unit="1", doc="number from which the phases are drawn")

    @prepared
    def scale_lengths(self) -> Floats:
        """L_u, L_v, L_w [m], (3,)."""
        length = self.height / self._height_term**1.2
        return np.array([length, length, self.height])

    @prepared
    def std_devs(self) -> Floats:
        """Standard deviations sigma_u, sigma_v, sigma_w [m/s], (3,)."""
        vertical = 0.1 * self.wind_speed
        horizontal = vertical / self._height_term**0.4
        return np.array([horizontal, horizontal, vertical])

    @prepared
    def frequencies(self) -> Floats:
        """Angular frequencies w_k [rad/s] of u, v, w, (COMPONENTS, 3)."""
        quantiles = spectral_quantiles()
        x = np.concatenate([np.tan(0.5 * math.pi * quantiles[:, :1]), _transverse(quantiles[:, 1:])], axis=1)
        return x * self.airspeed / self.scale_lengths

    @prepared
    def weights(self) -> Floats:
        """Amplitudes [m/s] of cosine and sine of each frequency, (2, COMPONENTS, 3)."""
        return SCALE * self.std_devs * cosines_and_sines(self.history)

    @prepared
    def axes(self) -> Floats:
        """Directions of u, v, w in earth axes, (3, 3), by rows."""
        cosine, sine = math.cos(self.direction), math.sin(self.direction)
        return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])

    def shape(self, elapsed: Column) -> Vector:
        """Velocity of the air [m/s] (..., 3) after ``elapsed`` seconds (..., 1)."""
        velocity = sum_of_sines(self.frequencies, self.weights, elapsed)
        return velocity @ namespace(velocity).asarray(self.axes)

    @property
    def _height_term(self) -> float:
        return 0.177 + 0.000823 * self.height / FOOT


def _transverse(quantiles: Floats) -> Floats:
    """Return x = w L / V at quantiles q of the spectrum of v and w.

    Its integral up to x = tan a is (2 a - sin(2 a) / 2) / pi. Newton finds a; the slope is in [1, 3].
    """
    angle = 0.5 * math.pi * quantiles
    for _ in range(30):
        angle = angle - (2.0 * angle - 0.5 * np.sin(2.0 * angle) - math.pi * quantiles) / (
            2.0 - np.cos(2.0 * angle)
        )
    return np.tan(angle)
