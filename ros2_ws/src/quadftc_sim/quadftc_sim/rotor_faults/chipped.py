"""A propeller that misses a piece: it gives less thrust, and shakes the vehicle at its speed."""

from quadftc_model.arrays import Scalar
from quadftc_model.parameters import parameter
from quadftc_sim.rotor_fault import RotorEffect, RotorFault, register


@register("chipped")
class Chipped(RotorFault):
    """A loss, with a force unbalance * speed² that turns with the rotor in its plane."""

    value: float = parameter(0.0, unit="1", low=0.0, high=1.0, doc="share of the thrust that is lost")
    unbalance: float = parameter(
        0.0, unit="kg m", low=0.0, high=0.01, doc="mass that is missing times its distance from the axis"
    )

    def effect(self, elapsed: Scalar) -> RotorEffect:
        """Lower the effectiveness, and unbalance the rotor."""
        return RotorEffect(effectiveness=1.0 - self.value, unbalance=self.unbalance)
