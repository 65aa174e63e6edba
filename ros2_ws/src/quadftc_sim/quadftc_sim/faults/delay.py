"""Values that come late: a slow filter, a congested bus; the stamp does not tell."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

from quadftc_model.arrays import Array, Vector
from quadftc_model.parameters import parameter
from quadftc_sim.delay_line import fill_line, shift_line
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register

LONGEST = 4000  # samples; the longest delay at the highest rate


@register("delay")
class Delay(Fault):
    """The value of ``delay`` ago, in whole samples: `for_period` says how many.

    The state are the values of these samples (..., samples, 3), oldest first. Before there are enough, the
    first value stands for older ones.
    """

    has_memory: ClassVar[bool] = True

    delay: float = parameter(0.0, unit="s", low=0.0, high=1.0, doc="how old the value is")
    samples: int = 0

    def for_period(self, period: float) -> Delay:
        """Return the fault for samples that are ``period`` [s] apart; where they vary, it counts samples."""
        samples = math.floor(min(self.delay / period + 0.5, LONGEST))
        return dataclasses.replace(self, samples=samples)

    def init(self, value: Vector) -> Array:
        """Remember the first value (..., 3)."""
        return fill_line(value, self.samples, value.ndim - 1)

    def step(self, state: Array, inputs: FaultInputs, dt: float) -> tuple[Array, FaultOutput]:
        """Return the oldest value."""
        state, late = shift_line(state, inputs.value, inputs.value.ndim - 1)
        return state, present(late)
