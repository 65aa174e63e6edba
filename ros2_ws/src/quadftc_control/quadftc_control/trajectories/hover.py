"""A place to stay at."""

from __future__ import annotations

from quadftc_control.trajectory import Trajectory, at_origin, register
from quadftc_model.arrays import Scalar, namespace
from quadftc_model.parameters import Axes, parameter
from quadftc_model.samples import PositionReference


@register("hover")
class Hover(Trajectory):
    """Stay at a position."""

    position: Axes = parameter((0.0, 0.0, 1.0), unit="m", low=-1e5, high=1e5, doc="where")
    yaw: float = parameter(0.0, unit="rad", low=-100.0, high=100.0, doc="heading")

    def sample(self, time: Scalar) -> PositionReference:
        """Return the place."""
        still = at_origin(time)
        position = still.position + namespace(time).asarray(self.position)
        return still._replace(position=position, yaw=still.yaw + self.yaw)
