"""A rotor that gives less thrust at its speed: a worn, bent or taped propeller, ice."""

from quadftc_model.arrays import Scalar, clip, where
from quadftc_model.parameters import parameter
from quadftc_sim.rotor_fault import RotorEffect, RotorFault, register


@register("loss")
class Loss(RotorFault):
    """The share ``value`` of thrust and torque is lost: at once, or growing evenly over ``rise``."""

    value: float = parameter(0.0, unit="1", low=0.0, high=1.0, doc="share of the thrust that is lost")
    rise: float = parameter(0.0, unit="s", low=0.0, doc="time over which the loss grows; 0: a step")

    def effect(self, elapsed: Scalar) -> RotorEffect:
        """Lower the effectiveness."""
        return RotorEffect(effectiveness=1.0 - self.value * grown(elapsed, self.rise))


def grown(elapsed: Scalar, rise: Scalar) -> Scalar:
    """Share (...) of a fault that is there ``elapsed`` [s] after its onset; it grows over ``rise`` [s]."""
    gradual = rise > 0.0
    return where(gradual, clip(elapsed / where(gradual, rise, 1.0), 0.0, 1.0), 1.0)
