"""Not a number: a driver that divides by zero, a message half written."""

import math

from quadftc_model.arrays import namespace
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("nan")
class Nan(Fault):
    """NaN in place of the value."""

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Replace the value."""
        return state, present(namespace(inputs.value).full_like(inputs.value, math.nan))
