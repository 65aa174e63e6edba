# pyright: basic
"""The fault injector node: puts faults on IMU and rotors, by schedule and by service, and says what it did.

Inputs: plant/imu (or a real IMU, by remapping).
Outputs: imu/data. The truth on fault/injected (attitude [rad]), and once such a fault was asked for on
fault/injected/gyro and fault/injected/accelerometer. fault/dropped (the stamp of each sample withheld). In
free flight rotors/fault, the condition of the rotors from a sample on.
Services: ~/inject (quadftc_msgs/InjectFault), ~/clear (quadftc_msgs/ClearFault), ~/reset (std_srvs/Trigger:
the schedule restarts with the next sample, faults injected by service are gone).
"""

from __future__ import annotations

from functools import partial
from typing import Any

from quadftc_compile.engine import engine_from
from quadftc_model.samples import ImuSample
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_ros.wire import imu_of
from quadftc_sim.assembly import InjectorParameters, injector_from
from quadftc_sim.injector_ports import InjectorPorts


class FaultInjectorNode(GraphNode):
    """Faults on a stream of IMU samples, and on rotors."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("fault_injector", **kwargs)
        self.settings.declare(InjectorParameters, read_only=True)
        example = "bias axes=roll value=1deg start=20s"
        self.settings.declare_list("faults", f"each: kind key=value..., e.g. '{example}'")
        values = self.settings.values()
        make = partial(injector_from, values, engine_from(values, self.get_logger().info))
        self._ports = InjectorPorts(self, make, values["rotors"], self.plant_kind == "free_flight")
        self._last_ns = -1
        self.driven_by("plant/imu", self._on_imu, restart=self._restart, decode=imu_of)
        self.ready()

    def _restart(self) -> None:
        self._ports.restart()
        self._last_ns = -1

    def _on_imu(self, stamp_ns: int, sample: ImuSample) -> None:
        if stamp_ns <= self._last_ns:
            self.diagnostics.count("plant/imu: stamp repeated or went back")
            return
        self._last_ns = stamp_ns
        self._ports.publish(stamp_ns, self._ports.injector.apply(stamp_ns, sample))
        self.sampled(stamp_ns)

    def report(self) -> None:
        """Report the faults that act."""
        level, words, active = self._ports.status()
        self.diagnostics.report("faults", level, words, **active)


main = partial(run_node, FaultInjectorNode)
