"""An offset that grows: temperature, ageing; an incipient fault."""

import math

from quadftc_model.arrays import column, namespace, smaller
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("drift")
class Drift(Fault):
    """value + rate * elapsed, held once it has grown for ``rise``."""

    rate: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="{channel_rate}", doc="slope")
    rise: float = parameter(math.inf, unit="s", low=0.0, doc="how long it grows")

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Add the ramp."""
        rate = namespace(inputs.value).asarray(self.rate)
        return state, present(inputs.value + rate * smaller(column(inputs.elapsed), self.rise))
