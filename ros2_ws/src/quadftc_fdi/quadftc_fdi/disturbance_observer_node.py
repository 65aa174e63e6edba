# pyright: basic
"""The disturbance observer node: estimates the disturbance as an angular acceleration.

Inputs: imu/corrected, torque/command; in real time disturbance/kept: started again in flight, it goes on
from the estimate that the one before has left.
Outputs: disturbance/estimate [rad/s²].
Services: ~/reset (std_srvs/Trigger). A sample whose stamp repeats or goes back is refused and counted.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from quadftc_fdi.assembly import disturbance_observer_from
from quadftc_fdi.disturbance_observer import DisturbanceObserver, disturbance_observers, inputs_of, stepper_of
from quadftc_fdi.handover import Handover
from quadftc_model.arrays import Array
from quadftc_model.parameters import Value, parameter
from quadftc_model.samples import DisturbanceObserverInputs, ImuSample, is_usable
from quadftc_model.stepper import warm_up
from quadftc_ros.conversions import Floats
from quadftc_ros.diagnostics import OK
from quadftc_ros.executor import run_node
from quadftc_ros.join import TorqueGate
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import BASE_FRAME
from quadftc_ros.wire import VectorWire, imu_of, vector_of


@dataclasses.dataclass(frozen=True)
class ObserverParameters:
    """Parameters of the node besides those of the observer, which stand behind its name."""

    vehicle: str = parameter("qball_x4", doc="name of a vehicle, or path of its TOML file")
    observer: str = parameter("exosystem", doc="name of the disturbance observer")


class DisturbanceObserverNode(GraphNode):
    """A disturbance observer on the stream of corrected IMU samples."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("disturbance_observer", **kwargs)
        self.settings.declare(ObserverParameters, read_only=True)
        name = self.settings.values()["observer"]
        self.settings.declare(disturbance_observers.get(name), f"{name}.")
        law = disturbance_observer_from(self.settings.values())
        self._law: DisturbanceObserver = law
        self._stepper = stepper_of(law)
        warm_up(law, DisturbanceObserverInputs(np.zeros(3), np.bool_(True), np.zeros(3)))
        self.settings.on_change(self._rebuilt)
        self._publish = self.publishes("disturbance/estimate")
        self._body = VectorWire(BASE_FRAME)
        self._gate = TorqueGate(self.mode, self._on_sample)
        self.driven_by("imu/corrected", self._gate.put_sample, restart=self._restart, decode=imu_of)
        self.reads("torque/command", self._on_torque, decode=vector_of)
        self._handover, self._estimate_kept = Handover(), np.zeros(3)
        if not self.lockstep:
            self.reads("disturbance/kept", self._on_kept, decode=vector_of)
        self.diagnostics.report("observer", OK, name)
        self.ready()

    def _rebuilt(self, values: Mapping[str, Value]) -> Callable[[], None]:
        law = disturbance_observer_from(values)

        def apply() -> None:
            self._law = self._stepper.law = law

        return apply

    def _restart(self) -> None:
        self._stepper.reset()
        self._handover.forget()

    def _on_kept(self, stamp_ns: int, estimate: Floats) -> None:
        if is_usable(estimate):
            self._estimate_kept = estimate
            self._handover.heard(stamp_ns)

    def _stepped(self, stamp_ns: int, inputs: DisturbanceObserverInputs) -> Array | None:
        self._handover.sampled(stamp_ns)
        if self._handover.due() and inputs.rate_valid and self._stepper.timing(stamp_ns).accepted:
            self._handover.forget_words()
            self.get_logger().info("goes on from where a disturbance observer has left off")
            state = self._law.resumed(inputs, self._estimate_kept)
            return self._stepper.resume(stamp_ns, inputs, state)
        return self._stepper.step(stamp_ns, inputs)

    def _on_torque(self, stamp_ns: int, torque: Floats) -> None:
        if not self._gate.put_torque(stamp_ns, torque):
            self.diagnostics.count("torque/command: not finite")

    def _on_sample(self, stamp_ns: int, received: ImuSample, torque: Floats) -> None:
        inputs, replaced = inputs_of(received, torque), self._stepper.replaced
        estimate = self._stepped(stamp_ns, inputs)
        if estimate is None:
            self.diagnostics.count("imu/corrected: stamp repeated or went back")
            return
        if not inputs.rate_valid:
            self.diagnostics.count("imu/corrected: body rate absent or unusable")
        if self._stepper.replaced > replaced:
            self.diagnostics.count("the observer gave no number: it starts anew")
        self._publish(self._body(stamp_ns, estimate))
        self.sampled(stamp_ns)


def main() -> None:
    """Run the node."""
    sys.exit(run_node(DisturbanceObserverNode))
