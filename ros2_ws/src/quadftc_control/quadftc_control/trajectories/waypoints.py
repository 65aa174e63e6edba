"""From point to point."""

from __future__ import annotations

import math

import numpy as np

from quadftc_control.trajectory import Trajectory, register
from quadftc_model.arrays import AnyArray, Array, Scalar, clip, column, namespace
from quadftc_model.numbers import prepared
from quadftc_model.parameters import Axes, parameter
from quadftc_model.samples import PositionReference

_SHORTEST = 0.1  # s; of a leg without times, were it of no length
_PEAK_SPEED, _PEAK_ACCELERATION = (
    140.0 / 64.0,
    420.0 / 25.0 / math.sqrt(5.0),
)  # 1; of a leg of length and time 1


@register("waypoints")
class Waypoints(Trajectory):
    """Fly straight from point to point, at rest at each: the legs of least snap.

    The polynomial of degree 7 has three derivatives that vanish at both ends of a leg. Source: Mellinger and
    Kumar (2011), Minimum snap trajectory generation and control for quadrotors, IEEE ICRA.
    """

    points: Axes = parameter(
        (0.0, 0.0, 1.0), unit="m", low=-1e5, high=1e5, rows_of=3, doc="where to, in turn"
    )
    times: Axes = parameter(
        (), unit="s", low=0.0, high=1e6, rows_of=1, doc="after start, when to be at each; none: by speed"
    )
    speed: float = parameter(1.0, unit="m/s", low=1e-3, high=100.0, doc="largest on a leg, without times")
    acceleration: float = parameter(2.0, unit="m/s^2", low=1e-3, high=100.0, doc="the same")
    start: float = parameter(0.0, unit="s", low=0.0, high=1e6, doc="when to leave, scenario time")
    yaw: float = parameter(0.0, unit="rad", low=-100.0, high=100.0, doc="heading")

    def __post_init__(self) -> None:
        """Check the points and times."""
        super().__post_init__()
        count = len(self.points) // 3
        if not self.points:
            raise ValueError("points: expected one at least")
        if self.times and len(self.times) != count:
            raise ValueError(f"times: expected {count} numbers, one for each of points, or none")
        if any(b <= a for a, b in zip(self.times, self.times[1:], strict=False)):
            raise ValueError(f"times = {self.times}: each must be later than the one before")

    @prepared
    def legs(self) -> AnyArray:
        """From each point to the next, (n, 5): change in x, y, z [m], begin after start [s], duration [s]."""
        change = np.diff(np.reshape(self.points, (-1, 3)), axis=0)
        distance = np.sqrt(np.sum(change**2, axis=1))
        if self.times:
            begin, duration = np.array(self.times[:-1]), np.diff(self.times)
        else:
            needed = np.sqrt(_PEAK_ACCELERATION * distance / self.acceleration)
            duration = np.maximum(np.maximum(_PEAK_SPEED * distance / self.speed, needed), _SHORTEST)
            begin = np.cumsum(duration) - duration
        return np.column_stack([change, begin, duration])

    def sample(self, time: Scalar) -> PositionReference:
        """Return the motion at ``time`` [s]."""
        change, begin, duration = self.legs[:, :3], self.legs[:, 3], self.legs[:, 4]
        value, rate, slope, curvature = _rise((column(time) - self.start - begin) / duration)  # (..., n)
        xp = namespace(time)
        zero = xp.zeros_like(time)
        return PositionReference(
            position=xp.asarray(self.points[:3]) + value @ change,
            velocity=(rate / duration) @ change,
            acceleration=(slope / duration**2) @ change,
            yaw=self.yaw + zero,
            yaw_rate=zero,
            jerk=(curvature / duration**3) @ change,
        )


def _rise(fraction: Array) -> tuple[Array, Array, Array, Array]:
    """Rise from 0 to 1 over a fraction of 0 to 1, held outside; with three derivatives, zero at both ends."""
    s = clip(fraction, 0.0, 1.0)
    u, v = s * (1.0 - s), 1.0 - 2.0 * s
    value = s * s * s * s * (35.0 + s * (-84.0 + s * (70.0 - 20.0 * s)))
    return value, 140.0 * u * u * u, 420.0 * u * u * v, 840.0 * u * (v * v - u)
