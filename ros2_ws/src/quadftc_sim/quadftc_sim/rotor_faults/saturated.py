"""A rotor that does not reach its full speed: a hot motor, a weak battery, a current limit."""

import math

from quadftc_model.arrays import Scalar
from quadftc_model.parameters import parameter
from quadftc_sim.rotor_fault import RotorEffect, RotorFault, register


@register("saturated")
class Saturated(RotorFault):
    """The rotor turns no faster than ``limit``."""

    limit: float = parameter(math.inf, unit="rad/s", low=0.0, doc="largest speed of the rotor")

    def effect(self, elapsed: Scalar) -> RotorEffect:
        """Lower the largest speed."""
        return RotorEffect(speed_limit=self.limit)
