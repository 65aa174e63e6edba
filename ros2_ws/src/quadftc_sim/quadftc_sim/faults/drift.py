"""An offset that grows: temperature, ageing; an incipient fault."""

import math
from typing import Any

from quadftc_model.arrays import namespace
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("drift")
class Drift(Fault):
    """value + rate * elapsed, held once it has grown for ``rise``."""

    rate: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="{channel_rate}", doc="slope")
    rise: float = parameter(math.inf, unit="s", low=0.0, doc="how long it grows")

    def step(self, state: Any, inputs: FaultInputs, dt: float) -> tuple[Any, FaultOutput]:
        """Add the ramp."""
        xp = namespace(inputs.value)
        return state, present(inputs.value + xp.asarray(self.rate) * xp.minimum(inputs.elapsed, self.rise))
