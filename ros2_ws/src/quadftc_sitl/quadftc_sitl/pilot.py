# pyright: basic
"""Flies a plan over MAVLink as an operator would: checks, arming, climb, mission, landing.

It runs in the time of the physics, one step after the other between two samples. So what it sends reaches the
autopilot at the same sample in every flight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_control.trajectory import combined
from quadftc_model.frames import enu_from_ned
from quadftc_model.samples import PositionReference
from quadftc_sim.autopilot import to_degrees
from quadftc_sitl.commander import COMES_DOWN, RETRY, TRIES, Commander, Steps
from quadftc_sitl.firmware import SitlError
from quadftc_sitl.guardian import Decision
from quadftc_sitl.journal import Journal
from quadftc_sitl.link import MULTIROTORS, MavlinkLink
from quadftc_sitl.plan import OwnFault, SitlPlan

TICK = 0.02  # s; between two steps
SETPOINTS = 0.1  # s; between two setpoints
# s; the longest that each may take
TO_SPEAK, TO_BE_READY, TO_ARM, TO_CLIMB, TO_LAND = 60.0, 60.0, 30.0, 60.0, 60.0
SETTLING = 4.0  # s; of hovering where the trajectories begin, before scenario time 0
AFTERWARDS = 2.0  # s; flown on after the end, so that the log has it
WAYPOINT_PERIOD, WAYPOINT_DISTANCE = 4.0, 1.0  # s, m; between waypoints of a mission
MESSAGES = {  # that it shall send -> Hz
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 4,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10,
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 10,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 10,
}


class Pilot(Commander):
    """An operator of one flight of ArduCopter; call `step` at every sample until ``done``."""

    HOME = (-35.363262, 149.165237, 584.0)  # latitude, longitude [deg], height [m]; ArduPilot's usual field
    JOURNAL: type[Journal] = Journal
    FOLLOWS, MISSION = "GUIDED", "AUTO"  # modes in which it takes setpoints, and flies a mission
    FIRST_ITEM: tuple[tuple[float, float, float], ...] = ((*HOME[:2], 0.0),)  # of a mission: home
    MESSAGES: Mapping[int, float] = {**MESSAGES, dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 10}

    def __init__(self, plan: SitlPlan, link: MavlinkLink, begin: Callable[[], None]) -> None:
        """Take what to fly; ``begin`` is called at scenario time 0."""
        super().__init__(link, self.JOURNAL())
        self.done, self.landed = False, False
        self.began: float | None = None  # time at scenario time 0 [s]
        self.lost: float | None = None  # since when the vehicle is lost [s]; set from outside
        self.end = math.inf  # of the mission [s]
        self._plan, self._begin = plan, begin
        self._trajectories = tuple(part.law for part in plan.scenario.trajectories)
        self._first = combined(self._trajectories, 0.0)
        self._steps, self._next, self._beat = self._fly(), 0.0, 0.0
        self._were: dict[str, float] = {}  # values of parameters before faults
        self._failing: set[str] = set()  # own faults that were commanded
        self._errands: list[Steps] = []  # beside the mission

    def step(self, now: float) -> None:
        """Hear what has come at a time [s], and go on."""
        self.journal.now = now
        for message in self._link.receive():
            self.journal.hear(message)
        if now < self._next or self.done:
            return
        self._next = now + TICK
        if now >= self._beat:
            self._beat = now + 1.0
            self._link.heartbeat()
            if self.journal.asked_mode == "ALT_HOLD":
                self._link.centre_sticks()
        self._errands = [errand for errand in self._errands if next(errand, "end") is None]
        self.done = next(self._steps, "end") is not None

    def obey(self, decision: Decision) -> None:
        """Carry out a guardian's decision beside the mission, which ends where the mode changes."""
        self._errands.append(self.carry_out(decision))

    @property
    def flies(self) -> bool:
        """The vehicle is in the air, and not lost."""
        return self.journal.armed and self.lost is None

    def reference(self, now: float) -> PositionReference:
        """Return where the vehicle shall be at a time [s]; before 0 where it begins."""
        elapsed = 0.0 if self.began is None else max(0.0, now - self.began)
        return combined(self._trajectories, elapsed)

    def _fly(self) -> Steps:
        yield from self._connect()
        yield from self._read_parameters()
        yield from self._get_ready()
        yield from self._arm()
        yield from self._climb()
        if self._plan.section.mode == "auto":
            yield from self._upload_mission()
            yield from self._set_mode(self.MISSION)
        self.began = self.journal.now
        self.end = self.began + self._plan.scenario.duration
        self._begin()
        yield from self._follow()
        yield from self._come_down()

    def _connect(self) -> Steps:
        """Wait for a heartbeat of a copter with as many rotors as the vehicle; ask for its version."""
        journal = self.journal
        yield from self._wait(
            lambda: journal.kind is not None, TO_SPEAK, lambda: "no heartbeat on its first serial port"
        )
        if journal.autopilot != journal.AUTOPILOT:
            raise SitlError(f"MAV_AUTOPILOT {journal.autopilot} answers, expected {journal.NAME}")
        rotors = self._plan.scenario.rotors
        if MULTIROTORS.get(journal.kind or 0) != rotors:
            raise SitlError(f"another vehicle answers: MAV_TYPE {journal.kind}, expected {rotors} rotors")
        self._link.target = journal.source
        yield from self.ask_messages(self.MESSAGES)
        version = float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        yield from self._command(dialect.MAV_CMD_REQUEST_MESSAGE, version)

    def _read_parameters(self) -> Steps:
        """Read the parameters that the plan names, so that a name it does not know is refused."""
        section = self._plan.section
        for name in dict.fromkeys([*section.parameters, *(n for fault in section.faults for n in fault.set)]):
            self.journal.parameters.pop(name, None)
            for _ in range(TRIES):
                self._link.ask_parameter(name)
                if (yield from self._until(lambda name=name: name in self.journal.parameters, RETRY)):
                    break
            else:
                raise SitlError(f"{name}: this firmware has no such parameter")
        self._were = dict(self.journal.parameters)

    def _get_ready(self) -> Steps:
        """Wait until it says that it can be armed."""
        yield from self._be_armable()
        yield from self._set_mode(self.FOLLOWS)

    def _be_armable(self) -> Steps:
        yield from self._until(lambda: self.journal.can_arm, TO_BE_READY)

    def _arm(self) -> Steps:
        """Arm, as soon as it lets itself be; a refusal to the end is an error, in its words."""
        since, answer = self.journal.now, None
        end = since + TO_ARM
        while not self.journal.armed and self.journal.now < end:
            since = self.journal.now
            answer = yield from self._command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
            accepted = answer == dialect.MAV_RESULT_ACCEPTED
            yield from self._until(lambda: self.journal.armed, 3.0 if accepted else RETRY)
        if not self.journal.armed:
            yield from self._ask_why()
            said = "; ".join(self.journal.refusals(since)) or f"MAV_RESULT {answer}"
            raise SitlError(f"arming refused: {said}")
        self.journal.may_disarm = False

    def _ask_why(self) -> Steps:
        """Have it say why it does not arm, if it has not."""
        yield from ()

    def _climb(self) -> Steps:
        """Climb to where the trajectories begin, and settle there."""
        yield from self._take_off(float(self._first.position[2]))
        for _ in range(round(SETTLING / SETPOINTS)):
            self._send_setpoint()
            yield from self._pause(SETPOINTS)

    def _take_off(self, height: float) -> Steps:
        """Climb to a height [m] by a command."""
        answer = yield from self._command(
            dialect.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, max(height, 1.0)
        )
        if answer != dialect.MAV_RESULT_ACCEPTED:
            raise SitlError(f"take-off refused: MAV_RESULT {answer}")
        yield from self._reach(height, TO_CLIMB)

    def _reach(self, height: float, patience: float) -> Steps:
        """Wait until it is at a height [m]."""
        yield from self._wait(
            lambda: -self.journal.position[2] > 0.9 * height,
            patience,
            lambda: f"did not climb to {height:g} m; it is at {-self.journal.position[2]:.2f} m",
        )

    def _upload_mission(self) -> Steps:
        """Send waypoints along the trajectories."""
        items = [*self.FIRST_ITEM, *self._waypoints()]
        self.journal.mission_result = None
        self._link.mission_count(len(items))
        last = self.journal.now
        while self.journal.mission_result is None:
            if self.journal.now > last + TRIES * RETRY:
                raise SitlError("does not take a mission: it asks for no items")
            number, self.journal.wanted_item = self.journal.wanted_item, None
            if number is not None and number < len(items):
                last = self.journal.now
                self._link.mission_item(number, items[number])
            yield
        if self.journal.mission_result != dialect.MAV_MISSION_ACCEPTED:
            raise SitlError(f"does not take a mission: MAV_MISSION_RESULT {self.journal.mission_result}")

    def _waypoints(self) -> list[tuple[float, float, float]]:
        """Return latitude, longitude [deg] and height [m] of places along the trajectories."""
        places = [self._first.position]
        for number in range(1, int(self._plan.scenario.duration / WAYPOINT_PERIOD) + 1):
            place = combined(self._trajectories, number * WAYPOINT_PERIOD).position
            if math.dist(place, places[-1]) > WAYPOINT_DISTANCE:
                places.append(place)
        return [(*to_degrees(self.HOME, x, y), float(z)) for x, y, z in places]

    def _follow(self) -> Steps:
        """Follow the trajectories to the end of the mission, and put its own faults on and off."""
        begin = self.journal.now
        while self.journal.now < self.end and self.flies:
            if self.journal.asked_mode == self.FOLLOWS:
                self._send_setpoint()
            for fault in self._plan.section.faults:
                self._set_fault(fault, self.journal.now - begin)
            yield from self._pause(SETPOINTS)

    def _come_down(self) -> Steps:
        """Land, unless the vehicle is lost."""
        if self.flies:
            if self.journal.asked_mode not in COMES_DOWN:
                yield from self._set_mode(self._plan.section.end.upper())
            yield from self._until(lambda: not self.flies, TO_LAND)
        self.landed = not self.journal.armed and self.lost is None
        yield from self._pause(AFTERWARDS)

    def _send_setpoint(self) -> None:
        """Send where to be now; its origin is where it stood at first."""
        wanted = self.reference(self.journal.now)
        offset = [float(self._first.position[0]), float(self._first.position[1]), 0.0]
        place, speed, push = (
            enu_from_ned(vector).tolist()
            for vector in (wanted.position - offset, wanted.velocity, wanted.acceleration)
        )
        self._link.fly_to(self.journal.now, place, speed, push, 0.5 * math.pi - float(wanted.yaw))

    def _set_fault(self, fault: OwnFault, elapsed: float) -> None:
        """Set the parameters of a fault to what they shall be at a scenario time [s]."""
        share = 0.0
        if fault.start <= elapsed < fault.end:
            share = 1.0 if fault.rise == 0.0 else min(1.0, (elapsed - fault.start) / fault.rise)
        for name, value in fault.set.items():
            wanted = self._were[name] + share * (value - self._were[name])
            if wanted != self.journal.parameters.get(name):
                self.journal.parameters[name] = wanted
                self._link.set_parameter(name, wanted, self.journal.integers.get(name, False))
        if fault.inject and bool(share) != (fault.inject in self._failing):
            self._failing ^= {fault.inject}
            self._errands.append(self._fail(fault, bool(share)))

    def _fail(self, fault: OwnFault, fails: bool) -> Steps:
        """Have a sensor of its fail by a command, or be well again."""
        raise NotImplementedError

    def _set_mode(self, name: str) -> Steps:
        """Change the mode, perhaps when it is ready for it; a refusal before scenario time 0 is an error."""
        for _ in range(TRIES):
            answer = yield from self._ask_mode(name)
            if answer != dialect.MAV_RESULT_TEMPORARILY_REJECTED:
                break
            yield from self._pause(RETRY)
        if answer != dialect.MAV_RESULT_ACCEPTED and self.began is None:
            raise SitlError(f"mode {name} refused: MAV_RESULT {answer}")

    def _wait(self, condition: Callable[[], bool], patience: float, words: Callable[[], str]) -> Steps:
        """Wait for a condition; a `SitlError` if it does not come true in time."""
        if not (yield from self._until(condition, patience)):
            raise SitlError(f"{words()}, within {patience:g} s of its clock")

    def _pause(self, duration: float) -> Steps:
        yield from self._until(lambda: False, duration - 0.5 * TICK)
