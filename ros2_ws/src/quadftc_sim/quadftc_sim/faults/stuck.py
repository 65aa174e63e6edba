"""A sensor that repeats its last good value: a frozen driver, a dead bus."""

from typing import ClassVar

from quadftc_model.arrays import Vector, column, where
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("stuck")
class Stuck(Fault):
    """The value at the onset, for as long as the fault lasts."""

    has_memory: ClassVar[bool] = True

    def init(self, value: Vector) -> Vector:
        """Remember the first value (..., 3)."""
        return value

    def step(self, state: Vector, inputs: FaultInputs, dt: float) -> tuple[Vector, FaultOutput]:
        """Follow the value up to the onset, then hold it."""
        held = where(column(inputs.elapsed <= 0.0), inputs.value, state)
        return held, present(held)
