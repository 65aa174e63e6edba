# pyright: basic
"""The controller node: from attitude, reference and disturbance estimate to a torque within the authority.

Inputs: imu/corrected, attitude/reference, disturbance/estimate; in free flight rotors/speed and
rotors/status; in real time imu/data as fallback, fault/status and gyro/bias.
Outputs: torque/command [N m], in free flight rotors/command [rad/s], control/status; in real time fault/kept,
gyro/kept and disturbance/kept for observers that restart (`quadftc_control.last_words`).
Services: ~/reset (std_srvs/Trigger).
What it decides in flight: `quadftc_control.flight_manager`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from quadftc_compile.engine import engine_from
from quadftc_control.controller import Controller, controller_from, controllers
from quadftc_control.flight_manager import Command, FlightManager
from quadftc_control.input_monitor import Mode, Patience
from quadftc_control.last_words import MessageReader
from quadftc_model.assembly import NodeParameters, build_prefixed
from quadftc_model.parameters import parameter
from quadftc_model.samples import ALARMS, AttitudeCommand, ImuSample
from quadftc_model.stepper import seconds
from quadftc_ros import wire
from quadftc_ros.conversions import Floats, array_of, revise_status
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.join import StampJoin
from quadftc_ros.limits import limits_of
from quadftc_ros.motion_wire import RotorsReader, RotorsWire
from quadftc_ros.node import GraphNode
from quadftc_ros.parameters import STAYS, VehicleParameters
from quadftc_ros.rotor_wire import EffectivenessReader
from quadftc_ros.transport import decoding

REFERENCE_AGE = 0.5  # s; real time: age from which a reference is reported as stopped
WATCH_PERIOD = 0.02  # s; real time: how often the controller looks whether samples still come

_REPORTS = {
    Mode.FULL: (OK, "full"),
    Mode.NO_DIAGNOSIS: (WARN, "no diagnosis: on imu/data, as imu/corrected is missing"),
    Mode.NO_DISTURBANCE_ESTIMATE: (WARN, "no disturbance estimate: the switching gain takes over"),
    Mode.HOLD: (WARN, "hold: no IMU, the torque is held"),
    Mode.OFF: (ERROR, "off: no IMU, zero torque"),
}


@dataclasses.dataclass(frozen=True)
class ControllerParameters:
    """Parameters of the controller node besides those of the controller, which stand behind its name."""

    controller: str = parameter("ismc", doc="name of the controller; may be changed in flight")


def _build(values: NodeParameters) -> tuple[Controller, Patience]:
    return controller_from(values), build_prefixed(Patience, values, "patience")


def faulty_part(status: Any) -> Floats:
    """Return the estimate (3,) [rad] of a status message, zero on axes without an alarm."""
    return array_of(status.estimate) * np.isin(status.state, ALARMS)


READER = MessageReader(wire.imu_of, wire.fault_states_of, wire.fault_status_of, faulty_part, revise_status)


class ControllerNode(GraphNode):
    """An attitude controller."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("controller", **kwargs)
        self.settings.declare(VehicleParameters, read_only=True)
        self.settings.declare_law(ControllerParameters, controllers, self._must_keep)
        self.settings.declare(Patience, "patience.")
        law, patience = _build(self.settings.values())
        flies = self.plant_kind == "free_flight"
        engine = engine_from(self.settings.values(), self.get_logger().info)
        self._manager = FlightManager(law, patience, READER, self.diagnostics.count, flies, engine)
        self.settings.on_change(_build, self._use)
        self._publish_torque = self.publishes("torque/command")
        self._publish_status = self.publishes("control/status")
        self._body, self._status = wire.VectorWire(self.base_frame), wire.ControlStatusWire(self.base_frame)
        self._mode: Mode | None = None
        self._restarts = 0  # of the law, up to the last report
        inputs = ("imu", "reference", "disturbance", *(["speeds", "rotors"] if flies else []))
        self.limits = limits_of(law.vehicle)
        self._join = StampJoin(inputs, partial(self._act, self._manager.fly))
        self.driven_by("imu/corrected", self._on_corrected, restart=self._manager.restart, decode=wire.imu_of)
        self.reads("attitude/reference", self._on_reference, decode=wire.attitude_command_in)
        if flies:
            self._publish_speeds = self.publishes("rotors/command")
            count = len(law.vehicle.rotors.positions)
            self._rotors = RotorsWire(count, self.base_frame)
            self.reads("rotors/speed", self._on_speeds, decode=RotorsReader(count))
            self.reads("rotors/status", self._on_rotors, decode=EffectivenessReader(count))
        self.reads("disturbance/estimate", self._on_disturbance, decode=wire.vector_of)
        self.reads("imu/data", self._on_raw, decode=bytes)
        self.reads("fault/status", self._manager.take_status, decode=bytes)
        fly_raw = partial(self._act, self._manager.take_raw)
        self._fall_back = decoding("imu/data", fly_raw, wire.imu_of, self.diagnostics.count)
        if not self.lockstep:
            self.reads("gyro/bias", self._manager.take_bias, decode=wire.vector_of)
            self._publish_kept = {
                what: self.publishes(f"{what}/kept") for what in ("fault", "gyro", "disturbance")
            }
            self._watchdog = self.create_timer(WATCH_PERIOD, self._on_watchdog, clock=self.pace)
        self.ready()

    def _use(self, built: tuple[Controller, Patience]) -> None:
        """Fly with changed parameters, or have another controller take over."""
        self._manager.configure(*built)

    def _must_keep(self) -> str:
        """Return why another controller must not take over now; empty: it may."""
        return STAYS if self.lockstep else self._manager.must_keep()

    def _on_reference(self, stamp_ns: int, wanted: AttitudeCommand) -> None:
        usable = self._manager.take_reference(stamp_ns, wanted)
        if self.lockstep and usable is not None:
            self._join.put("reference", stamp_ns, usable)

    def _on_disturbance(self, stamp_ns: int, disturbance: Floats) -> None:
        usable = self._manager.take_disturbance(stamp_ns, disturbance)
        if self.lockstep:
            self._join.put("disturbance", stamp_ns, usable)

    def _on_speeds(self, stamp_ns: int, speeds: Floats) -> None:
        usable = self._manager.take_speeds(stamp_ns, speeds)
        if self.lockstep:
            self._join.put("speeds", stamp_ns, usable)

    def _on_rotors(self, stamp_ns: int, effectiveness: Floats | None) -> None:
        usable = self._manager.take_effectiveness(effectiveness)
        if self.lockstep:
            self._join.put("rotors", stamp_ns, usable)

    def _on_corrected(self, stamp_ns: int, imu: ImuSample) -> None:
        if self.lockstep:
            self._join.put("imu", stamp_ns, imu)
        else:
            self._act(self._manager.take_corrected, stamp_ns, imu)

    def _on_raw(self, stamp_ns: int, data: bytes) -> None:
        if not self.lockstep and self._manager.needs_raw(stamp_ns, data):
            self._fall_back(stamp_ns, data)

    def _on_watchdog(self) -> None:
        if self.active:
            self._act(self._manager.watch, self.pace.now().nanoseconds)

    def _act(self, decide: Callable[..., Command | None], *inputs: object) -> None:
        """Publish what is kept for observers that restart, then the torque and how it came about."""
        begin = perf_counter()
        command = decide(*inputs)
        for what, stamp_ns, value in self._manager.kept:
            self._publish_kept[what](value if what == "fault" else self._body(stamp_ns, value))
        self._manager.kept.clear()
        if command is None:
            return
        stamp_ns, output, mode, speeds = command
        if speeds is not None:
            self._publish_speeds(self._rotors(stamp_ns, speeds))
        self._publish_torque(self._body(stamp_ns, output.torque))
        self._publish_status(
            self._status(stamp_ns, output, mode, self._manager.restarts, perf_counter() - begin)
        )
        if mode is not self._mode:
            self._mode = mode
            self.diagnostics.report("mode", *_REPORTS[mode])
        self.sampled(stamp_ns)

    def report(self) -> None:
        """Report a law that restarts, and a reference that stands still because its node does."""
        manager = self._manager
        failed, self._restarts = manager.restarts > self._restarts, manager.restarts
        words = "restarts: its output was unusable, the last torque is held" if failed else "flies"
        self.diagnostics.report("law", ERROR if failed else OK, words)
        if not self.lockstep and manager.stamp_ns and manager.wanted is not None:
            old = seconds(manager.stamp_ns - manager.wanted_ns) > REFERENCE_AGE
            words = "attitude/reference does not come: the last is held" if old else "comes"
            self.diagnostics.report("reference", WARN if old else OK, words)


main = partial(run_node, ControllerNode)
