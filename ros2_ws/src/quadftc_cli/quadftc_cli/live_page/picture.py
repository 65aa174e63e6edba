# pyright: basic
"""What the page shows of a flight: attitudes, thrust, rows of numbers for charts, states of components."""

from __future__ import annotations

import math
import re
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from quadftc_bags.cdr.message import NANOSECONDS, read_message
from quadftc_cli.live_page.feed import Frame
from quadftc_fdi.diagnosis import COMPONENTS, elements_of
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import FAULTY, STARTING, SUSPECT
from quadftc_model.vehicle import Vehicle
from quadftc_msgs.msg import ComponentFault, ControlStatus, Diagnosis, FaultStatus, RotorStatus
from quadftc_ros.conversions import Floats
from quadftc_ros.latest import SOURCES, Latest
from quadftc_ros.rotor_wire import RotorConditionReader
from quadftc_ros.topics import PlantKind
from quadftc_ros.wire import imu_of, pose_of, reference_in, vector_of

CHART_PERIOD_NS = NANOSECONDS // 15  # ns, between two rows
ROWS = 450  # 30 s
SPAN = 45  # rows, 3 s; over which the speed of the flight is measured
LEVELS = ("ok", "warning", "error", "stale")
MODES = ("full", "no diagnosis", "no disturbance estimate", "hold", "off")
NOTHING = np.full(3, np.nan)
NO_KIND = "unknown"  # what an observer says that does not tell kinds of faults apart


class State(NamedTuple):
    """How an element of a component is."""

    name: str  # healthy, suspect, faulty, ambiguous, recovering, starting, unwatched
    words: str  # what is known of its fault


def _read(kind: type) -> Callable[[bytes], Any]:
    return lambda data: read_message(data, kind)


class Picture:
    """What is known of a flight; frames come in, and whoever draws looks at it."""

    def __init__(self, vehicle: Vehicle, plant: PlantKind) -> None:
        self.latest = Latest(vehicle, plant)
        self.rotors = len(vehicle.rotors.positions) if self.latest.flies else 0
        self.rows: deque[list[float]] = deque(maxlen=ROWS)
        self.count = 0  # rows so far
        self.frames = 0
        self.over = False  # the flight has ended
        self._condition = RotorConditionReader(len(vehicle.rotors.positions))
        self._statuses: dict[str, DiagnosticStatus] = {}
        self.begin_ns = 0  # stamp at which the flight began; 0: that of the first sample that comes
        self.namespace, self.namespaces = "", frozenset[str]()  # of the vehicle; of all vehicles
        self.silent: frozenset[str] = frozenset()  # topics on which nothing ever comes
        self._next_ns = 0
        self._clocks: deque[tuple[float, float]] = deque(maxlen=SPAN)  # s; of the machine, of the flight

    def take(self, frame: Frame) -> None:
        """Take a frame."""
        self.frames += 1
        for topic, data in frame.last.items():
            self.latest.put(topic, data)
        for data in frame.diagnostics:
            told = read_message(data, DiagnosticArray).status
            self._statuses |= {status.name: status for status in told if not self._is_of_another(status.name)}
        stamp_ns = self.latest.stamp_ns()
        self.begin_ns = self.begin_ns or stamp_ns
        if stamp_ns >= self._next_ns:
            self._next_ns = stamp_ns + CHART_PERIOD_NS
            self.rows.append(self._row())
            self.count += 1
            self._clocks.append((time.monotonic(), self.time))

    def _is_of_another(self, name: str) -> bool:
        """Return whether a status, ``namespace/node: part``, is of another vehicle."""
        return name.partition(":")[0].rpartition("/")[0] in self.namespaces - {self.namespace}

    def forget(self) -> None:
        """Forget all that came, as what comes next is from another time of the flight."""
        self.latest.forget()
        self.rows.clear()
        self._statuses.clear()
        self._next_ns = 0

    @property
    def time(self) -> float:
        """Time since the first sample that was shown [s]."""
        return (self.latest.stamp_ns() - self.begin_ns) / NANOSECONDS

    @property
    def speed(self) -> float:
        """How fast the flight runs, over real time, in the last seconds; 1 until that is known."""
        if len(self._clocks) < SPAN:
            return 1.0
        (begin, first), (end, last) = self._clocks[0], self._clocks[-1]
        return (last - first) / (end - begin)

    def _row(self) -> list[float]:
        """Return the numbers of the charts at a moment, in the order of `COLUMNS`; NaN: unknown."""
        latest = self.latest
        angles = {role: np.degrees(euler_from_quaternion(q)) for role, q in latest.attitudes().items()}
        reference = latest.read("attitude/reference", reference_in)
        imus = [latest.read(SOURCES[role], imu_of) for role in ("measured", "corrected")]
        rates = [NOTHING if imu is None else np.where(imu.rate_valid, imu.body_rate, np.nan) for imu in imus]
        status = latest.read("fault/status", _read(FaultStatus))
        estimate, sigma = (NOTHING, NOTHING) if status is None else _estimate(status)
        columns = [
            [self.time],
            NOTHING if reference is None else np.degrees(reference.angles),
            *(angles.get(role, NOTHING) for role in SOURCES),
            np.degrees(_or_nothing(latest.body_rate())),
            *(np.degrees(rate) for rate in rates),
            np.degrees(_or_nothing(latest.read("fault/injected", vector_of))),
            *(np.degrees(estimate), np.degrees(estimate - 2.0 * sigma), np.degrees(4.0 * sigma)),
            _or_nothing(latest.read("torque/command", vector_of)),
            *self._places(),
            *self._effectiveness(),
        ]
        return [float(value) for value in np.concatenate(columns)]

    def _places(self) -> list[Floats]:
        """Return where the vehicle shall be, and where it is [m]."""
        if not self.latest.flies:
            return []
        pose = self.latest.read("position/reference", pose_of)
        return [NOTHING if pose is None else pose[0], self.latest.position()]

    def _effectiveness(self) -> list[list[float]]:
        """Return the estimated and the true effectiveness of each rotor [%]."""
        if not self.rotors:
            return []
        status = self.latest.read("rotors/status", _read(RotorStatus))
        truth = self.latest.read("rotors/fault", self._condition)
        unknown = [math.nan] * self.rotors
        estimated = unknown if status is None or not status.effectiveness else list(status.effectiveness)
        return [
            [100.0 * value for value in estimated],
            [100.0 * value for value in (unknown if truth is None else truth.effectiveness)],
        ]

    def states(self) -> dict[str, dict[str, State]]:
        """Return how each element of each component is."""
        diagnosis = self.latest.read("diagnosis", _read(Diagnosis))
        watched = [] if diagnosis is None else list(diagnosis.watched)
        confirmed = [] if diagnosis is None else diagnosis.faults
        faults = {f"{each.component}/{each.element}": each for each in confirmed}
        rivals = {name for fault in faults.values() for name in fault.ambiguous_with} - {*faults}
        suspects = self._suspects()
        found: dict[str, dict[str, State]] = {}
        for component in (*COMPONENTS, *(["rotor"] if self.rotors else [])):
            found[component] = {}
            for element in elements_of(component, self.rotors)[0]:
                name = f"{component}/{element}"
                if name in faults:
                    state = self._fault(faults[name])
                elif name in rivals:
                    state = State("ambiguous", "may be the faulty one instead")
                elif component not in watched:
                    state = State("starting" if suspects.get(name) == STARTING else "unwatched", "")
                else:
                    state = State("suspect" if suspects.get(name) == SUSPECT else "healthy", "")
                found[component][element] = state
        return found

    def _suspects(self) -> dict[str, int]:
        """Return the states of attitude and rotors, which show a suspicion before a fault is confirmed."""
        states: dict[str, int] = {}
        told = {"attitude": ("fault/status", FaultStatus), "rotor": ("rotors/status", RotorStatus)}
        for component, (topic, kind) in told.items():
            if (status := self.latest.read(topic, _read(kind))) is not None:
                elements = elements_of(component, len(status.state))[0]
                names = [f"{component}/{element}" for element in elements]
                states |= dict(zip(names, map(int, status.state), strict=True))
        return states

    def _fault(self, fault: ComponentFault) -> State:
        """Describe a confirmed fault."""
        name = "ambiguous" if fault.ambiguous_with else "faulty" if fault.state == FAULTY else "recovering"
        onset = (fault.onset.sec * NANOSECONDS + fault.onset.nanosec - self.begin_ns) / NANOSECONDS
        words = f"{kind_and_size(fault)}, since {onset:.2f} s"
        if fault.ambiguous_with:
            words += f"; or {', '.join(each.replace('/', ' ') for each in fault.ambiguous_with)}"
        return State(name, words)

    def warnings(self) -> list[tuple[str, str, str]]:
        """Return level, name and words of what the nodes warn of, the worst first."""
        found = [(level_of(status), status.name, status.message) for status in self._statuses.values()]
        worst_first = sorted(found, reverse=True)
        return [(LEVELS[min(level, 3)], name, words) for level, name, words in worst_first if level]

    def mode(self) -> str:
        """Return the mode of the controller in words."""
        status = self.latest.read("control/status", _read(ControlStatus))
        if status is None:
            return "silent"
        return MODES[status.mode] if status.mode < len(MODES) else str(status.mode)

    def value(self, node: str, part: str, key: str) -> str:
        """Return a value that a node reports; empty if it does not."""
        status = self._status(node, part)
        return "" if status is None else next((pair.value for pair in status.values if pair.key == key), "")

    def _status(self, node: str, part: str) -> DiagnosticStatus | None:
        found = (status for name, status in self._statuses.items() if name.endswith(f"{node}: {part}"))
        return next(found, None)  # behind the namespace

    def parts(self, begun: str) -> str:
        """Return what flies; ``begun`` is what began, whose observer may have been changed in flight."""
        status = self._status("fault_observer", "observer")
        observer = "" if status is None else status.message.partition(" ")[0]
        return re.sub("(?<=observer )[^,]+", observer, begun) if observer else begun


def kind_and_size(fault: ComponentFault) -> str:
    """Write what a fault looks like and how large it is; the size alone where the observer tells no kind."""
    size = amount(fault.size, fault.std_dev, fault.unit)
    return size if fault.kind == NO_KIND else f"{fault.kind} {size}"


def amount(size: float, std_dev: float, unit: str) -> str:
    """Write a size with its standard deviation: angles in degrees, shares in percent."""
    angle, share = unit.startswith("rad"), unit == "1"
    scale = math.degrees(1.0) if angle else 100.0 if share else 1.0
    unit = unit.replace("rad", "deg") if angle else "%" if share else unit.replace("^2", "²")
    digits = 0 if share else 2
    spread = f" ± {scale * std_dev:.{digits}f}" if std_dev >= 0.0 else ""
    return f"{scale * size:.{digits}f}{spread} {unit}"


def _estimate(status: FaultStatus) -> tuple[Floats, Floats]:
    """Return estimate and standard deviation [rad]; NaN where there is none."""
    estimate, sigma = (np.array([part.x, part.y, part.z]) for part in (status.estimate, status.std_dev))
    has_begun = np.array(status.state) != STARTING
    return np.where(has_begun, estimate, np.nan), np.where(sigma < 0.0, np.nan, sigma)


def _or_nothing(vector: Floats | None) -> Floats:
    return NOTHING if vector is None else vector


def level_of(status: DiagnosticStatus) -> int:
    """Return the level of a status, which rclpy gives as a byte."""
    return status.level[0] if isinstance(status.level, bytes) else int(status.level)
