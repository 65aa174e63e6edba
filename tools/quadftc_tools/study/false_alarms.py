"""How often `quadftc diagnose` is wrong: on healthy flights, simulated and real, and of all it finds.

    python -m quadftc_tools.study.false_alarms [--flights 500] [--faulty 150] [--seed 91000] [--data DATA]
        [--docs docs] [--write]

Random vehicles fly in free flight. Each flight is written as ArduPilot and as PX4 log it by default, read
back and judged. As many more have a fault. Of real logs below DATA each without a finding gets offsets of its
sensors that last to its end. The tables go into docs/diagnose.md, or onto the screen without ``--docs``.
``--write`` stores the healthy flights for ``--false-alarms``, with some that tests fly again. Nothing was
tuned on flights from seed 91000 on, but for seven: 91052, 91417, 91420, 91435, 91442 and 91446 have shaped
the test of stuck gyros and the date of a creep; 91425, how two tests of one rotor go together.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadftc_cli.screen import say
from quadftc_replay.calibration import FLIGHTS
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.inspection.diagnosis import DiagnosisOptions, diagnose_log, read_with_layout
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.overlay import overlay_faults
from quadftc_replay.inspection.verdict import Finding, Verdict
from quadftc_replay.overlay import faults_from
from quadftc_tools.study.league import simulated_logs
from quadftc_tools.study.numbers import poisson_interval, write_share
from quadftc_tools.study.page import NOTHING, Tables, markdown, run_study
from quadftc_tools.study.random_flights import Loss
from quadftc_tools.study.simulated_logs import as_logged, fly_log

AUTOPILOTS = {"ardupilot": "ArduPilot", "px4": "PX4"}  # writer -> how the names of its formats begin
SHORTEST, LONGEST = 30.0, 150.0  # s
HOUR = 3600.0  # s
NEAR = 1.0  # s; from a fault to the onset of a finding that is true
BINS = (0.0, 0.75, 0.9, 0.95, 0.99, 1.0)  # of probability
AGAIN = 4  # flights of each kind that tests fly again
# logs of ../shared/data that are healthy as far as anybody knows, by what they are of
HEALTHY = {
    "ArduCopter in simulation (SITL)": ("ardupilot/delorean/00000004.BIN", "ardupilot/adgfuzz/*.BIN"),
    "PX4 (ULog)": ("px4/pyulog/*.ulg",),
    "Crazyflie (uSD)": ("crazyflie/sysid/log*", "crazyflie/crazyswarm2/log*", "crazyflie/crazypad/*normal*"),
    "IMU moved by hand (bag)": ("broad/*/*.mcap",),
}
CHANNELS = {  # what is put on a log, to its end: axes, sizes of an offset, unit
    "gyro": (("x", "y", "z"), (0.03, 1.0), "rad/s"),
    "accelerometer": (("x", "y", "z"), (0.5, 6.0), "m/s^2"),
    "attitude": (("roll", "pitch", "yaw"), (2.0, 20.0), "deg"),
}
REPEATS = 2  # offsets of each sensor of a real log
SIGMAS, TENTH = 2.0, 0.1  # by which a size may be off


class Truth(NamedTuple):
    """What fails in a flight."""

    component: str
    element: str
    onset: float  # s
    size: float  # [SI]; of a rotor the share of its thrust that is lost

    def is_told_by(self, finding: Finding) -> bool:
        """Whether a finding tells of it."""
        same = (finding.component, finding.element) == (self.component, self.element)
        return same and abs(finding.onset_s - self.onset) <= NEAR


class Judged(NamedTuple):
    """A flight as it was judged."""

    seed: int
    group: str  # vehicle, or what logs are of
    autopilot: str
    truth: Truth | None  # None: healthy
    verdict: Verdict

    @property
    def score(self) -> float:
        """Largest probability of a finding; 0 without one."""
        return max((each.probability for each in self.verdict.findings), default=0.0)

    @property
    def hours(self) -> float:
        """Time in flight [h]."""
        return self.verdict.flight_s / HOUR


def judge_seed(
    seed: int, is_faulty: bool = False, autopilots: Sequence[str] = tuple(AUTOPILOTS)
) -> Iterator[Judged]:
    """Fly a seed, healthy or with a fault, and judge the logs of some; a sensor fails in each by itself."""
    rng = np.random.default_rng([seed, 1])
    seconds = rng.uniform(SHORTEST, LONGEST)
    onset = rng.uniform(0.2, 0.8) * seconds
    channel = str(rng.choice((*CHANNELS, "rotor")))
    loss = None
    if is_faulty and channel == "rotor":
        loss = Loss(rng.random(), rng.uniform(0.15, 1.0), onset)
    flight, log = fly_log(seed, seconds, loss)
    truth = None if loss is None else Truth("rotor", str(flight.rotor), onset, loss.share)
    for name, read in as_logged(log):
        if is_faulty and loss is None:
            read, truth = with_offset(read, channel, onset, rng, seed)  # noqa: PLW2901
        if name in autopilots:
            yield Judged(seed, flight.base, name, truth, inspect(read).verdict)


def with_offset(
    log: FlightLog, channel: str, onset: float, rng: np.random.Generator, seed: int
) -> tuple[FlightLog, Truth]:
    """Put an offset of a sensor on a log, from its onset [s] to the end; return both."""
    axes, (low, high), unit = CHANNELS[channel]
    axis = str(rng.choice(axes))
    size = low * (high / low) ** rng.random() * float(rng.choice((-1.0, 1.0)))
    spec = f"bias channel={channel} axes={axis} value={size:.4g}{unit} start={onset:.3f}s"
    si = float(np.radians(size)) if unit == "deg" else size
    return overlay_faults(log, faults_from((), (spec,)), seed), Truth(channel, axis, onset, si)


def judge_real(data: Path) -> Iterator[Judged]:
    """Judge the healthy logs below a folder; those without a finding also with offsets of their sensors."""
    for number, (group, patterns) in enumerate(HEALTHY.items()):
        simulated = simulated_logs(data, healthy=True) if number == 0 else ()
        for path in sorted((*simulated, *(path for name in patterns for path in data.glob(name)))):
            healthy = Judged(0, group, "", None, diagnose_log(path, DiagnosisOptions()).verdict)
            yield healthy
            if healthy.score == 0.0:
                yield from _judge_with_offsets(read_with_layout(path, ""), group)


def _judge_with_offsets(log: FlightLog, group: str) -> Iterator[Judged]:
    rng = np.random.default_rng(zlib.crc32(log.path.name.encode()))
    sensors = {"gyro": log.gyros, "accelerometer": log.accelerometers}
    for channel in (channel for channel, there in sensors.items() for _ in range(REPEATS * bool(there))):
        faulty, truth = with_offset(log, channel, rng.uniform(0.1, 0.9) * log.end, rng, 0)
        yield Judged(0, group, "", truth, inspect(faulty).verdict)


def healthy_table(judged: Sequence[Judged], group: str) -> str:
    """Findings of healthy flights, by what was flown, with exact intervals."""
    rows = dict[tuple[str, str], list[Judged]]()
    for each in judged:
        for key in ((each.autopilot, each.group), (each.autopilot, "all")):
            rows.setdefault(key, []).append(each)
    headings = (group, "flights", "hours", "with a finding", "per cent [95 %]", "findings", "an hour [95 %]")
    return markdown(headings, (_healthy_row(*key, found) for key, found in sorted(rows.items())))


def _healthy_row(autopilot: str, group: str, judged: Sequence[Judged]) -> Sequence[str]:
    hours, flights = sum(each.hours for each in judged), len(judged)
    wrong = sum(each.score > 0.0 for each in judged)
    findings = sum(len(each.verdict.findings) for each in judged)
    least, most = poisson_interval(findings)
    name, share = f"{AUTOPILOTS.get(autopilot, '')} {group}".strip(), write_share(wrong, flights, 1)
    rate = f"{findings / hours:.2g} [{least / hours:.2g}, {most / hours:.2g}]"
    return name, str(flights), f"{hours:.2f}", str(wrong), share, str(findings), rate


def named_table(judged: Iterable[Judged]) -> str:
    """How many faults the first finding names, how late, and of how many it has the size."""
    groups = defaultdict[tuple[str, str], list[Judged]](list)
    for each in judged:
        if each.truth is not None:
            logs = f"simulated {AUTOPILOTS[each.autopilot]}" if each.autopilot else "real"
            groups[logs, each.truth.component].append(each)
    headings = ("logs", "fault of", "faults", "named", "per cent [95 %]")
    headings += ("onset off by, median / 90 %", "size right")
    return markdown(headings, (_named_row(*key, found) for key, found in sorted(groups.items())))


def _named_row(logs: str, component: str, judged: Sequence[Judged]) -> Sequence[str]:
    pairs = [
        (each.truth, each.verdict.findings[0]) for each in judged if each.truth and each.verdict.findings
    ]
    named = [(truth, first) for truth, first in pairs if truth.is_told_by(first)]
    sized = sum(
        first.size is not None
        and abs(first.size - truth.size) <= max(SIGMAS * (first.sigma or 0.0), TENTH * abs(truth.size))
        for truth, first in named
    )
    late = [abs(first.onset_s - truth.onset) for truth, first in named]
    times = "/".join(f"{np.quantile(late, share):.2f}" for share in (0.5, 0.9)) + " s" if late else NOTHING
    hits, faults = len(named), len(judged)
    return logs, component, str(faults), str(hits), write_share(hits, faults), times, str(sized)


def reliability_table(judged: Iterable[Judged]) -> str:
    """Of all findings, by their probability, the share that is true."""
    held = defaultdict[int, list[bool]](list)
    for each in judged:
        for finding in each.verdict.findings:
            number = int(np.searchsorted(BINS, finding.probability, side="right"))
            held[min(number, len(BINS) - 1)].append(each.truth is not None and each.truth.is_told_by(finding))
    rows: list[Sequence[str]] = []
    for number, found in sorted(held.items()):
        span = f"{BINS[number - 1]:g} to {BINS[number]:g}"
        rows.append((span, str(len(found)), str(sum(found)), write_share(sum(found), len(found))))
    return markdown(("probability", "findings", "true", "per cent [95 %]"), rows)


def stored(healthy: Sequence[Judged], faulty: Sequence[Judged]) -> dict[str, object]:
    """What `quadftc_replay.calibration` reads, and flights that tests fly again: nearest to 0.9."""
    autopilots = dict[str, object]()
    for name, format_name in AUTOPILOTS.items():
        flown = [each for each in healthy if each.autopilot == name]
        scores = sorted((round(each.score, 4) for each in flown if each.score), reverse=True)
        hours = round(sum(each.hours for each in flown), 3)
        autopilots[format_name] = {"flights": len(flown), "hours": hours, "scores": scores}
    again = list[dict[str, object]]()
    for kind in (healthy, faulty):
        for each in sorted(kind, key=lambda judged: abs(judged.score - 0.9))[:AGAIN]:
            flown = {"seed": each.seed, "autopilot": each.autopilot, "is_faulty": each.truth is not None}
            again.append({**flown, "score": round(each.score, 4)})
    commit = subprocess.run(("git", "rev-parse", "HEAD"), capture_output=True, text=True, check=True).stdout
    return {
        "judge": commit.strip(),
        "first_seed": min(each.seed for each in healthy),
        "vehicles": sorted({each.group for each in healthy}),
        "autopilots": autopilots,
        "again": again,
    }


def _told(judged: Iterable[Judged]) -> Iterator[Judged]:
    """Say what is wrong, as it comes."""
    for each in judged:
        for finding in each.verdict.findings:
            if each.truth is None or not each.truth.is_told_by(finding):
                where = f"seed {each.seed}, {each.autopilot}, {each.group}, {each.truth}"
                what = f"{finding.name} {finding.kind} at {finding.onset_s:.1f} s, {finding.probability:.3f}"
                say(f"wrong: {where}: {what}", stderr=True)
        yield each


def make(options: argparse.Namespace) -> Tables:
    """Fly and judge; return the tables, and store the flights if asked to."""
    middle = options.seed + options.flights
    healthy = [each for seed in range(options.seed, middle) for each in _told(judge_seed(seed))]
    last = middle + options.faulty
    faulty = [each for seed in range(middle, last) for each in _told(judge_seed(seed, is_faulty=True))]
    real = [*judge_real(options.data)] if options.data else []
    tables = {"named": named_table((*faulty, *real))}
    if healthy:
        tables["false-alarms-simulated"] = healthy_table(healthy, "simulated")
        tables["reliability"] = reliability_table((*healthy, *faulty))
    if real:
        tables["false-alarms-real"] = healthy_table([each for each in real if each.truth is None], "real")
    if options.write:
        FLIGHTS.write_text(json.dumps(stored(healthy, faulty), indent=1) + "\n", encoding="utf-8")
    return tables


if __name__ == "__main__":
    known = {
        "--flights": {"type": int, "default": 500, "help": "healthy ones"},
        "--faulty": {"type": int, "default": 150, "help": "flights with a fault"},
        "--seed": {"type": int, "default": 91000, "help": "of the first flight"},
        "--data": {"type": Path, "help": "folder of real logs"},
        "--write": {"action": "store_true", "help": "store the healthy flights for --false-alarms"},
    }
    sys.exit(run_study("diagnose.md", make, known))
