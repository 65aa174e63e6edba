"""Sinusoidal angles, faded in and out."""

from __future__ import annotations

import math

from quadftc_control.reference import Reference, register, smooth_rise
from quadftc_model.arrays import Column, Scalar, cos, namespace, sin
from quadftc_model.parameters import Axes, Timed, parameter
from quadftc_model.samples import AttitudeReference


@register("sine")
class Sine(Timed, Reference):
    """amplitude * sin(frequency (t - start) + phase), with a smooth envelope from ``start`` to ``stop``."""

    amplitude: Axes = parameter((0.0, 0.0, 0.0), unit="rad", low=-100.0, high=100.0, doc="its size")
    frequency: Axes = parameter((1.0, 1.0, 1.0), unit="rad/s", low=0.0, high=1e4, doc="angular frequency")
    phase: Axes = parameter((0.0, 0.0, 0.0), unit="rad", low=-1e6, high=1e6, doc="phase at the start")
    start: float = parameter(0.0, unit="s", low=0.0, doc="begin of the fade-in, scenario time")
    stop: float = parameter(math.inf, unit="s", low=0.0, doc="begin of the fade-out, scenario time")
    fade: float = parameter(2.0, unit="s", low=1e-3, high=1e6, doc="duration of fade-in and fade-out")

    def sample(self, time: Scalar | Column) -> AttitudeReference:
        """Return the oscillation at ``time`` [s]."""
        xp = namespace(time)
        up = smooth_rise((time - self.start) / self.fade)
        down = smooth_rise((time - self.stop) / self.fade)
        envelope = up[0] - down[0]
        envelope_dot = (up[1] - down[1]) / self.fade
        envelope_ddot = (up[2] - down[2]) / self.fade**2
        omega, phase, size = map(xp.asarray, (self.frequency, self.phase, self.amplitude))
        angle = omega * (time - self.start) + phase
        value, slope = size * sin(angle), size * omega * cos(angle)
        return AttitudeReference(
            envelope * value,
            envelope_dot * value + envelope * slope,
            envelope_ddot * value + 2.0 * envelope_dot * slope - envelope * omega**2 * value,
        )
