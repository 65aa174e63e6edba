"""Mean wind."""

from quadftc_model.arrays import Column, Vector, namespace
from quadftc_model.parameters import Axes, parameter
from quadftc_sim.wind import Wind, register


@register("constant")
class Constant(Wind):
    """The same wind all the time."""

    velocity_mean: Axes = parameter(
        (0.0, 0.0, 0.0), unit="m/s", low=-100.0, high=100.0, doc="east, north, up"
    )

    def shape(self, elapsed: Column) -> Vector:
        """Velocity of the air [m/s] (3,), the same at any time."""
        return namespace(elapsed).asarray(self.velocity_mean)
