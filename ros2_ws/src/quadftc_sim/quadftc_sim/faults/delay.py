"""Values that come late: a slow filter, a congested bus; the stamp does not tell."""

import math
from typing import ClassVar, NamedTuple

from quadftc_model.arrays import Array
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


class Past(NamedTuple):
    """Values of the last samples, oldest first; before there are enough, the first stands for older ones."""

    values: tuple[Array, ...]


@register("delay")
class Delay(Fault):
    """The value of ``delay`` ago, in whole samples."""

    has_memory: ClassVar[bool] = True

    delay: float = parameter(0.0, unit="s", low=0.0, high=1.0, doc="how old the value is")

    def init(self, value: Array) -> Past:
        """Remember the first value (..., 3)."""
        return Past((value,))

    def step(self, state: Past, inputs: FaultInputs, dt: float) -> tuple[Past, FaultOutput]:
        """Return the oldest value wanted; at the start of a flight the oldest that there is."""
        if dt == 0.0:
            return state, present(state.values[0])
        count = math.floor(self.delay / dt + 0.5)
        values = (*state.values, inputs.value)
        values = (values[0],) * (count + 1 - len(values)) + values
        return Past(values[-(count + 1) :]), present(values[-(count + 1)])
