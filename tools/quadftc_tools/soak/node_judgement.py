# pyright: basic
"""Judges a flight in which nodes were hit, by its bag: attitude, return, torque, non-finite values."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import Bag, read_bag
from quadftc_control.input_monitor import Mode
from quadftc_control.transfer import TORQUE_JUMP
from quadftc_model.vehicle import load_vehicle
from quadftc_ros.diagnostics import ERROR
from quadftc_tools.soak.flights import attitude_error, statuses

KILL = "killed (SIGKILL)"
LARGEST, LARGEST_GIVEN_UP = 5.0, 20.0  # deg; attitude error
# without these there is nothing to fly by: zero torque until they are back, and who has to say so
GIVES_UP = {"controller": "plant: torque", "fault_injector": "controller: mode"}
BACK, WITHIN = 0.5, 3.0  # deg, s; the error has to be below that, so long after the end
BEFORE = 1.0  # s; that the vehicle must have flown well before it counts
SILENT = 0.2  # s; a topic that has a gap as long had lost its node
AWAKE = 0.02  # s; between two torques of a controller that runs
TIMEOUT, NOTICE = 0.5, 0.5  # s; of torques and of the IMU, and for it to be said
FLOWN = (Mode.FULL, Mode.NO_DIAGNOSIS, Mode.NO_DISTURBANCE_ESTIMATE)
OUTPUTS = {  # by which a node is heard; others may hear it before the recorder does, and answer
    "fault_observer": ("imu/corrected",),
    "disturbance_observer": ("disturbance/estimate",),
    "controller": ("control/status",),
    "reference": ("attitude/reference",),
    "fault_injector": ("imu/data", "imu/corrected"),
}
NANOSECONDS = 1e9


@dataclasses.dataclass(frozen=True)
class Hit:
    """What happens in one window."""

    node: str
    action: str
    stress: str  # what acts meanwhile


@dataclasses.dataclass
class Record:
    """When a hit was made, by the wall clock; a node that was killed is back after its end."""

    hit: Hit
    begin_ns: int = 0
    end_ns: int = 0
    until_ns: int = 0  # end of its window


@dataclasses.dataclass(frozen=True)
class Trial:
    """What came of one hit."""

    node: str
    action: str
    stress: str
    largest_deg: float  # attitude error in its window; where the vehicle gives up, until it has
    away_s: float  # for which a killed node was away; 0 for others
    returned_s: float  # from its end, or from when the node was back, until the error stayed below `BACK`
    jump: float  # of the authority; largest step of torque at a change of mode; 0 where the vehicle gives up
    wrong: str  # empty if all held
    void: bool = False  # the vehicle was off before the hit: the machine could not carry the flight


class Judge:
    """Reads a bag once, and judges each hit."""

    def __init__(self, bag: Path) -> None:
        self._bag = read_bag(bag)
        self._log_ns, self._error = attitude_error(self._bag)
        self._lost = list(_not_finite(self._bag))

    def judge(self, record: Record) -> Trial:
        """Judge one hit."""
        hit, begin_ns, end_ns = record.hit, record.begin_ns, record.end_ns
        killed = hit.action == KILL
        back_ns, away = self._back(hit.node, begin_ns, record.until_ns) if killed else (end_ns, 0.0)
        wrong = list(self._lost)
        gives_up = killed and hit.node in GIVES_UP
        if gives_up:
            until_ns = begin_ns + (TIMEOUT + NOTICE) * NANOSECONDS
            largest, bound = self._largest(begin_ns, until_ns), LARGEST_GIVEN_UP
            if not self._told(GIVES_UP[hit.node], begin_ns, until_ns):
                wrong.append("it was not reported in time")
            if not self._without_torque(hit.node, begin_ns, back_ns):
                wrong.append("the torque is not zero")
        else:
            largest, bound = self._largest(begin_ns, record.until_ns), LARGEST
        if largest > bound:
            wrong.append(f"attitude off by {largest:.1f} deg")
        returned = self._returned(back_ns, record.until_ns)
        if back_ns > record.until_ns:
            wrong.append("the node did not come back")
        elif returned > WITHIN:
            wrong.append(f"attitude still off {returned:.1f} s later")
        jump = 0.0 if gives_up else self._jump(begin_ns, record.until_ns)
        if jump > TORQUE_JUMP:
            wrong.append(f"torque jumped by {100.0 * jump:.1f} % of the authority")
        words = "; ".join(wrong)
        void = bool(wrong) and self._largest(begin_ns - BEFORE * NANOSECONDS, begin_ns) > BACK
        return Trial(hit.node, hit.action, hit.stress, largest, away, returned, jump, words, void)

    def _during(self, begin_ns: float, end_ns: float) -> NDArray[np.bool_]:
        return (self._log_ns >= begin_ns) & (self._log_ns < end_ns)

    def _largest(self, begin_ns: float, end_ns: float) -> float:
        return float(np.max(self._error[self._during(begin_ns, end_ns)], initial=0.0))

    def _returned(self, begin_ns: float, end_ns: float) -> float:
        off = self._log_ns[self._during(begin_ns, end_ns) & (self._error > BACK)]
        return (float(off[-1]) - begin_ns) / NANOSECONDS if len(off) else 0.0

    def _back(self, node: str, begin_ns: int, until_ns: int) -> tuple[float, float]:
        """When a killed node was heard again [ns], and how long it was away [s]."""
        heard = OUTPUTS[node]
        times = np.sort(np.concatenate([self._bag.series(topic).log_time_ns for topic in heard]))
        times = times[times >= begin_ns]
        times = np.concatenate([[begin_ns], times])
        gaps = np.flatnonzero(np.diff(times) > SILENT * NANOSECONDS)
        back = float(times[gaps[0] + 1]) if len(gaps) else float(until_ns + 1)
        return back, (back - begin_ns) / NANOSECONDS

    def _without_torque(self, node: str, begin_ns: int, back_ns: float) -> bool:
        """Whether the controller, if there is one, commands zero torque in the end."""
        torque = self._bag.series("torque/command")
        late = begin_ns + (TIMEOUT + NOTICE) * NANOSECONDS
        during = (torque.log_time_ns > late) & (torque.log_time_ns < back_ns)
        return node == "controller" or (bool(during.any()) and not torque["vector"][during].any())

    def _told(self, part: str, begin_ns: float, end_ns: float) -> bool:
        """Whether an error was reported of a part, as /diagnostics names it."""
        return any(
            begin_ns <= log_time_ns <= end_ns and status.name.endswith(part) and status.level == ERROR
            for log_time_ns, status in statuses(self._bag)
        )

    def _jump(self, begin_ns: int, until_ns: int) -> float:
        """Largest step of the torque at a sample at which the controller changes between flying modes.

        Not over a gap in which the controller itself did not run: the vehicle has moved meanwhile.
        """
        status, torque = self._bag.series("control/status"), self._bag.series("torque/command")
        size = min(len(status), len(torque))
        if not np.array_equal(status.stamp_ns[:size], torque.stamp_ns[:size]):
            size = 0  # messages between them were not recorded
        mode, values = status["mode"][:size].astype(int), torque["vector"][:size]
        flown = np.isin(mode, [int(each) for each in FLOWN])
        changed = (mode[1:] != mode[:-1]) & flown[1:] & flown[:-1]
        changed &= np.diff(status.stamp_ns[:size]) <= AWAKE * NANOSECONDS
        inside = (status.log_time_ns[1:size] >= begin_ns) & (status.log_time_ns[1:size] < until_ns)
        steps = np.abs(np.diff(values, axis=0)) / load_vehicle("qball_x4").authority
        return float(np.max(steps[changed & inside], initial=0.0))


def _not_finite(bag: Bag) -> Iterable[str]:
    """Yield the fields with non-finite values."""
    for name in bag.topics:
        if name == "/diagnostics":
            continue
        for field, values in bag.series(name).fields.items():
            if values.dtype.kind == "f" and not np.all(np.isfinite(values)):
                yield f"{name}: {field} is not finite"
