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

import numpy as np

from quadftc_fdi import disturbance_observer as observer
from quadftc_model.parameters import parameter
from quadftc_model.samples import DisturbanceObserverInputs, ImuSample, sanitised
from quadftc_model.stepper import warm_up
from quadftc_ros.conversions import Floats
from quadftc_ros.diagnostics import OK
from quadftc_ros.executor import run_node
from quadftc_ros.join import CommandGate
from quadftc_ros.node import GraphNode
from quadftc_ros.parameters import STAYS, VehicleParameters
from quadftc_ros.wire import VectorWire, imu_of, vector_of


@dataclasses.dataclass(frozen=True)
class ObserverParameters:
    """Parameters of the node besides those of the observer, which stand behind its name."""

    observer: str = parameter("exosystem", doc="name of the disturbance observer; may be changed in flight")


def _warmed_up(law: observer.DisturbanceObserver) -> observer.DisturbanceObserver:
    warm_up(law, DisturbanceObserverInputs(np.zeros(3), np.bool_(True), np.zeros(3)))
    return law


class DisturbanceObserverNode(GraphNode):
    """A disturbance observer on the stream of corrected IMU samples."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("disturbance_observer", **kwargs)
        self.settings.declare(VehicleParameters, read_only=True)
        registry, build = observer.disturbance_observers, observer.disturbance_observer_from
        self.settings.declare_law(ObserverParameters, registry, lambda: STAYS if self.lockstep else "")
        self._estimation = observer.DisturbanceEstimation(_warmed_up(build(self.settings.values())))
        self.settings.on_change(build, self._use)
        self._publish, self._body = self.publishes("disturbance/estimate"), VectorWire(self.base_frame)
        self._gate = CommandGate(self.mode, self._on_sample, self.diagnostics.count)
        restart = self._estimation.restart
        self.driven_by("imu/corrected", self._gate.put_sample, restart=restart, decode=imu_of)
        self.reads("torque/command", self._gate.put_command, decode=vector_of)
        if not self.lockstep:
            self.reads("disturbance/kept", self._estimation.offer, decode=vector_of)
        self._introduce()
        self.ready()

    def _introduce(self) -> None:
        name = observer.disturbance_observers.name_of(type(self._estimation.law))
        self.diagnostics.report("observer", OK, name)

    def _use(self, law: observer.DisturbanceObserver) -> None:
        """Fly with changed parameters, or have another observer take over."""
        goes_on = type(law) is type(self._estimation.law)
        self._estimation.switch(law if goes_on else _warmed_up(law))

    def _on_sample(self, stamp_ns: int, sample: ImuSample, torque: Floats) -> None:
        replaced, resumed, law = self._estimation.replaced, self._estimation.resumed, self._estimation.law
        estimate = self._estimation.estimate(stamp_ns, sample, torque)
        if estimate is None:
            self.diagnostics.count("imu/corrected: stamp repeated or went back")
            return
        if type(self._estimation.law) is not type(law):
            self._introduce()
        if self._estimation.resumed > resumed:
            self.get_logger().info("resumes from the last estimate of a disturbance observer")
        if not sanitised(sample).rate_valid:
            self.diagnostics.count("imu/corrected: body rate absent or unusable")
        if self._estimation.replaced > replaced:
            self.diagnostics.count("the estimate was unusable: the observer restarts")
        self._publish(self._body(stamp_ns, estimate))
        self.sampled(stamp_ns)


main = partial(run_node, DisturbanceObserverNode)
