"""One gust, as the specification of flying qualities has it."""

import math

from quadftc_model.arrays import Column, Vector, clip, cos, namespace
from quadftc_model.parameters import Axes, parameter
from quadftc_sim.wind import Wind, register


@register("gust")
class Gust(Wind):
    """A gust of the shape 1 - cosine, MIL-F-8785C (1980), 3.7.1.3.

        v = v_m / 2 (1 - cos(pi x / d_m)) for 0 <= x <= d_m, then v_m

    Here x = V t, so that ``rise`` is d_m / V: the gust's length over the airspeed. The specification keeps
    v_m. Here the wind lasts for ``hold`` and falls as it rose; with no hold it is the gust of certification.
    """

    amplitude: Axes = parameter(
        (0.0, 0.0, 0.0), unit="m/s", low=-100.0, high=100.0, doc="v_m: east, north, up"
    )
    rise: float = parameter(1.0, unit="s", low=0.01, doc="d_m / V, how long the gust grows")
    hold: float = parameter(0.0, unit="s", low=0.0, doc="how long it lasts at its peak")

    def shape(self, elapsed: Column) -> Vector:
        """Velocity of the air [m/s] (..., 3) after ``elapsed`` seconds (..., 1)."""
        grown = self._half_wave(elapsed) - self._half_wave(elapsed - self.rise - self.hold)
        return namespace(elapsed).asarray(self.amplitude) * grown

    def _half_wave(self, elapsed: Column) -> Column:
        """Grow from 0 to 1 within the rise."""
        return 0.5 - 0.5 * cos(math.pi * clip(elapsed / self.rise, 0.0, 1.0))
