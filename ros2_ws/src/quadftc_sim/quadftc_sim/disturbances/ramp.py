"""Torque that grows: fuel that shifts, ice, wind that freshens."""

import math

from quadftc_model.arrays import Column, Vector, namespace, smaller
from quadftc_model.parameters import parameter
from quadftc_sim.disturbance import Disturbance, register


@register("ramp")
class Ramp(Disturbance):
    """rate * (t - start), held once it has grown for ``rise``."""

    rate: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="N m/s", doc="slope of each body axis")
    rise: float = parameter(math.inf, unit="s", low=0.0, doc="how long it grows")

    def shape(self, elapsed: Column) -> Vector:
        """Torque [N m] (..., 3) after ``elapsed`` seconds (..., 1)."""
        return namespace(elapsed).asarray(self.rate) * smaller(elapsed, self.rise)
