# pyright: basic
"""The fault injector node: puts faults on IMU and rotors, by schedule and by service, and says what it did.

Inputs: plant/imu (or a real IMU, by remapping).
Outputs: imu/data; the truth on fault/injected (attitude [rad]), and once such a fault was asked for on
fault/injected/gyro and fault/injected/accelerometer; fault/dropped (the stamp of each sample withheld); in
free flight rotors/fault, the condition of the rotors from a sample on.
Services: ~/inject (quadftc_msgs/InjectFault), ~/clear (quadftc_msgs/ClearFault), ~/reset (std_srvs/Trigger:
the schedule restarts with the next sample, faults injected by service are gone).
"""

from __future__ import annotations

from functools import partial
from typing import Any

from std_msgs.msg import Header

from quadftc_compile.engine import engine_from
from quadftc_model.samples import ImuSample
from quadftc_msgs.srv import ClearFault, InjectFault
from quadftc_ros.conversions import time_message
from quadftc_ros.diagnostics import OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_ros.rotor_wire import RotorConditionWire
from quadftc_ros.topics import EARTH_FRAME
from quadftc_ros.wire import ImuWire, VectorWire, imu_of
from quadftc_sim.assembly import InjectorParameters, injector_from
from quadftc_sim.injection import RESERVED, TRUTH, make_injection, registry_of
from quadftc_sim.rotor_fault import rotor_faults

JUST_AFTER = 1e-9  # s, the resolution of stamps


class FaultInjectorNode(GraphNode):
    """Faults on a stream of IMU samples, and on rotors."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("fault_injector", **kwargs)
        self.settings.declare(InjectorParameters, read_only=True)
        example = "bias axes=roll value=1deg start=20s"
        self.settings.declare_list("faults", f"each: kind key=value..., e.g. '{example}'")
        self._engine = engine_from(self.settings.values(), self.get_logger().info)
        self._active: tuple[int, ...] = ()
        self._told = {"attitude"}  # channels whose truth is published
        self._restart()
        self._publish_imu, self._imu = self.publishes("imu/data"), ImuWire(self.imu_frame)
        self._truth = {
            channel: (
                self.publishes(topic),
                VectorWire(EARTH_FRAME if channel == "attitude" else self.imu_frame),
            )
            for channel, topic in TRUTH.items()
        }
        self._rotors = rotors = self.settings.values()["rotors"]
        self._publish_rotors = self.publishes("rotors/fault") if self.plant_kind == "free_flight" else None
        self._condition = RotorConditionWire(rotors, self.base_frame)
        self._publish_dropped = self.publishes("fault/dropped")
        self.driven_by("plant/imu", self._on_imu, restart=self._restart, decode=imu_of)
        self.offers("inject", InjectFault, self._on_inject)
        self.offers("clear", ClearFault, self._on_clear)
        self.ready()

    def _restart(self) -> None:
        self._injector = injector_from(self.settings.values(), self._engine)
        self._told.update(injection.channel for injection in self._injector.injections.values())
        self._last_ns = -1

    def _on_imu(self, stamp_ns: int, sample: ImuSample) -> None:
        if stamp_ns <= self._last_ns:
            self.diagnostics.count("plant/imu: stamp repeated or went back")
            return
        self._last_ns = stamp_ns
        injected = self._injector.apply(stamp_ns, sample)
        if self._publish_rotors is not None:
            self._publish_rotors(self._condition(stamp_ns, injected.rotors))
        if injected.present:  # first, as others wait for it
            self._publish_imu(self._imu(stamp_ns, injected.sample))
        else:
            self._publish_dropped(Header(stamp=time_message(stamp_ns), frame_id=self.imu_frame))
        for channel, (publish, wire) in self._truth.items():
            if channel in self._told:
                publish(wire(stamp_ns, getattr(injected, channel)))
        if (active := tuple(self._injector.active)) != self._active:
            self._active = active
            self.diagnostics.changed = True
        self.sampled(stamp_ns)

    def report(self) -> None:
        """Report the faults that act."""
        active = {
            str(number): f"{fault.kind} on {fault.channel} until {fault.stop:g} s"
            for number, fault in self._injector.active.items()
        }
        self.diagnostics.report("faults", WARN if active else OK, f"{len(active)} faults act", **active)

    def _on_inject(self, request: Any, response: Any) -> Any:
        # times count from the last sample; a fault without a start begins with the next one
        now = self._injector.now + (JUST_AFTER if self._last_ns >= 0 and request.start == 0.0 else 0.0)
        try:
            injection = make_injection(request.kind, _values_of(request), now, self._rotors)
        except ValueError as error:
            response.success, response.message = False, str(error)
            return response
        response.id = self._injector.add(injection)
        self._told.add(injection.channel)
        response.success, response.message = True, f"{injection.kind} on {injection.channel}"
        return response

    def _on_clear(self, request: Any, response: Any) -> Any:
        ended = response.cleared = self._injector.clear(request.id)
        response.success = request.id == 0 or ended > 0
        response.message = f"{ended} ended" if response.success else f"there is no fault {request.id}"
        return response


def _values_of(request: InjectFault.Request) -> dict[str, Any]:
    """Return the values of a request that `make_injection` takes; ValueError: they contradict each other."""
    names, numbers = list(request.parameter_names), list(request.parameter_values)
    if len(names) != len(numbers):
        raise ValueError(f"parameter_values: {len(numbers)} numbers for {len(names)} parameter_names")
    for name in names:
        if name in RESERVED:
            raise ValueError(f"parameter_names: {name} is a field of the request")
        if names.count(name) > 1:
            raise ValueError(f"parameter_names: {name} is given twice")
    if not request.duration >= 0.0:
        raise ValueError(f"duration = {request.duration:g} s: must not be negative")
    values: dict[str, Any] = {"channel": request.channel} if request.channel else {}
    on_rotors = registry_of(request.kind, values) is rotor_faults
    values |= {"start": request.start, "rotors" if on_rotors else "axes": list(request.axes)}
    values |= {"duration": request.duration} if request.duration > 0.0 else {}
    return values | dict(zip(names, numbers, strict=True))


main = partial(run_node, FaultInjectorNode)
