"""A constant attitude."""

from __future__ import annotations

from quadftc_control.reference import Reference, register
from quadftc_model.arrays import Array, namespace
from quadftc_model.parameters import Axes, parameter
from quadftc_model.samples import AttitudeReference


@register("hold")
class Hold(Reference):
    """The same angles at all times."""

    angles: Axes = parameter((0.0, 0.0, 0.0), unit="rad", low=-100.0, high=100.0, doc="roll, pitch, yaw")

    def sample(self, time: Array) -> AttitudeReference:
        """Return the angles with zero rates."""
        xp = namespace(time)
        zeros = 0.0 * time + xp.zeros(3)
        return AttitudeReference(zeros + xp.asarray(self.angles), zeros, zeros)
