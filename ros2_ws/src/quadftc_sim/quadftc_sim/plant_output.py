# pyright: basic
"""The publishers of the plant node."""

from __future__ import annotations

from collections.abc import Callable

from rosgraph_msgs.msg import Clock

from quadftc_ros.conversions import NANOSECONDS
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME
from quadftc_ros.wire import ImuWire, VectorWire
from quadftc_sim.simulator import Emission


class PlantOutput:
    """What the plant publishes of an emission: the IMU sample at once, the truth when nobody waits for it.

    ``each_sample()`` is called after each emission.
    """

    def __init__(self, node: GraphNode, each_sample: Callable[[], None]) -> None:
        self._node, self._each_sample = node, each_sample
        self._publish_imu, self._imu = node.publishes("plant/imu"), ImuWire()
        body = VectorWire(BASE_FRAME)
        self._truth = (
            (node.publishes("plant/attitude"), VectorWire(EARTH_FRAME), "angles"),
            (node.publishes("plant/rate"), body, "body_rate"),
            (node.publishes("disturbance/applied"), body, "disturbance"),
        )
        self._publish_clock = node.publishes("/clock") if node.lockstep else None
        self._clock = Clock()
        self._stamp_ns = 0  # of the last emission
        self.pending: Emission | None = None  # whose truth is still to be published

    def emit(self, emission: Emission | None) -> None:
        """Publish clock and sample; in real time the truth waits for `show_truth`. None: the flight ended."""
        self.show_truth()
        if emission is None:
            self._node.diagnostics.changed = True
            self._node.sampled(self._stamp_ns)
            return
        if self._publish_clock is not None:
            self._clock.clock.sec, self._clock.clock.nanosec = divmod(emission.stamp_ns, NANOSECONDS)
            self._publish_clock(self._clock)
        if emission.sample is not None:  # first, as others wait for it
            self._publish_imu(self._imu(emission.sample_stamp_ns, emission.sample))
        self.pending, self._stamp_ns = emission, emission.stamp_ns
        if self._publish_clock is not None:
            self.show_truth()

    def show_truth(self) -> None:
        """Publish the truth of the last emission, if that has not been done."""
        if (emission := self.pending) is None:
            return
        self.pending = None
        for publish, wire, name in self._truth:
            publish(wire(emission.stamp_ns, getattr(emission, name)))
        self._node.sampled(emission.stamp_ns)
        self._each_sample()
