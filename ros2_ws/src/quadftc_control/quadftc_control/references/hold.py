"""A constant attitude."""

from __future__ import annotations

from quadftc_control.reference import Reference, level, register
from quadftc_model.arrays import Column, Scalar, namespace
from quadftc_model.parameters import Axes, parameter
from quadftc_model.samples import AttitudeReference


@register("hold")
class Hold(Reference):
    """The same angles at all times."""

    angles: Axes = parameter((0.0, 0.0, 0.0), unit="rad", low=-100.0, high=100.0, doc="roll, pitch, yaw")

    def sample(self, time: Scalar | Column) -> AttitudeReference:
        """Return the angles with zero rates."""
        still = level(time)
        return still._replace(angles=still.angles + namespace(time).asarray(self.angles))
