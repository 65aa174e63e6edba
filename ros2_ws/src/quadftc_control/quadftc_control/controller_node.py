# pyright: basic
"""The controller node: from attitude, reference and disturbance estimate to a torque within the authority.

Inputs: imu/corrected, attitude/reference, disturbance/estimate; in real time imu/data as fallback, and
fault/status.
Outputs: torque/command [N m], control/status; in real time fault/kept, gyro/kept and disturbance/kept for
observers that are started again (`quadftc_control.keeper`).
Services: ~/reset (std_srvs/Trigger).
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from quadftc_control.assembly import controller_from
from quadftc_control.controller import controllers, nothing_but, stepper_of
from quadftc_control.degraded import HeldTorque, InputMonitor, Mode, Patience
from quadftc_control.keeper import Keeper
from quadftc_control.transfer import Transfer
from quadftc_model.assembly import build_prefixed
from quadftc_model.parameters import Value, parameter
from quadftc_model.samples import (
    ALARMS,
    AttitudeReference,
    ControllerInputs,
    ControllerOutput,
    ImuSample,
    is_usable,
    level_sample,
    sanitised,
)
from quadftc_model.stepper import seconds, warm_up
from quadftc_ros.conversions import Floats, array_of, revise_status
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.join import StampJoin
from quadftc_ros.node import GraphNode, wall_seconds
from quadftc_ros.reception import decoding
from quadftc_ros.topics import BASE_FRAME
from quadftc_ros.wire import (
    ControlStatusWire,
    VectorWire,
    fault_states_of,
    fault_status_of,
    imu_of,
    reference_in,
    vector_of,
)

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
        self._law = controller_from(values)  # for when there is a disturbance estimate
        self._stepper = stepper_of(self._law, lambda: self._torque)
        still = AttitudeReference(np.zeros(3), np.zeros(3), np.zeros(3))
        warm_up(self._law, ControllerInputs(level_sample(), still, np.zeros(3)))
        patience = build_prefixed(Patience, values, "patience")
        self._monitor, self._transfer = InputMonitor(patience), Transfer(patience)
        self._keeper = Keeper(imu_of, fault_states_of, fault_status_of)
        self._words: Any = None  # the last fault/status of an observer that is silent, if it helps
        self.settings.on_change(self._rebuilt)
        self._publish_torque = self.publishes("torque/command")
        self._publish_status = self.publishes("control/status")
        self._body, self._status = VectorWire(BASE_FRAME), ControlStatusWire()
        self._reference: AttitudeReference | None = None
        self._reference_ns = 0
        self._mode: Mode | None = None
        self._torque, self._stamp_ns = np.zeros(3), 0  # last command [N m] and its stamp [ns]
        self._held = HeldTorque()
        self._join = StampJoin(("imu", "reference", "disturbance"), self._on_all)
        self.driven_by("imu/corrected", self._on_corrected, restart=self._restart, decode=imu_of)
        self.reads("attitude/reference", self._on_reference, decode=reference_in)
        self.reads("disturbance/estimate", self._on_disturbance, decode=vector_of)
        self.reads_raw("imu/data", self._on_raw)
        self.reads_raw("fault/status", self._keeper.status)
        self._on_fallback = decoding("imu/data", self._on_uncorrected, imu_of, self.diagnostics.count)
        self._watched_ns, self._silent_since_ns = 0, 0
        self._missing = 0.0  # share of the disturbance estimate that is missing
        self._trusted, self._estimate = False, (0, np.zeros(3))  # whether it is; the last, with its stamp
        if not self.lockstep:
            self._keep_status = self.publishes("fault/kept")
            self._keep_gyro = self.publishes("gyro/kept")
            self._keep_disturbance = self.publishes("disturbance/kept")
            self._watchdog = self.create_timer(WATCH_PERIOD, self._on_watchdog, clock=self.pace)
        self.ready()

    def _rebuilt(self, values: Mapping[str, Value]) -> Callable[[], None]:
        law, patience = controller_from(values), build_prefixed(Patience, values, "patience")

        def apply() -> None:
            self._law, self._stepper.law = law, law.without_estimate(self._missing)
            self._monitor.patience = self._transfer.patience = patience

        return apply

    def _restart(self) -> None:
        self._stepper.reset()
        self._transfer.reset()

    def _on_reference(self, stamp_ns: int, reference: AttitudeReference) -> None:
        if is_usable(*reference):
            self._reference, self._reference_ns = reference, stamp_ns
        else:
            self.diagnostics.count("attitude/reference: not finite")
        if self.lockstep and self._reference is not None:
            self._join.put("reference", stamp_ns, self._reference)

    def _on_disturbance(self, stamp_ns: int, disturbance: Floats) -> None:
        if is_usable(disturbance):
            self._monitor.estimated(stamp_ns, disturbance)
            self._estimate = stamp_ns, disturbance
        else:
            self.diagnostics.count("disturbance/estimate: not finite")
            disturbance = np.zeros(3)
        if self.lockstep:
            self._join.put("disturbance", stamp_ns, disturbance)

    def _on_corrected(self, stamp_ns: int, imu: ImuSample) -> None:
        if self.lockstep:
            self._join.put("imu", stamp_ns, imu)
            return
        clean = sanitised(imu)
        if not clean.attitude_valid:
            self.diagnostics.count("imu/corrected: no attitude")
        elif self._monitor.is_late(stamp_ns):
            self.diagnostics.count("imu/corrected: late")
        elif self._monitor.use_corrected(stamp_ns, self._monitor.undiagnosed and self._keeper.starting):
            self._keeper.corrected(stamp_ns, clean)
            self._on_latest(stamp_ns, clean, Mode.FULL)

    def _on_raw(self, stamp_ns: int, data: bytes) -> None:
        if self.lockstep:
            return
        self._keeper.raw(stamp_ns, data)
        had_diagnosis = not self._monitor.undiagnosed
        if self._monitor.use_raw(stamp_ns):
            if had_diagnosis:
                self._keep_diagnosis(stamp_ns)
            self._on_fallback(stamp_ns, data)

    def _on_uncorrected(self, stamp_ns: int, imu: ImuSample) -> None:
        clean = sanitised(imu)
        if clean.attitude_valid:
            self._on_latest(stamp_ns, clean, Mode.NO_DIAGNOSIS)
        else:
            self.diagnostics.count("imu/data: no attitude")

    def _keep_diagnosis(self, stamp_ns: int) -> None:
        """Publish what a fault observer that is started again needs to go on, and do without one."""
        words, self._words = self._keeper.last_words(stamp_ns), None
        self._transfer.expect(None, None)
        if words is not None:
            self._words, last_ns, correction = words
            fault = array_of(self._words.estimate) * np.isin(self._words.state, ALARMS)
            self._transfer.expect(correction, fault if fault.any() and is_usable(fault) else None)
            self._keep_gyro(self._body(last_ns, correction))
            self._keep_status(self._words)

    def _keep_fault(self, stamp_ns: int, read: ImuSample, flown: ImuSample) -> None:
        """Publish what the fault has become, as far as that shows without a diagnosis."""
        if self._words is None or not self._transfer.known:
            return
        fault = self._keeper.fault(stamp_ns, read, flown)
        if fault is not None:
            revise_status(self._words, stamp_ns, fault, self._monitor.patience.jump)
            self._keep_status(self._words)

    def _on_all(
        self, stamp_ns: int, imu: ImuSample, reference: AttitudeReference, disturbance: Floats
    ) -> None:
        self._control(stamp_ns, ControllerInputs(imu, reference, disturbance), Mode.FULL)

    def _on_latest(self, stamp_ns: int, imu: ImuSample, mode: Mode) -> None:
        """Real time: fly on a clean sample, with the latest of all else."""
        if self._reference is None:
            self.diagnostics.count("no attitude/reference yet")
            return
        if not self._stepper.timing(stamp_ns).accepted:
            return  # repeated: imu/corrected of a sample that imu/data has served already
        if self._mode is Mode.OFF and not self._monitor.is_back(stamp_ns):
            self._say(stamp_ns, nothing_but(np.zeros(3)), Mode.OFF, 0.0)
            return
        disturbance, share, trusted = self._monitor.disturbance_at(stamp_ns)
        if not trusted:
            mode = Mode.NO_DISTURBANCE_ESTIMATE if mode is Mode.FULL else mode
            if self._trusted:
                self._keep_disturbance(self._body(*self._estimate))
        self._trusted = trusted
        if self._missing != 1.0 - share:
            self._missing = 1.0 - share
            self._stepper.law = self._law.without_estimate(self._missing)
        flown = self._transfer.used(stamp_ns, imu, mode is Mode.NO_DIAGNOSIS)
        if mode is Mode.NO_DIAGNOSIS:
            self._keep_fault(stamp_ns, imu, flown)
        self._control(stamp_ns, ControllerInputs(flown, self._reference, disturbance), mode)

    def _control(self, stamp_ns: int, inputs: ControllerInputs, mode: Mode) -> None:
        begin, replaced = wall_seconds(), self._stepper.replaced
        output = self._stepper.step(stamp_ns, inputs)
        if output is None:
            return
        if self._stepper.replaced > replaced:
            self.diagnostics.count("the controller gave no number: the last torque is held")
        self._held.add(stamp_ns, output.torque)
        self._say(stamp_ns, output, mode, wall_seconds() - begin)

    def _say(self, stamp_ns: int, output: ControllerOutput, mode: Mode, compute_time: float) -> None:
        """Publish a torque and how it came about."""
        self._torque, self._stamp_ns = output.torque, stamp_ns
        self._publish_torque(self._body(stamp_ns, output.torque))
        self._publish_status(self._status(stamp_ns, output, mode, compute_time))
        self._enter(mode)
        self.sampled(stamp_ns)

    def _enter(self, mode: Mode) -> None:
        if mode is not self._mode:
            self._mode = mode
            self.diagnostics.report("mode", *_REPORTS[mode])

    def report(self) -> None:
        """Report a reference that stands still because its node does."""
        if not self.lockstep and self._stamp_ns and self._reference is not None:
            old = seconds(self._stamp_ns - self._reference_ns) > REFERENCE_AGE
            level, words = (
                (WARN, "attitude/reference does not come: the last is held") if old else (OK, "comes")
            )
            self.diagnostics.report("reference", level, words)

    def _on_watchdog(self) -> None:
        """Act when samples have stopped coming."""
        now_ns = self.pace.now().nanoseconds
        if self._stamp_ns != self._watched_ns:
            self._watched_ns, self._silent_since_ns = self._stamp_ns, now_ns
        mode = self._monitor.silence(seconds(now_ns - self._silent_since_ns))
        if mode is Mode.FULL or not self._stamp_ns:
            return
        torque = self._held.mean if mode is Mode.HOLD else np.zeros(3)
        self._say(self._stamp_ns, nothing_but(torque), mode, 0.0)


def main() -> None:
    """Run the node."""
    sys.exit(run_node(ControllerNode))
