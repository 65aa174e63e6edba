"""Torque that grows: fuel that shifts, ice, wind that freshens."""

import math

from quadftc_model.arrays import Array, namespace
from quadftc_model.parameters import parameter
from quadftc_sim.disturbance import Disturbance, register


@register("ramp")
class Ramp(Disturbance):
    """rate * (t - start), held once it has grown for ``rise``."""

    rate: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="N m/s", doc="slope of each body axis")
    rise: float = parameter(math.inf, unit="s", low=0.0, doc="how long it grows")

    def shape(self, elapsed: Array) -> Array:
        """Torque [N m] (3,) after ``elapsed`` seconds."""
        xp = namespace(elapsed)
        return xp.asarray(self.rate) * xp.minimum(elapsed, self.rise)
