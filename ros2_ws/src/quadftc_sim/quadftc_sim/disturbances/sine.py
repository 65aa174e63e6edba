"""Sinusoidal torque: gusts, a swinging load, a rotor out of balance."""

from quadftc_model.arrays import Column, Vector, namespace, sin
from quadftc_model.parameters import parameter
from quadftc_sim.disturbance import Disturbance, register


@register("sine")
class Sine(Disturbance):
    """amplitude * sin(frequency (t - start) + phase), each axis with its own numbers."""

    amplitude: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="N m", doc="amplitude of each body axis")
    frequency: tuple[float, ...] = parameter((1.0, 1.0, 1.0), unit="rad/s", low=0.0, doc="angular frequency")
    phase: tuple[float, ...] = parameter((0.0, 0.0, 0.0), unit="rad", doc="phase at the start")

    def shape(self, elapsed: Column) -> Vector:
        """Torque [N m] (..., 3) after ``elapsed`` seconds (..., 1)."""
        xp = namespace(elapsed)
        amplitude, frequency, phase = map(xp.asarray, (self.amplitude, self.frequency, self.phase))
        return amplitude * sin(frequency * elapsed + phase)
