# pyright: basic
"""The guardian node: does about a diagnosis what an operator chose beforehand, over MAVLink.

    ros2 run quadftc_sitl guardian --ros-args -p "actions:=['gyro=land', 'rotor=tell']" -p port:=14551

Inputs: diagnosis; the autopilot's MAVLink, forwarded to a UDP port of this machine.
Outputs: to the autopilot STATUSTEXT, MAV_CMD_DO_AUX_FUNCTION and MAV_CMD_DO_SET_MODE; each decision in
/diagnostics and in the node's log. It sends no heartbeat, which the autopilot could take for the ground
station's, and decides nothing while the vehicle is disarmed or lands.
"""

from __future__ import annotations

import dataclasses
import time
from functools import partial
from typing import Any

from pydantic import ValidationError
from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_flight.reported import report_of
from quadftc_model.parameters import parameter
from quadftc_ros.diagnostics import OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_sitl.commander import Commander, Steps
from quadftc_sitl.guardian import Guardian
from quadftc_sitl.journal import Journal
from quadftc_sitl.link import ONBOARD, MavlinkLink
from quadftc_sitl.plan import Guard

MESSAGES = {dialect.MAVLINK_MSG_ID_HEARTBEAT: 5.0, dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0}  # Hz
TICK, SILENT = 0.02, 3.0  # s; between two looks at the link; without a heartbeat the autopilot is not there


@dataclasses.dataclass(frozen=True)
class GuardianParameters:
    """Parameters of the node besides its actions."""

    after: float = parameter(0.3, unit="s", low=0.0, high=60.0, doc="for which a fault has to be named")
    ambiguous: bool = parameter(False, doc="act although a component with another action may be faulty")
    address: str = parameter("127.0.0.1", doc="of this machine, where MAVLink comes in")
    port: int = parameter(14551, low=0, high=65535, doc="UDP port there; 0: any that is free")


class GuardianNode(GraphNode):
    """A guardian between the topic ``diagnosis`` and an autopilot."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("guardian", **kwargs)
        self.settings.declare(GuardianParameters, read_only=True)
        self.settings.declare_list("actions", "each: FINDING=ACTION, such as 'gyro x=land'")
        values = self.settings.values()
        self._guardian = Guardian(guard_of(values["actions"], values["after"], values["ambiguous"]))
        self.link = MavlinkLink(values["address"], values["port"], ONBOARD)
        self._commander = Commander(self.link, Journal())
        self._errands: list[Steps] = []
        self._spoke = 0.0  # when the autopilot did [s]
        self._asked = False  # for the messages that are needed
        self.reads("diagnosis", self._on_diagnosis)
        self._timer = self.create_timer(TICK, self.look, clock=self.steady_clock)
        self.ready()

    def look(self) -> None:
        """Hear the autopilot, and go on with what is to be done."""
        journal = self._commander.journal
        journal.now = time.monotonic()
        for message in self.link.receive():
            journal.hear(message)
            self._spoke = journal.now
        if self.link.target != journal.source or (self._spoke and not self._asked):
            self.link.target, self._asked = journal.source, True
            self._errands.append(self._commander.ask_messages(MESSAGES))
        self._errands = [errand for errand in self._errands if next(errand, "end") is None]

    def destroy_node(self) -> None:
        """Close the link, too."""
        self.link.close()
        super().destroy_node()

    def report(self) -> None:
        """Report whether the autopilot speaks, and what was decided last."""
        there = time.monotonic() < self._spoke + SILENT
        words = f"in {self._commander.journal.mode_name}" if there else "no MAVLink from it"
        self.diagnostics.report("autopilot", OK if there else WARN, words)
        decided = [each.words for each in self._guardian.decisions]
        self.diagnostics.report("decision", WARN if decided else OK, decided[-1] if decided else "none")

    def _on_diagnosis(self, stamp_ns: int, message: Any) -> None:
        if not self._commander.journal.flies:
            return
        known = len(self._guardian.decisions)
        report = report_of(stamp_ns, message.watched, message.faults)
        decision = self._guardian.step(report, self._commander.journal.mode_name)
        for each in self._guardian.decisions[known:]:
            self.get_logger().warning(each.words)
            self.diagnostics.changed = True
        if decision is not None:
            self._errands.append(self._commander.carry_out(decision))
        self.sampled(stamp_ns)


def guard_of(actions: list[str], after: float, ambiguous: bool) -> Guard:
    """Return what a guardian is to do by texts FINDING=ACTION; ValueError for one that makes no sense."""
    pairs = {finding: action for finding, _, action in (text.partition("=") for text in actions)}
    try:
        return Guard(actions=pairs, after=after, ambiguous=ambiguous)
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(f"actions: {first['msg'].removeprefix('Value error, ')}") from None


main = partial(run_node, GuardianNode)
