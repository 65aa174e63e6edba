"""A wrong scale factor: a damaged or badly calibrated sensor."""

from quadftc_model.arrays import namespace
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("scale")
class Scale(Fault):
    """value * (1 + factor): factor -1 is a sensor that reads zero."""

    factor: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="1", doc="relative error of the scale")

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Scale the value."""
        return state, present(inputs.value * (1.0 + namespace(inputs.value).asarray(self.factor)))
