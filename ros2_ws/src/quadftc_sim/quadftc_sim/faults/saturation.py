"""A reading that ends at a limit: a range too small for the motion, a converter at its end."""

import math
from typing import ClassVar

from quadftc_model.arrays import clip
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("saturation")
class Saturation(Fault):
    """The value, held within +-limit. An attitude sensor has no range to leave."""

    channels: ClassVar[tuple[str, ...]] = ("gyro", "accelerometer")

    limit: float = parameter(math.inf, unit="{channel}", low=0.0, doc="largest size of a reading")

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Hold the value within the limit."""
        return state, present(clip(inputs.value, -self.limit, self.limit))
