# pyright: basic
"""A flight that one can touch: in real time, with the topics and services of a backend node.

`quadftc inject`, `clear` and `watch`, and the page of `quadftc live`, find a node such as
``ardupilot_backend``. Until the vehicle is armed, time runs as fast as the machine can.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.parameter import Parameter

from quadftc_flight.graph.following import ALONE
from quadftc_flight.scenario import Fault
from quadftc_model.parameters import parameter
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import DiagnosisReport, PositionReference
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.diagnostics import OK, WARN
from quadftc_ros.executor import NodeHost, StopSignals
from quadftc_ros.motion_wire import PoseWire
from quadftc_ros.node import GraphNode
from quadftc_ros.rotor_wire import RotorStatusWire
from quadftc_ros.topics import EARTH_FRAME, crowded_topics
from quadftc_ros.transport import Tap
from quadftc_ros.wire import FaultStatusWire, ImuWire, VectorWire
from quadftc_sim.assembly import EPOCH_NS
from quadftc_sim.autopilot import Shown
from quadftc_sim.backend_node import BackendOutput
from quadftc_sim.injector_ports import InjectorPorts
from quadftc_sitl.firmware import SitlError
from quadftc_sitl.journal import Event, Journal
from quadftc_sitl.physics import Physics
from quadftc_sitl.pilot import Pilot
from quadftc_sitl.plan import SitlPlan
from quadftc_sitl.truth import MICROSECOND, shifted

LOOK, TO_BE_FOUND = 0.01, 1.0  # s; between two looks at services and clock; for other vehicles in the domain
BEHIND = 0.1  # s; what is more behind real time is not caught up
TOLD = 5  # of the autopilot's last warnings, in /diagnostics
SPOKEN = ("mode", "lane", "disarmed")  # events that are told though they alarm nobody


@dataclasses.dataclass(frozen=True)
class Live:
    """How a flight is shown."""

    stop: StopSignals  # the first ends the mission
    say: Callable[[str], object]  # takes a line for the operator
    tap: Tap | None = None  # as of `GraphNode`
    frame: Callable[[], object] = lambda: None  # is called after each look


@dataclasses.dataclass(frozen=True)
class SitlParameters:
    """What others may ask the node."""

    vehicle: str = parameter("", doc="name of the vehicle, or path of its TOML file")
    observer: str = parameter("", doc="name of the fault observer that runs beside the autopilot")


class SitlNode(GraphNode):
    """The vehicle of a flight, its faults, its fault observer and what the autopilot says.

    Outputs: those of `BackendOutput` and `InjectorPorts`; position/reference; imu/corrected, fault/estimate,
    fault/status, rotors/status and diagnosis, as of a fault observer.
    """

    def __init__(self, plan: SitlPlan, physics: Physics, journal: Journal, **kwargs: Any) -> None:
        super().__init__(f"{plan.autopilot.name}_backend", **kwargs)
        self.settings.declare(SitlParameters, read_only=True)
        rotors = plan.scenario.rotors
        self._journal, self._rate = journal, plan.rate
        self._faults = InjectorPorts(
            self, lambda: physics.injector, rotors, flies=True, under="fault_injector"
        )
        self._output = BackendOutput(self, physics.law, self._faults)
        self.warned: list[str] = []  # what the autopilot has warned of in flight
        self._publish_place, self._place = self.publishes("position/reference"), PoseWire()
        self._publish_corrected, self._imu = self.publishes("imu/corrected"), ImuWire(self.imu_frame)
        self._publish_estimate, self._earth = self.publishes("fault/estimate"), VectorWire(EARTH_FRAME)
        self._publish_status, self._status = self.publishes("fault/status"), FaultStatusWire(self.imu_frame)
        self._publish_rotors = self.publishes("rotors/status")
        self._rotors = RotorStatusWire(rotors, self.base_frame)
        self._publish_report, self._report = self.publishes("diagnosis"), DiagnosisWire(self.imu_frame)
        self.ready()

    def show(self, shown: Shown, physics: Physics) -> None:
        """Publish a sample, and what the fault observer says of it."""
        self._output.show(shown)
        if (estimate := physics.estimate) is None:
            return
        stamp_ns = shown.emission.sample_stamp_ns
        self._publish_corrected(self._imu(stamp_ns, estimate.corrected))
        self._publish_rotors(self._rotors(stamp_ns, estimate.rotors))
        self._publish_estimate(self._earth(stamp_ns, estimate.fault))
        self._publish_status(self._status(stamp_ns, estimate))
        if physics.report is not None:
            self._publish_report(self._report(physics.report))

    def aim(self, stamp_ns: int, wanted: PositionReference) -> None:
        """Publish where the vehicle shall be."""
        heading = quaternion_from_euler(np.array([0.0, 0.0, float(wanted.yaw)]))
        self._publish_place(self._place(stamp_ns, wanted.position, heading))

    def connections(self) -> dict[str, int]:
        """Return none: whoever likes reads the topics."""
        return {}

    def report(self) -> None:
        """Report what the autopilot does, what it has warned of, and the faults that act."""
        journal = self._journal
        words = f"{journal.mode_name}, {'armed' if journal.armed else 'not armed'}"
        self.diagnostics.report("autopilot", OK, words, mode=journal.mode_name, rate_hz=f"{self._rate:g}")
        self.diagnostics.report("said", WARN if self.warned else OK, "; ".join(self.warned[-TOLD:]))
        level, words, active = self._faults.status()
        self.diagnostics.report("faults", level, words, **active)


class LiveFlight(NodeHost):
    """Runs the node of a flight, and keeps its time; a context manager.

    A `SitlError` says if another vehicle is in the ROS domain.
    """

    def __init__(self, live: Live, plan: SitlPlan, physics: Physics, pilot: Pilot) -> None:
        super().__init__("launcher")
        self._live, self._physics, self._pilot = live, physics, pilot
        self._zero: float | None = None  # of real time, on the monotonic clock [s]; None: not armed yet
        self._looked = 0.0  # on that clock
        self._heard = self._reported = 0  # events and reports that were told
        self._faults: dict[int, Fault] = {}  # that were told
        self._named, self._begun = "", False
        self._refusals: set[str] = set()  # of arming, that were told
        given = {
            "plant_kind": "free_flight",
            "vehicle": plan.scenario.vehicle,
            "observer": plan.scheme.observer.kind,
        }
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        options = {"context": self._context, "parameter_overrides": overrides, "use_global_arguments": False}
        self._node = self._host(SitlNode(plan, physics, pilot.journal, tap=live.tap, **options))
        self._serve(time.monotonic() + TO_BE_FOUND)
        if crowd := crowded_topics(self._node.count_publishers, "free_flight"):
            self.close()
            raise SitlError(f"{crowd[0]}: {ALONE}")

    def show(self, shown: Shown) -> None:
        """Publish a sample."""
        self._node.show(shown, self._physics)

    def tell(self, words: str) -> None:
        """Tell the operator what has happened now."""
        self._say(words)

    def pace(self) -> None:
        """Serve the node, and wait until it is time for the next sample; before arming there is no wait.

        Ctrl-C ends the mission: the vehicle lands. On the ground it ends the flight, a KeyboardInterrupt.
        """
        now, flown = time.monotonic(), self._physics.now
        if self._zero is None and self._pilot.journal.armed:
            self._zero = now - flown
            self._say("armed: real time from now on")
        due = now if self._zero is None else self._zero + flown
        if now - due > BEHIND:
            self._zero = now - flown
        if due - now < LOOK and now - self._looked < LOOK:
            return
        self._serve(due)
        self._looked = time.monotonic()
        self._obey()
        self._tell()
        if self._physics.last is not None:
            self._node.aim(self._physics.last.emission.stamp_ns, self._pilot.reference(flown))
        if self._node.diagnostics.changed:
            self._node.diagnostics.publish(self._node.now_ns())
        self._live.frame()

    def _serve(self, due: float) -> None:
        """Serve the node until a time of the monotonic clock [s], once at least."""
        while True:
            left = due - time.monotonic()
            self._executor.spin_once(timeout_sec=max(0.0, left))
            if left <= 0.0:
                return

    def _obey(self) -> None:
        """Land if the operator asks for it."""
        if not self._live.stop.requested:
            return
        if self._pilot.began is None:
            raise KeyboardInterrupt
        if self._physics.now < self._pilot.end:
            self._pilot.end = self._physics.now
            self._say("Ctrl-C: it lands; again: all ends at once")

    def _tell(self) -> None:
        """Tell the operator of faults, and of what autopilot and observer say of them."""
        if self._pilot.began is not None and not self._begun:
            self._begun = True
            self._say("the mission begins", self._pilot.began)
        faults = self._physics.injector.noted()
        for number, fault in faults.items():
            if number not in self._faults:
                zero = self._pilot.began or 0.0
                moved = dataclasses.replace(fault, injection=shifted(fault.injection, -zero, MICROSECOND))
                self._say(f"fault {number}: {moved.spec}")
            elif fault.injection.stop != self._faults[number].injection.stop:
                self._say(f"fault {number}: cleared")
        for number in self._faults.keys() - faults.keys():
            self._say(f"fault {number}: cleared before it began")
        self._faults = faults
        events, reports = self._pilot.journal.events, self._physics.reports
        for event in events[self._heard :]:
            self._tell_event(event)
        for report in reports[self._reported :]:
            self._tell_report(report)
        self._heard, self._reported = len(events), len(reports)

    def _tell_event(self, event: Event) -> None:
        """Tell of what the autopilot says: in flight what matters, on the ground why it does not arm."""
        if self._zero is None:
            if event.words.startswith(self._pilot.journal.REFUSALS) and event.words not in self._refusals:
                self._refusals.add(event.words)
                self._say(f"autopilot: {event.words}", event.time)
        elif event.serious or event.kind in SPOKEN:
            self._say(f"autopilot: {event.words}", event.time)
            if event.serious:
                self._node.warned.append(event.words)
                self._node.diagnostics.changed = True

    def _tell_report(self, report: DiagnosisReport) -> None:
        """Tell of what the fault observer names in the mission, where that has changed.

        In a vehicle that tumbles it names many, and others each time.
        """
        names = [
            " or ".join(
                (f"{each.component} {each.element}", *(r.replace("/", " ") for r in each.ambiguous_with))
            )
            for each in report.faults
        ]
        named = ", ".join(names)
        at = 1e-9 * (report.stamp_ns - EPOCH_NS)
        if named != self._named and at <= self._pilot.end and self._pilot.lost is None:
            self._named = named
            self._say(f"observer: {named or 'no fault'}", at)

    def _say(self, words: str, at: float | None = None) -> None:
        """Say a line with the scenario time of it [s]."""
        began, now = self._pilot.began, self._physics.now if at is None else at
        self._live.say(f"{'before' if began is None else f'{now - began:.2f} s':>9}  {words}")
