"""An offset that oscillates: a resonance, interference."""

from quadftc_model.arrays import column, namespace, sin
from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, present, register


@register("sine")
class Sine(Fault):
    """value + amplitude * sin(frequency * elapsed + phase)."""

    amplitude: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="{channel}", doc="amplitude")
    frequency: tuple[float, ...] = parameter((1.0, 1.0, 1.0), unit="rad/s", low=0.0, doc="angular frequency")
    phase: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="rad", doc="phase at the onset")

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Add the oscillation."""
        xp = namespace(inputs.value)
        amplitude, frequency, phase = map(xp.asarray, (self.amplitude, self.frequency, self.phase))
        return state, present(inputs.value + amplitude * sin(frequency * column(inputs.elapsed) + phase))
