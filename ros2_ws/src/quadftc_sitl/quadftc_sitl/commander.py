# pyright: basic
"""Commands to an autopilot, sent until they are answered, one step after the other between two samples."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_sitl.guardian import Decision
from quadftc_sitl.journal import Journal
from quadftc_sitl.link import MavlinkLink

RETRY = 1.0  # s; until something unanswered is sent again
TRIES = 5
EKF_LANE_SWITCH, HIGH = 103.0, 2.0  # auxiliary function of ArduPilot, and position of its switch
COMES_DOWN = ("LAND", "RTL")
RESULTS: Mapping[int | None, str] = {
    number: entry.name for number, entry in dialect.enums["MAV_RESULT"].items()
}

Asked = Generator[None, None, int | None]  # its result is a MAV_RESULT; None: there was no answer
Steps = Iterator[None]


class Commander:
    """Sends commands; each method is a generator that is stepped whenever ``journal.now`` has moved on."""

    def __init__(self, link: MavlinkLink, journal: Journal) -> None:
        self.journal, self._link = journal, link

    def ask_messages(self, rates: Mapping[int, float]) -> Steps:
        """Ask for messages by their numbers, each at a rate [Hz]."""
        for message, rate in rates.items():
            yield from self._command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, message, 1e6 / rate)

    def carry_out(self, decision: Decision) -> Steps:
        """Tell of a guardian's decision, do it, and note what the autopilot answers."""
        self._link.tell(f"guardian: {decision.words}")
        if decision.action == "lane":
            since = self.journal.now
            answer = yield from self._command(dialect.MAV_CMD_DO_AUX_FUNCTION, EKF_LANE_SWITCH, HIGH)
            switched = yield from self._until(lambda: self.journal.lane_since(since), RETRY)
            decision.answer = f"{RESULTS.get(answer, 'no answer')}, {'another' if switched else 'same'} lane"
        elif decision.action != "tell":
            name = decision.action.upper()
            answer = yield from self._ask_mode(name)
            yield from self._until(lambda: self.journal.mode_name == name, RETRY)
            decision.answer = f"{RESULTS.get(answer, 'no answer')}, mode {self.journal.mode_name}"

    def _ask_mode(self, name: str) -> Asked:
        """Ask for a mode; return the MAV_RESULT. One that is refused has not been asked for."""
        before, self.journal.asked_mode = self.journal.asked_mode, name
        self.journal.may_disarm |= name in COMES_DOWN
        flags = float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        mode = self.journal.mode_parameters(name)
        answer = yield from self._command(dialect.MAV_CMD_DO_SET_MODE, flags, *mode)
        if answer not in (None, dialect.MAV_RESULT_ACCEPTED):
            self.journal.asked_mode = before
        return answer

    def _command(self, number: int, *parameters: float) -> Asked:
        """Send a command until it is answered; return its MAV_RESULT, None without an answer."""
        self.journal.acknowledged.pop(number, None)
        for _ in range(TRIES):
            self._link.command(number, *parameters)
            if (yield from self._until(lambda: number in self.journal.acknowledged, RETRY)):
                return self.journal.acknowledged[number]
        return None

    def _until(self, condition: Callable[[], bool], patience: float) -> Generator[None, None, bool]:
        """Wait for a condition, so many seconds at most; return whether it holds."""
        end = self.journal.now + patience
        while not condition() and self.journal.now < end:
            yield
        return condition()
