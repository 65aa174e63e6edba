"""Constant torque: an off-centre load, a steady side wind."""

from quadftc_model.arrays import Column, Vector, namespace
from quadftc_model.parameters import parameter
from quadftc_sim.disturbance import Disturbance, register


@register("constant")
class Constant(Disturbance):
    """A torque that is constant from its start to its stop."""

    amplitude: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="N m", doc="torque of each body axis")

    def shape(self, elapsed: Column) -> Vector:
        """Torque [N m] (3,), the same at any time."""
        return namespace(elapsed).asarray(self.amplitude)
