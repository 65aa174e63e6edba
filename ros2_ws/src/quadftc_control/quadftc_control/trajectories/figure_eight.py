"""A level figure of eight."""

from __future__ import annotations

import math

from quadftc_control.trajectory import Trajectory, along, register, there_and_back
from quadftc_model.arrays import Scalar, cos, sin
from quadftc_model.parameters import Axes, Timed, parameter
from quadftc_model.samples import PositionReference


@register("figure_eight")
class FigureEight(Timed, Trajectory):
    """Fly a figure of eight from ``start`` to ``stop``, else rest on it: x = length/2 sin, y = width/2 sin 2.

    With a width of half the length it is the lemniscate of Gerono. It begins at the centre, towards +x, +y.
    """

    centre: Axes = parameter((0.0, 0.0, 1.0), unit="m", low=-1e5, high=1e5, doc="where")
    length: float = parameter(4.0, unit="m", low=1e-3, high=1e5, doc="size along x, from tip to tip")
    width: float = parameter(2.0, unit="m", low=1e-3, high=1e5, doc="size along y")
    period: float = parameter(8.0, unit="s", low=0.1, high=1e5, doc="duration of a round")
    start: float = parameter(0.0, unit="s", low=0.0, doc="begin of the motion, scenario time")
    stop: float = parameter(math.inf, unit="s", low=0.0, doc="begin of the slowing down, scenario time")
    rise: float = parameter(3.0, unit="s", low=1e-2, high=1e6, doc="duration of gain and loss of speed")
    yaw: float = parameter(0.0, unit="rad", low=-100.0, high=100.0, doc="heading")
    follow: bool = parameter(False, doc="the heading is counted from the direction of flight")

    def sample(self, time: Scalar) -> PositionReference:
        """Return the motion at ``time`` [s]."""
        phase = there_and_back(time, self.start, self.stop, self.rise, 2.0 * math.pi / self.period)
        a, b, angle = 0.5 * self.length, 0.5 * self.width, phase.value
        s, c = a * sin(angle), a * cos(angle)
        s_2, c_2 = b * sin(2.0 * angle), b * cos(2.0 * angle)
        curve = ((s, s_2), (c, 2.0 * c_2), (-s, -4.0 * s_2), (-c, -8.0 * c_2))
        return along(self.centre, curve, phase, self.yaw, self.follow)
