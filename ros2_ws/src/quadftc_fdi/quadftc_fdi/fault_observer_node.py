"""The fault observer node: estimates the attitude fault and publishes the corrected IMU.

Inputs: imu/data; torque/command (observer (16) of the paper needs the torque that acted).
Outputs: imu/corrected, fault/estimate, fault/status.
Services: ~/reset (std_srvs/Trigger).
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from std_srvs.srv import Trigger

from quadftc_fdi.assembly import fault_observer_from
from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.parameters import Value, parameter
from quadftc_model.samples import FaultEstimate
from quadftc_msgs.msg import FaultStatus
from quadftc_ros.conversions import (
    EARTH_FRAME,
    IMU_FRAME,
    NANOSECONDS,
    ImuWriter,
    VectorWriter,
    array_of,
    fill_vector,
    imu_sample,
    time_message,
)
from quadftc_ros.diagnostics import OK
from quadftc_ros.executor import run_node
from quadftc_ros.join import TorqueGate
from quadftc_ros.node import GraphNode


@dataclasses.dataclass(frozen=True)
class ObserverParameters:
    """Parameters of the fault observer node besides those of the observer itself, which stand behind its name."""

    vehicle: str = parameter("qball_x4", doc="name of a vehicle, or path of its TOML file")
    observer: str = parameter("sliding_mode", doc="name of the fault observer")


class FaultObserverNode(GraphNode):
    """A fault observer on the stream of IMU samples."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("fault_observer", **kwargs)
        self.settings.declare(ObserverParameters, read_only=True)
        name = self.settings.values()["observer"]
        self.settings.declare(fault_observers.get(name), f"{name}.")
        self._diagnosis = Diagnosis(fault_observer_from(self.settings.values()))
        self.settings.on_change(self._rebuilt)
        self._publish_corrected = self.publishes("imu/corrected")
        self._publish_estimate = self.publishes("fault/estimate")
        self._publish_status = self.publishes("fault/status")
        self._imu, self._earth = ImuWriter(), VectorWriter(EARTH_FRAME)
        self._gate = TorqueGate(self.mode, self._on_sample, np.zeros(3))
        self.reads("imu/data", self._on_imu)
        self.reads("torque/command", lambda stamp_ns, m: self._gate.put_torque(stamp_ns, array_of(m.vector)))
        self.offers("reset", Trigger, self._on_reset)
        self.diagnostics.report("observer", OK, name)
        self.ready()

    def _rebuilt(self, values: Mapping[str, Value]) -> Callable[[], None]:
        law = fault_observer_from(values)
        return lambda: setattr(self._diagnosis, "law", law)

    def _on_imu(self, stamp_ns: int, message: Any) -> None:
        self._gate.put_sample(stamp_ns, message)

    def _on_sample(self, stamp_ns: int, message: Any, torque: Any) -> None:
        sample = imu_sample(message)
        estimate = self._diagnosis.step(stamp_ns, sample, torque)
        if estimate is None:
            self.diagnostics.count("imu/data: stamp repeated or went back")
            return
        if not estimate.corrected.rate_valid:
            self.diagnostics.count("imu/data: body rate absent or unusable")
        self._publish_estimate(self._earth(stamp_ns, estimate.fault))
        self._publish_status(status_message(stamp_ns, estimate))
        self.sampled(stamp_ns)
        self._publish_corrected(self._imu(stamp_ns, estimate.corrected))

    def _on_reset(self, request: Any, response: Any) -> Any:
        self._diagnosis.reset()
        response.success, response.message = True, "starts anew at the next sample"
        return response


def status_message(stamp_ns: int, estimate: FaultEstimate) -> FaultStatus:
    """Message of an estimate of one vehicle."""
    message = FaultStatus()
    message.header.stamp = time_message(stamp_ns)
    message.header.frame_id = IMU_FRAME
    message.state = estimate.state
    fill_vector(message.estimate, estimate.fault)
    fill_vector(message.std_dev, estimate.std_dev)
    for axis, age in enumerate(estimate.onset_age.tolist()):
        if age >= 0.0:
            message.onset[axis] = time_message(stamp_ns - round(age * NANOSECONDS))
    return message


def main() -> None:
    """Run the node."""
    sys.exit(run_node(FaultObserverNode))
