"""A constant offset: a knock, a wrong calibration, a magnetic anomaly."""

from quadftc_model.arrays import namespace
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("bias")
class Bias(Fault):
    """value + offset: the step f_s of Wang et al. (2021)."""

    value: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="{channel}", doc="offset")

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Add the offset."""
        return state, present(inputs.value + namespace(inputs.value).asarray(self.value))
