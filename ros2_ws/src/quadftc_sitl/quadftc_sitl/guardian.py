"""Decides what is done about a diagnosis, as an operator has chosen beforehand.

>>> guardian = Guardian(Guard(actions={"gyro": "land"}))
>>> guardian.step(report, "GUIDED")     # a Decision, once, 0.3 s after 'gyro x' is named; else None

It reads reports of the fault observer and the autopilot's mode, and asks for one of `ACTIONS`. It never
disarms, sends no setpoint, and takes no mode back that it has asked for.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from quadftc_model.samples import FAULTY, ComponentFault, DiagnosisReport
from quadftc_sitl.plan import Guard

STALE_NS = 300_000_000  # ns; reports come at 10 Hz: after such a silence a fault has to be named anew
MODE_ACTIONS = ("alt_hold", "rtl", "land")  # the milder first: only a stronger one follows
# modes in which the autopilot flies by itself; a pilot's hands are left alone
AUTONOMOUS = (
    *("GUIDED", "AUTO", "LOITER", "POSHOLD", "CIRCLE", "BRAKE", "ALT_HOLD", "RTL", "SMART_RTL", "LAND"),
    *("OFFBOARD", "MISSION", "TAKEOFF"),
)


@dataclasses.dataclass
class Decision:
    """What is done about a fault, or why nothing is."""

    time: float  # of the sample at which it was decided [s]
    finding: str  # component and element
    kind: str
    action: str
    refused: str = ""  # why nothing is done; empty: it is asked for
    answer: str = ""  # of the autopilot

    @property
    def words(self) -> str:
        """What is decided, in a line."""
        what = f"{self.finding} {self.kind}: {self.action}"
        return f"{what} refused, {self.refused}" if self.refused else what


class Guardian:
    """Turns reports into decisions; ``decisions`` has all of them, a refusal once for each reason."""

    def __init__(self, guard: Guard) -> None:
        self.decisions: list[Decision] = []
        self._guard = guard
        self._since: dict[str, int] = {}  # finding -> stamp since which it is named without a break [ns]
        self._done: set[str] = set()  # findings of which something was asked for
        self._reached = ""  # of `MODE_ACTIONS`, the strongest asked for
        self._last_ns = 0

    def step(self, report: DiagnosisReport, mode: str) -> Decision | None:
        """Hear a report on a vehicle that flies in a mode; return what is to be asked for now."""
        now = report.stamp_ns
        if not 0 <= now - self._last_ns <= STALE_NS:
            self._since = {}
        self._last_ns = now
        faulty = {f"{each.component} {each.element}": each for each in report.faults if each.state == FAULTY}
        self._since = {name: self._since.get(name, now) for name in faulty}
        for name, fault in faulty.items():
            action = self._guard.action_of(name)
            if not action or name in self._done or now - self._since[name] < 1e9 * self._guard.after:
                continue
            why = self._refusal(fault, action, faulty, mode)
            decision = Decision(1e-9 * now, name, fault.kind, action, why)
            if not why:
                self._done.add(name)
                self._reached = action if action in MODE_ACTIONS else self._reached
                self.decisions.append(decision)
                return decision
            if not any((each.finding, each.refused) == (name, why) for each in self.decisions):
                self.decisions.append(decision)
        return None

    def _refusal(
        self, fault: ComponentFault, action: str, faulty: Mapping[str, ComponentFault], mode: str
    ) -> str:
        """Return why an action is refused; empty: it is not."""
        # several components may be the faulty one: whichever it is, the same must have been chosen
        rivals = [each.replace("/", " ") for each in fault.ambiguous_with]
        others = [each for each in (*rivals, *faulty) if self._guard.action_of(each) != action]
        if others and not self._guard.ambiguous:
            return f"it may be {' or '.join(dict.fromkeys(others))}"
        if action not in MODE_ACTIONS:
            return ""
        if mode not in AUTONOMOUS:
            return f"a pilot flies, in {mode}"
        present = [
            each for each in (self._reached, mode.removeprefix("SMART_").lower()) if each in MODE_ACTIONS
        ]
        if any(MODE_ACTIONS.index(action) <= MODE_ACTIONS.index(each) for each in present):
            return f"{' and '.join(dict.fromkeys(present))} already"
        return ""
