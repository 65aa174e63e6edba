# pyright: basic
"""What the plant publishes of an emission: the IMU sample at once, the truth when nobody waits for it."""

from __future__ import annotations

from collections.abc import Callable

from rosgraph_msgs.msg import Clock

from quadftc_ros.conversions import NANOSECONDS
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME
from quadftc_ros.wire import ImuWire, VectorWire
from quadftc_sim.simulator import Emission


class PlantOutput:
    """The publishers of the plant.

    Parameters
    ----------
    node : GraphNode
    each_sample : callable, optional
        Called after each emission.
    """

    def __init__(self, node: GraphNode, each_sample: Callable[[], None] | None) -> None:
        self._node, self._each_sample = node, each_sample
        self._stamp_ns = 0  # of the last emission
        self._publish_imu = node.publishes("plant/imu")
        self._publish_attitude = node.publishes("plant/attitude")
        self._publish_rate = node.publishes("plant/rate")
        self._publish_disturbance = node.publishes("disturbance/applied")
        self._publish_clock = node.publishes("/clock") if node.lockstep else None
        self._imu, self._body, self._earth = ImuWire(), VectorWire(BASE_FRAME), VectorWire(EARTH_FRAME)
        self._clock = Clock()
        self._pending: Emission | None = None  # whose truth is still to be published

    def emit(self, emission: Emission) -> None:
        """Publish clock and sample; in real time the truth waits for `show_truth`."""
        if self._publish_clock is not None:
            self._clock.clock.sec, self._clock.clock.nanosec = divmod(emission.stamp_ns, NANOSECONDS)
            self._publish_clock(self._clock)
        if emission.sample is not None:  # first, as others wait for it
            self._publish_imu(self._imu(emission.sample_stamp_ns, emission.sample))
        self._pending, self._stamp_ns = emission, emission.stamp_ns
        if self._publish_clock is not None:
            self.show_truth()

    def show_truth(self) -> None:
        """Publish the truth of the last emission, if that has not been done."""
        emission, self._pending = self._pending, None
        if emission is None:
            return
        now = emission.stamp_ns
        self._publish_attitude(self._earth(now, emission.angles))
        self._publish_rate(self._body(now, emission.body_rate))
        self._publish_disturbance(self._body(now, emission.disturbance))
        self._node.sampled(now)
        if self._each_sample is not None:
            self._each_sample()

    def end(self) -> None:
        """Note that the flight has had its length."""
        self._node.diagnostics.changed = True
        self._node.sampled(self._stamp_ns)

    def forget(self) -> None:
        """Leave the truth of the last emission unpublished: a new flight begins."""
        self._pending = None
