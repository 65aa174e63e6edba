# pyright: basic
"""The disturbance observer node: estimates the disturbance as an angular acceleration.

Inputs: imu/corrected, torque/command; in real time disturbance/kept: restarted in flight, the node resumes
from the last estimate of the one before.
Outputs: disturbance/estimate [rad/s²].
Services: ~/reset (std_srvs/Trigger). A sample whose stamp repeats or goes back is refused and counted.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

from quadftc_compile.engine import engine_from
from quadftc_fdi import disturbance_observer as observer
from quadftc_model.parameters import parameter
from quadftc_model.samples import ImuSample, has_rate
from quadftc_ros.conversions import Floats
from quadftc_ros.diagnostics import ERROR, OK
from quadftc_ros.executor import run_node
from quadftc_ros.join import CommandGate
from quadftc_ros.limits import limits_of
from quadftc_ros.node import GraphNode
from quadftc_ros.parameters import STAYS, VehicleParameters
from quadftc_ros.wire import VectorWire, imu_of, vector_of


@dataclasses.dataclass(frozen=True)
class ObserverParameters:
    """Parameters of the node besides those of the observer, which stand behind its name."""

    observer: str = parameter("exosystem", doc="name of the disturbance observer; may be changed in flight")


class DisturbanceObserverNode(GraphNode):
    """A disturbance observer on the stream of corrected IMU samples."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("disturbance_observer", **kwargs)
        self.settings.declare(VehicleParameters, read_only=True)
        registry, build = observer.disturbance_observers, observer.disturbance_observer_from
        self.settings.declare_law(ObserverParameters, registry, lambda: STAYS if self.lockstep else "")
        values = self.settings.values()
        engine = engine_from(values, self.get_logger().info)
        self._estimation = observer.DisturbanceEstimation(build(values), engine)
        self.settings.on_change(build, self._estimation.switch)
        self.limits = limits_of(self._estimation.observer.vehicle)
        self._publish, self._body = self.publishes("disturbance/estimate"), VectorWire(self.base_frame)
        self._gate = CommandGate(self.mode, self._on_sample, self.diagnostics.count)
        restart = self._estimation.restart
        self.driven_by("imu/corrected", self._gate.put_sample, restart=restart, decode=imu_of)
        self.reads("torque/command", self._gate.put_command, decode=vector_of)
        if not self.lockstep:
            self.reads("disturbance/kept", self._estimation.offer, decode=vector_of)
        self._replaced = 0  # estimates that could not be used, up to the last report
        self.ready()

    def report(self) -> None:
        """Report which observer it is, and whether it had to restart since the last report."""
        name = observer.disturbance_observers.name_of(type(self._estimation.observer))
        restarts = self._estimation.replaced
        if restarts > self._replaced:
            self.diagnostics.report("observer", ERROR, f"{name} restarts: its estimate was unusable")
        else:
            self.diagnostics.report("observer", OK, name)
        self._replaced = restarts

    def _on_sample(self, stamp_ns: int, sample: ImuSample, torque: Floats) -> None:
        replaced, resumed = self._estimation.replaced, self._estimation.resumed
        running = self._estimation.observer
        estimate = self._estimation.estimate(stamp_ns, sample, torque)
        if estimate is None:
            self.diagnostics.count("imu/corrected: stamp repeated or went back")
            return
        self.diagnostics.changed |= self._estimation.observer is not running
        if self._estimation.resumed > resumed:
            self.get_logger().info("resumes from the last estimate of a disturbance observer")
        if not has_rate(sample):
            self.diagnostics.count("imu/corrected: body rate absent or unusable")
        if self._estimation.replaced > replaced:
            self.diagnostics.count("the estimate was unusable: the observer restarts")
        self._publish(self._body(stamp_ns, estimate))
        self.sampled(stamp_ns)


main = partial(run_node, DisturbanceObserverNode)
