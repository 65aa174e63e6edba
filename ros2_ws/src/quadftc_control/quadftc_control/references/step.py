"""A smooth step: from zero to an attitude and, if wanted, back."""

from __future__ import annotations

import math

from quadftc_control.reference import Reference, register, smooth_rise
from quadftc_model.arrays import Column, Scalar, namespace
from quadftc_model.parameters import Axes, Timed, parameter
from quadftc_model.samples import AttitudeReference


@register("step")
class Step(Timed, Reference):
    """Rises over ``rise`` from ``start``, and falls likewise from ``stop``.

    Angle, rate and acceleration are continuous.
    """

    angles: Axes = parameter((0.0, 0.0, 0.0), unit="rad", low=-100.0, high=100.0, doc="of the plateau")
    start: float = parameter(0.0, unit="s", low=0.0, doc="begin of the rise, scenario time")
    stop: float = parameter(math.inf, unit="s", low=0.0, doc="begin of the fall, scenario time")
    rise: float = parameter(2.0, unit="s", low=1e-3, high=1e6, doc="duration of rise and fall")

    def sample(self, time: Scalar | Column) -> AttitudeReference:
        """Return the step at ``time`` [s]."""
        up = smooth_rise((time - self.start) / self.rise)
        down = smooth_rise((time - self.stop) / self.rise)
        angles = namespace(time).asarray(self.angles)
        return AttitudeReference(
            angles * (up[0] - down[0]),
            angles * (up[1] - down[1]) / self.rise,
            angles * (up[2] - down[2]) / self.rise**2,
        )
