"""The fault injector node: puts sensor faults on the IMU, by schedule and by service, and publishes what it did.

Inputs: plant/imu (or a real IMU, by remapping).
Outputs: imu/data; the truth on fault/injected (attitude [rad]), fault/injected/gyro and fault/injected/accelerometer (once such
a fault was asked for); fault/dropped (the stamp of each sample withheld).
Services: ~/inject (quadftc_msgs/InjectFault), ~/clear (quadftc_msgs/ClearFault).
"""

from __future__ import annotations

import dataclasses
import sys
from typing import Any

from std_msgs.msg import Header

from quadftc_model.parameters import parameter
from quadftc_msgs.srv import ClearFault, InjectFault
from quadftc_ros.conversions import EARTH_FRAME, IMU_FRAME, ImuWriter, VectorWriter, imu_sample, time_message
from quadftc_ros.diagnostics import OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_sim.assembly import injector_from
from quadftc_sim.injection import make_injection


@dataclasses.dataclass(frozen=True)
class InjectorParameters:
    """Parameters of the fault injector node."""

    seed: int = parameter(0, low=0, doc="of the random faults (noise, spikes, dropout)")


class FaultInjectorNode(GraphNode):
    """Sensor faults on a stream of IMU samples."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("fault_injector", **kwargs)
        self.settings.declare(InjectorParameters, read_only=True)
        self.settings.declare_list("faults", "each: kind key=value..., e.g. 'bias axes=roll value=1deg start=20s'")
        self._injector = injector_from(self.settings.values())
        self._seen = {injection.channel for injection in self._injector.injections.values()}
        self._last_ns = -1
        self._active: tuple[int, ...] = ()
        self._publish_imu = self.publishes("imu/data")
        self._publish_attitude = self.publishes("fault/injected")
        self._publish_gyro = self.publishes("fault/injected/gyro")
        self._publish_accelerometer = self.publishes("fault/injected/accelerometer")
        self._publish_dropped = self.publishes("fault/dropped")
        self._imu, self._earth, self._sensor = ImuWriter(), VectorWriter(EARTH_FRAME), VectorWriter(IMU_FRAME)
        self.reads("plant/imu", self._on_imu)
        self.offers("inject", InjectFault, self._on_inject)
        self.offers("clear", ClearFault, self._on_clear)
        self.ready()

    def _on_imu(self, stamp_ns: int, message: Any) -> None:
        if stamp_ns <= self._last_ns:  # time went back: a new flight, whose schedule begins anew
            self._injector = injector_from(self.settings.values())
        self._last_ns = stamp_ns
        injected = self._injector.apply(stamp_ns, imu_sample(message))
        self._publish_attitude(self._earth(stamp_ns, injected.attitude))
        if "gyro" in self._seen:
            self._publish_gyro(self._sensor(stamp_ns, injected.gyro))
        if "accelerometer" in self._seen:
            self._publish_accelerometer(self._sensor(stamp_ns, injected.accelerometer))
        self._note_changes()
        self.sampled(stamp_ns)
        if injected.sample is None:
            self._publish_dropped(Header(stamp=time_message(stamp_ns), frame_id=IMU_FRAME))
        else:
            self._publish_imu(self._imu(stamp_ns, injected.sample))

    def report(self) -> None:
        """Report the faults that act."""
        active = {
            f"{number}": f"{injection.kind} on {injection.channel} until {injection.stop:g} s"
            for number, injection in self._injector.active.items()
        }
        self.diagnostics.report("faults", WARN if active else OK, f"{len(active)} faults act", **active)

    def _note_changes(self) -> None:
        if (active := tuple(self._injector.active)) != self._active:
            self._active = active
            self.diagnostics.changed = True

    def _on_inject(self, request: Any, response: Any) -> Any:
        try:
            if len(request.parameter_names) != len(request.parameter_values):
                raise ValueError("parameter_values: expected one for each of parameter_names")
            if request.duration < 0.0:
                raise ValueError(f"duration = {request.duration:g} s: must not be negative")
            values: dict[str, Any] = dict(zip(request.parameter_names, request.parameter_values, strict=True))
            taken = [name for name in values if name in ("channel", "axes", "axis", "start", "stop", "duration")]
            if taken:
                raise ValueError(f"parameter_names: {taken[0]} is a field of the request")
            values.update(start=float(request.start), axes=list(request.axes))
            if request.channel:
                values["channel"] = request.channel
            if request.duration > 0.0:
                values["duration"] = float(request.duration)
            injection = make_injection(request.kind, values, self._injector.now)
        except ValueError as error:
            response.success, response.message = False, str(error)
            return response
        response.id = self._injector.add(injection)
        self._seen.add(injection.channel)
        response.success, response.message = True, f"{injection.kind} on {injection.channel}"
        return response

    def _on_clear(self, request: Any, response: Any) -> Any:
        response.cleared = self._injector.clear(request.id)
        response.success = request.id == 0 or response.cleared > 0
        response.message = f"{response.cleared} ended" if response.success else f"there is no fault {request.id}"
        return response


def main() -> None:
    """Run the node."""
    sys.exit(run_node(FaultInjectorNode))
