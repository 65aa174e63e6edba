# pyright: basic
"""The topics and services of a fault injector, for the nodes that have one.

Outputs: imu/data. The truth on fault/injected (attitude [rad]), and once such a fault was asked for on
fault/injected/gyro and fault/injected/accelerometer. fault/dropped (the stamp of each sample withheld). In
free flight rotors/fault, the condition of the rotors from a sample on.
Services: inject (quadftc_msgs/InjectFault), clear (quadftc_msgs/ClearFault).
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from std_msgs.msg import Header

from quadftc_msgs.srv import ClearFault, InjectFault
from quadftc_ros.conversions import time_message
from quadftc_ros.diagnostics import OK, WARN
from quadftc_ros.node import GraphNode
from quadftc_ros.rotor_wire import RotorConditionWire
from quadftc_ros.topics import EARTH_FRAME
from quadftc_ros.wire import ImuWire, VectorWire
from quadftc_sim.injection import RESERVED, TRUTH, make_injection, registry_of
from quadftc_sim.injector import FaultInjector, Faulty
from quadftc_sim.rotor_fault import rotor_faults

JUST_AFTER = 1e-9  # s, the resolution of stamps
MOST_FAULTS = 64  # by service; in NumPy they take 1.5 ms of a sample's 4 ms, and 271 take 8 ms


class InjectorPorts:
    """What a node publishes of its injector, and the services that change it.

    ``make()`` makes the injector of a flight, of a vehicle with so many ``rotors``. The services are those of
    the node, or ``under`` a name. Who applies the injector in a thread of its own holds the ``lock`` for it.
    """

    def __init__(
        self, node: GraphNode, make: Callable[[], FaultInjector], rotors: int, flies: bool, under: str = "~"
    ) -> None:
        self.lock = threading.Lock()
        self._node, self._make, self._rotors = node, make, rotors
        self._active: tuple[int, ...] = ()
        self._told = {"attitude"}  # channels whose truth is published
        self.restart()
        self._publish_imu, self._imu = node.publishes("imu/data"), ImuWire(node.imu_frame)
        self._truth = {
            channel: (
                node.publishes(topic),
                VectorWire(EARTH_FRAME if channel == "attitude" else node.imu_frame),
            )
            for channel, topic in TRUTH.items()
        }
        self._publish_rotors = node.publishes("rotors/fault") if flies else None
        self._condition = RotorConditionWire(rotors, node.base_frame)
        self._publish_dropped = node.publishes("fault/dropped")
        node.offers("inject", InjectFault, self._on_inject, under)
        node.offers("clear", ClearFault, self._on_clear, under)

    def restart(self) -> FaultInjector:
        """Begin a flight: the schedule starts with its first sample, faults of the service are gone."""
        self.injector = self._make()
        self._told.update(injection.channel for injection in self.injector.injections.values())
        return self.injector

    def publish(self, stamp_ns: int, injected: Faulty) -> None:
        """Publish a sample with its faults [stamp in ns], and the truth about them."""
        if self._publish_rotors is not None:
            self._publish_rotors(self._condition(stamp_ns, injected.rotors))
        if injected.present:  # first, as others wait for it
            self._publish_imu(self._imu(stamp_ns, injected.sample))
        else:
            self._publish_dropped(Header(stamp=time_message(stamp_ns), frame_id=self._node.imu_frame))
        for channel, (publish, wire) in self._truth.items():
            if channel in self._told:
                publish(wire(stamp_ns, getattr(injected, channel)))
        with self.lock:
            active = tuple(self.injector.active)
        if active != self._active:
            self._active = active
            self._node.diagnostics.changed = True

    def status(self) -> tuple[bytes, str, dict[str, str]]:
        """Return level, words and values of a report on the faults that act."""
        active = {
            str(number): f"{fault.kind} on {fault.channel} {', '.join(fault.elements)} until {fault.stop:g} s"
            for number, fault in self.injector.active.items()
        }
        return WARN if active else OK, f"{len(active)} faults act", active

    def _on_inject(
        self, request: InjectFault.Request, response: InjectFault.Response
    ) -> InjectFault.Response:
        with self.lock:
            # times count from the last sample; a fault without a start begins with the next one
            after = JUST_AFTER if self.injector.begun and request.start == 0.0 else 0.0
            try:
                if (count := len(self.injector.injections)) >= MOST_FAULTS:
                    raise ValueError(
                        f"{count} faults wait or act; at most {MOST_FAULTS} at a time: clear one"
                    )
                values, now = _values_of(request), self.injector.now + after
                injection = make_injection(request.kind, values, now, self._rotors)
            except ValueError as error:
                response.success, response.message = False, str(error)
                return response
            response.id = self.injector.add(injection)
            self._told.add(injection.channel)
        response.success, response.message = True, f"{injection.kind} on {injection.channel}"
        return response

    def _on_clear(self, request: ClearFault.Request, response: ClearFault.Response) -> ClearFault.Response:
        with self.lock:
            ended = response.cleared = self.injector.clear(request.id)
        response.success = request.id == 0 or ended > 0
        response.message = f"{ended} ended" if response.success else f"there is no fault {request.id}"
        return response


def _values_of(request: InjectFault.Request) -> dict[str, object]:
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
    values: dict[str, object] = {"channel": request.channel} if request.channel else {}
    on_rotors = registry_of(request.kind, values) is rotor_faults
    values |= {"start": request.start, "rotors" if on_rotors else "axes": list(request.axes)}
    values |= {"duration": request.duration} if request.duration > 0.0 else {}
    return values | dict(zip(names, numbers, strict=True))
