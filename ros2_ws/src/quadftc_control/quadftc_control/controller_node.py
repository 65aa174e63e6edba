"""The controller node: from attitude, reference and disturbance estimate to a torque that the rotors can give.

Inputs: imu/corrected, attitude/reference, disturbance/estimate; imu/data as fallback in real time.
Outputs: torque/command [N m], control/status.
Services: ~/reset (std_srvs/Trigger).
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu
from std_srvs.srv import Trigger

from quadftc_control.assembly import controller_from
from quadftc_control.controller import controllers
from quadftc_control.degraded import InputMonitor, Mode, Patience
from quadftc_model.parameters import Value, build, parameter
from quadftc_model.samples import AttitudeReference, ControllerInputs, ControllerOutput, ImuSample, sanitised
from quadftc_model.stepper import Stepper
from quadftc_msgs.msg import ControlStatus
from quadftc_ros.conversions import BASE_FRAME, VectorWriter, array_of, fill_vector, imu_sample, reference_of, set_stamp
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.join import StampJoin
from quadftc_ros.node import GraphNode, wall_seconds

_LEVELS = {Mode.FULL: OK, Mode.NO_DIAGNOSIS: WARN, Mode.NO_DISTURBANCE_ESTIMATE: WARN, Mode.HOLD: WARN, Mode.OFF: ERROR}


@dataclasses.dataclass(frozen=True)
class ControllerParameters:
    """Parameters of the controller node besides those of the controller itself, which stand behind its name."""

    vehicle: str = parameter("qball_x4", doc="name of a vehicle, or path of its TOML file")
    controller: str = parameter("ismc", doc="name of the controller")


class ControllerNode(GraphNode):
    """An attitude controller."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("controller", **kwargs)
        self.settings.declare(ControllerParameters, read_only=True)
        name = self.settings.values()["controller"]
        self.settings.declare(controllers.get(name), f"{name}.")
        self.settings.declare(Patience, "patience.")
        values = self.settings.values()
        self._stepper: Stepper[ControllerInputs, ControllerOutput] = Stepper(controller_from(values))
        self._monitor = InputMonitor(_patience(values))
        self.settings.on_change(self._rebuilt)
        self._publish_torque = self.publishes("torque/command")
        self._publish_status = self.publishes("control/status")
        self._reference: AttitudeReference | None = None
        self._stamp_ns, self._last_sample = 0, time.monotonic()
        self._body = VectorWriter(BASE_FRAME)
        self._join = StampJoin(("imu", "reference", "disturbance"), self._on_all)
        self.reads("imu/corrected", self._on_corrected)
        self.reads("attitude/reference", self._on_reference)
        self.reads("disturbance/estimate", self._on_disturbance)
        self.reads_raw("imu/data", self._on_raw)
        self.offers("reset", Trigger, self._on_reset)
        if not self.lockstep:
            self._watchdog = self.create_timer(0.02, self._on_watchdog)
        self.ready()

    def _rebuilt(self, values: Mapping[str, Value]) -> Callable[[], None]:
        law, patience = controller_from(values), _patience(values)

        def apply() -> None:
            self._stepper.law, self._monitor.patience = law, patience

        return apply

    def _on_reference(self, stamp_ns: int, message: Any) -> None:
        reference = reference_of(message)
        if not all(np.all(np.isfinite(part)) for part in reference):
            self.diagnostics.count("attitude/reference is not finite")
            return
        self._reference = reference
        if self.lockstep:
            self._join.put("reference", stamp_ns, reference)

    def _on_disturbance(self, stamp_ns: int, message: Any) -> None:
        disturbance = array_of(message.vector)
        if not np.all(np.isfinite(disturbance)):
            self.diagnostics.count("disturbance/estimate is not finite")
            return
        self._monitor.estimated(stamp_ns, disturbance)
        if self.lockstep:
            self._join.put("disturbance", stamp_ns, disturbance)

    def _on_corrected(self, stamp_ns: int, message: Any) -> None:
        self._monitor.corrected()
        if self.lockstep:
            self._join.put("imu", stamp_ns, imu_sample(message))
        else:
            self._on_latest(stamp_ns, imu_sample(message), Mode.FULL)

    def _on_raw(self, stamp_ns: int, data: bytes) -> None:
        if not self.lockstep and self._monitor.use_raw():
            self._on_latest(stamp_ns, imu_sample(deserialize_message(data, Imu)), Mode.NO_DIAGNOSIS)

    def _on_all(self, stamp_ns: int, imu: ImuSample, reference: AttitudeReference, disturbance: Any) -> None:
        self._control(stamp_ns, ControllerInputs(imu, reference, disturbance), Mode.FULL)

    def _on_latest(self, stamp_ns: int, imu: ImuSample, mode: Mode) -> None:
        clean = sanitised(imu)
        if self._reference is None or not clean.attitude_valid:
            self.diagnostics.count("no reference yet" if self._reference is None else "imu without attitude")
            return
        disturbance, fresh = self._monitor.disturbance_at(stamp_ns)
        if mode is Mode.FULL and not fresh:
            mode = Mode.NO_DISTURBANCE_ESTIMATE
        self._control(stamp_ns, ControllerInputs(imu, self._reference, disturbance), mode)

    def _control(self, stamp_ns: int, inputs: ControllerInputs, mode: Mode) -> None:
        begin = wall_seconds()
        output = self._stepper.step(stamp_ns, inputs)
        if output is None:  # repeated: imu/corrected of a sample that imu/data has served already
            return
        self._publish_torque(self._body(stamp_ns, output.torque))
        self._stamp_ns, self._last_sample = stamp_ns, time.monotonic()
        self._publish_status(status_message(stamp_ns, output, mode, wall_seconds() - begin))
        self.diagnostics.report("mode", _LEVELS[mode], mode.name.lower().replace("_", " "))
        self.sampled(stamp_ns)

    def _on_watchdog(self) -> None:
        mode = self._monitor.silence(time.monotonic() - self._last_sample)
        if mode is Mode.FULL or not self._stamp_ns:
            return
        if mode is Mode.OFF:
            self._publish_torque(self._body(self._stamp_ns, np.zeros(3)))
        self.diagnostics.report("mode", _LEVELS[mode], f"{mode.name.lower()}: no IMU")
        zeros = np.zeros(3)
        output = ControllerOutput(zeros, zeros, zeros, np.zeros(3, dtype=bool))
        self._publish_status(status_message(self._stamp_ns, output, mode, 0.0))

    def _on_reset(self, request: Any, response: Any) -> Any:
        self._stepper.reset()
        self._join.clear()
        response.success, response.message = True, "starts anew at the next sample"
        return response


def _patience(values: Mapping[str, Any]) -> Patience:
    prefix = "patience."
    return build(Patience, {k.removeprefix(prefix): v for k, v in values.items() if k.startswith(prefix)})


def status_message(stamp_ns: int, output: ControllerOutput, mode: Mode, compute_time: float) -> ControlStatus:
    """Message of a control step of one vehicle; ``compute_time`` in seconds."""
    message = ControlStatus()
    set_stamp(message.header, stamp_ns)
    message.header.frame_id = BASE_FRAME
    fill_vector(message.error, output.error)
    fill_vector(message.sliding_variable, output.sliding_variable)
    message.saturated = output.saturated.tolist()
    message.mode = int(mode)
    message.compute_time = compute_time
    return message


def main() -> None:
    """Run the node."""
    sys.exit(run_node(ControllerNode))
