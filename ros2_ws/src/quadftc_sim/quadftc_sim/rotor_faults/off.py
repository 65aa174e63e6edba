"""A rotor without power: a broken motor, a burnt speed controller, a lost propeller."""

from quadftc_model.arrays import Scalar
from quadftc_sim.rotor_fault import RotorEffect, RotorFault, register


@register("off")
class Off(RotorFault):
    """The rotor runs down through its lag and stands still."""

    def effect(self, elapsed: Scalar) -> RotorEffect:
        """Allow no speed."""
        return RotorEffect(speed_limit=0.0)
