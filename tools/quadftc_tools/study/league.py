"""The league of docs/league.md: who names the faults that are put on recorded flights, and who cries wolf.

    python -m quadftc_tools.study.league DATA [--docs docs]

DATA holds recordings in the folders ``ardupilot/``, ``broad/``, ``crazyflie/``, ``px4/``; scenarios of this
repository are flown as well. ``quadftc diagnose`` takes all of them, and every registered fault observer that
says what is faulty those with an attitude: healthy logs as they are, and a window around each fault. Without
``--docs`` the tables are printed.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadftc_cli.screen import say
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_replay.diagnose import diagnose
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.imu_from_log import recording_of
from quadftc_replay.inspection.diagnosis import read_with_layout
from quadftc_replay.inspection.flight import prepare
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.overlay import overlay_faults
from quadftc_replay.overlay import faults_from
from quadftc_replay.plan import choose_observer
from quadftc_tools.study.numbers import poisson_interval, write_number
from quadftc_tools.study.page import NOTHING, markdown, run_study

RECORDINGS = ("ardupilot/*/*.BIN", "broad/*", "crazyflie/*/*", "px4/**/*.ulg")
SIMULATED = "ardupilot/sitl"  # a file says which are healthy
# in the names of logs that are not healthy; the controller of DeLorean's 00000004 flies by a position that
# leaves the estimator's by 2.000 m on each axis from 9.1 s on
FAULTY = ("cut", "tape", "motor_failure", "brownout", "00000004")
ATTACK = "Attack Started"  # DeLorean's words; its flights are healthy until then
SLOW = 50.0  # Hz; of the gyro: default rates of autopilots are below
LASTS, EDGE = 2.0, 3.0  # s; of an overlaid fault, and from the begin of the flight
WINDOW = 3.0  # s; that an observer sees before and after a fault
SEEN, CLOSE = 0.25, 0.05  # s; from the true onset to one that is named: of a detection, of an isolation
SAMPLES = 2.0  # of a slow sensor, by which an onset is dated no better
REPEATS = 6  # of each case on each log: every axis, both signs
VEHICLE = "crazyflie_2x"  # of observers, where the log says none
SUITED = ("ROS 2 bag", "Crazyflie uSD")  # for an observer: torque [N m] or own attitude
HEALTHY_HEADINGS = ("who", "logs", "number", "in flight", "findings", "per hour")
AXES = {"gyro": "xyz", "accelerometer": "xyz", "attitude": ("roll", "pitch", "yaw")}
CASES = {
    "gyro step 0.2 rad/s": ("gyro", "bias axis={axis} value={sign}0.2"),
    "gyro step 0.4 rad/s": ("gyro", "bias axis={axis} value={sign}0.4"),
    "gyro stuck": ("gyro", "stuck axis={axis}"),
    "gyro noise 0.5 rad/s": ("gyro", "noise axis={axis} sigma=0.5"),
    "accelerometer step 3 m/s²": ("accelerometer", "bias axis={axis} value={sign}3"),
    "attitude step 5 deg": ("attitude", "bias axis={axis} value={sign}5deg"),
}


class Named(NamedTuple):
    """A fault that somebody names."""

    component: str
    element: str
    onset: float  # s


class Put(NamedTuple):
    """A fault that is put on a log."""

    element: str
    spec: str
    onset: float  # s
    close: float  # s; how near to it an isolation has to be


class Watch(NamedTuple):
    """Healthy logs that somebody judged."""

    logs: int
    seconds: float
    found: int


Judge = Callable[[FlightLog], list[Named]]


def simulated_logs(data: Path, healthy: bool) -> set[Path]:
    """Simulated ArduCopter flights below a folder that are healthy, or those that are not."""
    folder = data / SIMULATED
    truths = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    return {folder / name for name, truth in truths.items() if truth["healthy"] == healthy}


def read_healthy(data: Path) -> dict[str, list[FlightLog]]:
    """Read the healthy logs, by format; ValueError if there are none."""
    faulty = simulated_logs(data, healthy=False)
    groups: dict[str, list[FlightLog]] = {}
    for path in sorted(path for pattern in RECORDINGS for path in data.glob(pattern)):
        if path.name == "LICENSE" or path in faulty or any(word in path.name for word in FAULTY):
            continue
        log = read_with_layout(path, "")
        attacks = [event.time for event in log.events if ATTACK in event.text]
        groups.setdefault(_group(log), []).append(cut(log, 0.0, attacks[0]) if attacks else log)
    if not groups:
        raise ValueError(f"{data}: no logs; expected {', '.join(RECORDINGS)} there")
    return groups


def _group(log: FlightLog) -> str:
    gyro = next(iter(log.gyros.values()), None)
    return f"{log.format}, default rates" if gyro is not None and gyro.rate < SLOW else log.format


def cut(log: FlightLog, start: float, end: float) -> FlightLog:
    """Keep what lies between two times [s]."""

    def part(value: Any) -> Any:
        if isinstance(value, Signal):
            rows = slice(*np.searchsorted(value.time, (start, end)))
            return Signal(value.time[rows], value.value[rows])
        if isinstance(value, Mapping):
            return {name: part(each) for name, each in value.items()}  # type: ignore[reportUnknownVariableType]
        return value

    parts = {entry.name: part(getattr(log, entry.name)) for entry in dataclasses.fields(log)}
    parts["watched"] = tuple(each._replace(signal=part(each.signal)) for each in log.watched)
    parts["events"] = tuple(each for each in log.events if start <= each.time < end)
    return dataclasses.replace(log, **parts)


def judge_offline(log: FlightLog) -> list[Named]:
    """`quadftc diagnose`."""
    found = inspect(log).verdict.findings
    return [Named(each.component, each.element, each.onset_s) for each in found]


def judge_by(observer: str) -> Judge:
    """A fault observer by its name, sample by sample; what is ambiguous does not count."""

    def judge(log: FlightLog) -> list[Named]:
        recording = recording_of(log, next(iter(log.gyros)))
        begin = float(next(iter(log.gyros.values())).time[0])
        law = choose_observer(recording, observer, log.vehicle or VEHICLE).law
        named: list[Named] = []
        named_before: set[tuple[str, str]] = set()
        for report in diagnose(recording, law).reports:
            faults = [fault for fault in report.faults if not fault.ambiguous_with]
            for fault in faults:
                if (fault.component, fault.element) not in named_before:
                    onset = (fault.onset_ns - int(recording.stamp_ns[0])) / NANOSECONDS_PER_SECOND
                    named.append(Named(fault.component, fault.element, begin + onset))
            named_before = {(fault.component, fault.element) for fault in faults}
        return named

    return judge


def faults_on(log: FlightLog, title: str) -> Iterator[Put]:
    """Faults of a case on a log; none if it lacks the sensor."""
    channel, spec = CASES[title]
    attitude = log.attitude if log.attitude_from_gyro is not True else None
    gyro, force = (next(iter(sensors.values()), None) for sensors in (log.gyros, log.accelerometers))
    sensor = {"gyro": gyro, "accelerometer": force, "attitude": attitude}[channel]
    flight = max(prepare(log).intervals, key=lambda each: each.end - each.start)
    room = flight.start + min(EDGE, 0.2 * (flight.end - flight.start)), flight.end - LASTS
    if sensor is None or room[1] <= room[0]:
        return
    close = max(CLOSE, SAMPLES / sensor.rate)
    rng = np.random.default_rng([zlib.crc32(log.path.name.encode()), zlib.crc32(title.encode())])
    turns = itertools.cycle(itertools.product(("", "-"), AXES[channel]))
    for sign, axis in itertools.islice(turns, REPEATS):
        onset = float(rng.uniform(*room))
        what = f"{spec.format(axis=axis, sign=sign)} channel={channel}"
        yield Put(axis, f"{what} start={onset:.6f}s duration={LASTS:g}s", onset, close)


def around(log: FlightLog, onset: float) -> FlightLog:
    """Keep what an observer sees of a fault."""
    return cut(log, onset - WINDOW, onset + LASTS + WINDOW)


class Score(NamedTuple):
    """Faults of a case on logs, and how many of them are detected and isolated."""

    cases: int
    detected: int
    isolated: int


def score(judge: Judge, logs: Sequence[FlightLog], title: str, is_offline: bool) -> Score:
    """Put the faults of a case on logs, and count those that are named."""
    cases, detected, isolated = 0, 0, 0
    for log in logs:
        for fault in faults_on(log, title):
            faulty = overlay_faults(log, faults_from((), [fault.spec]))
            try:
                named = judge(faulty if is_offline else around(faulty, fault.onset))
            except ValueError as error:  # who fails names nothing
                say(f"{log.path.name}, {fault.spec}: {' '.join(str(error).split())}", stderr=True)
                named = []
            right = [each for each in named if each[:2] == (CASES[title][0], fault.element)]
            cases += 1
            detected += any(abs(each.onset - fault.onset) < SEEN for each in named)
            isolated += any(abs(each.onset - fault.onset) < fault.close for each in right)
    return Score(cases, detected, isolated)


def fault_row(scores: Sequence[Score]) -> list[str]:
    """How many faults there are of a case, at most, and of each case the shares that are named [%]."""
    most, cells = max(each.cases for each in scores), list[str]()
    for cases, *hits in scores:
        shares = "/".join(f"{100.0 * each / max(cases, 1):.0f}" for each in hits)
        cells.append(f"{shares}{'' if cases == most else f' of {cases}'}" if cases else NOTHING)
    return [str(most), *cells]


def watch(judge: Judge, logs: Sequence[FlightLog]) -> Watch:
    """Count what is found in healthy logs."""
    return Watch(len(logs), sum(prepare(log).duration for log in logs), sum(len(judge(log)) for log in logs))


def healthy_rows(who: str, watches: Mapping[str, Watch], each_group: bool) -> Iterator[list[str]]:
    """How long healthy logs are, what is found in them, how often an hour: by group if asked, and in all."""
    total = Watch(*(sum(column) for column in zip(*watches.values(), strict=True)))
    shown = {**(watches if each_group else {}), "all recordings": total}
    for group, (logs, seconds, found) in shown.items():
        low, high = (write_number(3600.0 * bound / seconds) for bound in poisson_interval(found))
        rate = f"{write_number(3600.0 * found / seconds)} [{low}, {high}]"
        yield [who, group, str(logs), f"{seconds:.0f} s", str(found), rate]


def make(data: Path) -> dict[str, str]:
    """Run all, and return the tables."""
    groups = read_healthy(data)
    judges: dict[str, Judge] = {"diagnose": judge_offline}
    for name in sorted(name for name in fault_observers.names() if fault_observers.get(name).has_detector):
        judges[name] = judge_by(name)
    of_healthy, of_faults = list[list[str]](), list[list[str]]()
    for who, judge in judges.items():
        is_offline = judge is judge_offline
        watches = dict[str, Watch]()
        for group, logs in groups.items():
            taken = [log for log in logs if is_offline or (log.attitude and log.gyros)]
            if taken:
                watches[group] = watch(judge, taken)
                say(f"{who}: {group}", stderr=True)
            if taken and (is_offline or group in SUITED):
                scores = [score(judge, taken, title, is_offline) for title in CASES]
                of_faults += [[who, group, *fault_row(scores)]] if any(each.cases for each in scores) else []
        of_healthy += healthy_rows(who, watches, is_offline)
    return {
        "league-healthy": markdown(HEALTHY_HEADINGS, of_healthy),
        "league-faults": markdown(["who", "logs", "faults", *CASES], of_faults),
    }


if __name__ == "__main__":
    known = {"data": {"type": Path, "help": "directory of the recordings"}}
    sys.exit(run_study("league.md", lambda options: make(options.data), known))
