"""A rotor that does not follow its command any more: a speed controller that hangs."""

from quadftc_model.arrays import Scalar
from quadftc_sim.rotor_fault import RotorEffect, RotorFault, register


@register("stuck")
class Stuck(RotorFault):
    """The rotor keeps the speed that it has at the onset."""

    def effect(self, elapsed: Scalar) -> RotorEffect:
        """Hold the speed."""
        return RotorEffect(stuck=True)
