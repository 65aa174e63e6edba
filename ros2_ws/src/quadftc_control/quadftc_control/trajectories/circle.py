"""A level circle."""

from __future__ import annotations

import math

from quadftc_control.trajectory import Trajectory, along, register, there_and_back
from quadftc_model.arrays import Scalar, cos, sin
from quadftc_model.parameters import Axes, Timed, parameter
from quadftc_model.samples import PositionReference


@register("circle")
class Circle(Timed, Trajectory):
    """Fly a circle, counter-clockwise from above, from ``start`` to ``stop``; else rest on it.

    It begins at the centre plus (radius, 0, 0). The speed rises smoothly, and so does the acceleration.
    """

    centre: Axes = parameter((0.0, 0.0, 1.0), unit="m", low=-1e5, high=1e5, doc="where")
    radius: float = parameter(2.0, unit="m", low=1e-3, high=1e5, doc="its radius")
    speed: float = parameter(1.0, unit="m/s", low=-100.0, high=100.0, doc="along it; negative: clockwise")
    start: float = parameter(0.0, unit="s", low=0.0, doc="begin of the motion, scenario time")
    stop: float = parameter(math.inf, unit="s", low=0.0, doc="begin of the slowing down, scenario time")
    rise: float = parameter(3.0, unit="s", low=1e-2, high=1e6, doc="duration of gain and loss of speed")
    yaw: float = parameter(0.0, unit="rad", low=-100.0, high=100.0, doc="heading")
    follow: bool = parameter(False, doc="the heading is counted from the direction of flight")

    def sample(self, time: Scalar) -> PositionReference:
        """Return the motion at ``time`` [s]."""
        phase = there_and_back(time, self.start, self.stop, self.rise, self.speed / self.radius)
        x, y = self.radius * cos(phase.value), self.radius * sin(phase.value)
        return along(self.centre, ((x, y), (-y, x), (-x, -y), (y, -x)), phase, self.yaw, self.follow)
