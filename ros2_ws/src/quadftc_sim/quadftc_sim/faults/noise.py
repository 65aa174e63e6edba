"""Noise on top: a loose connection, vibration, a failing converter."""

from typing import ClassVar

from quadftc_model.arrays import namespace
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("noise")
class Noise(Fault):
    """value + white Gaussian noise."""

    is_random: ClassVar[bool] = True

    sigma: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), unit="{channel}", low=0.0, doc="standard deviation of a sample"
    )

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Add the noise."""
        return state, present(inputs.value + namespace(inputs.value).asarray(self.sigma) * inputs.normal)
