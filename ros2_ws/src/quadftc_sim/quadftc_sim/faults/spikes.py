"""Single samples far off: bit errors, electric discharge."""

from typing import ClassVar

from quadftc_model.arrays import column, namespace, where
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("spikes")
class Spikes(Fault):
    """Spikes of a fixed size and random sign, as a Poisson process on each axis."""

    is_random: ClassVar[bool] = True

    amplitude: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="{channel}", doc="size of a spike")
    rate: float = parameter(1.0, unit="1/s", low=0.0, doc="mean number of spikes in a second")

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Add a spike to the samples that the numbers drawn choose."""
        amplitude = namespace(inputs.value).asarray(self.amplitude)
        spike = amplitude * where(inputs.normal < 0.0, -1.0, 1.0)
        hit = inputs.uniform < column(self.rate * dt)
        return state, present(inputs.value + where(hit, spike, 0.0))
