"""An offset that comes and goes: a small fault."""

from quadftc_model.arrays import namespace
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("flicker")
class Flicker(Fault):
    """value + size in the first half of every period, value in the second."""

    size: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="{channel}", doc="offset")
    period: float = parameter(2.0, unit="s", low=1e-3, doc="time from one offset to the next")

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Add the offset where it is there."""
        xp = namespace(inputs.value)
        there = inputs.elapsed % self.period < 0.5 * self.period
        return state, present(inputs.value + xp.where(there, 1.0, 0.0) * xp.asarray(self.size))
