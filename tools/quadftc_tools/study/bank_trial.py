"""Fault observers side by side: which sensor has a fault, on the same samples.

python3 -m quadftc_tools.study.bank_trial --flights 1000 --docs docs

Healthy vehicles fly in gusts, without diagnosis, and faults are added to what was recorded: what is said of
them has no effect on the flight, so all observers judge the same. A push is flown indeed. A flight has one
onset for all kinds of fault, so an observer sees the samples before that once.

Flights are drawn by their seeds: those of tuning and those of judging are apart.
"""

from __future__ import annotations

import argparse
import functools
import math
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_compile.build import build_library
from quadftc_compile.recipe import recipe_of
from quadftc_compile.runner import CRunner
from quadftc_fdi.fault_observer import fault_observer_from, fault_observers
from quadftc_flight.closed_loop import LoopFlyer, loop_of
from quadftc_flight.loop import ClosedLoop
from quadftc_flight.reported import joined
from quadftc_flight.scenario import Scenario, build_scenario, load_scenario, with_duration, with_seed
from quadftc_flight.scenario.document import Keys
from quadftc_model.arrays import rows_of
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import ALARMS, FaultEstimate, FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.assembly import sample_count
from quadftc_tools.study.numbers import write_per_cent, write_times
from quadftc_tools.study.page import NOTHING, Tables, markdown, run_study

Floats = NDArray[np.float64]
Words = NDArray[np.bool_]  # (rows, sensors, axes)

SCENARIO = Path(__file__).resolve().parents[3] / "campaigns" / "scenarios" / "which_sensor.yaml"
PAGE = "bank.md"
DURATION, ONSETS, SETTLED = 14.0, (6.0, 9.0), 2.0  # s; without a fault, alarms count from the last on
PUSHED = 0.3  # s
DEG = math.pi / 180.0
SEEDS = {"tuning": range(100), "judging": range(1000, 1_000_000)}
ATTITUDE, GYRO, ACCELEROMETER = range(3)  # sensors, as in `SensorDiagnosis`
NOBODY, PUSH = -1, -2
HEAD = (
    *("fault", "flights", "by", "named", "misnamed at some time", "ambiguous to the end"),
    "named after, median / 95 % / largest",
)


class Kind(NamedTuple):
    """A kind of fault."""

    sensor: int  # `NOBODY`: there is none; `PUSH`: an acceleration that no sensor is to blame for
    smallest: float = 0.0  # [SI]
    largest: float = 0.0
    power: int = 0  # of time, with which it grows


KINDS = {
    "none": Kind(NOBODY),
    "gyro: step of 0.15 to 0.5 rad/s": Kind(GYRO, 0.15, 0.5),
    "gyro: step of 0.03 to 0.15 rad/s": Kind(GYRO, 0.03, 0.15),
    "gyro: ramp of 0.05 to 0.5 rad/s²": Kind(GYRO, 0.05, 0.5, 1),
    "gyro: ramp of 0.005 to 0.05 rad/s²": Kind(GYRO, 0.005, 0.05, 1),
    "attitude: step of 0.5 to 10 deg": Kind(ATTITUDE, 0.5 * DEG, 10.0 * DEG),
    "attitude: ramp of 0.3 to 3 deg/s": Kind(ATTITUDE, 0.3 * DEG, 3.0 * DEG, 1),
    "attitude: ramp of 0.05 to 0.3 deg/s": Kind(ATTITUDE, 0.05 * DEG, 0.3 * DEG, 1),
    "push of 2 to 10 rad/s² for 0.3 s": Kind(PUSH, 2.0, 10.0),
}


class Fault(NamedTuple):
    """A fault of one flight."""

    kind: Kind
    axis: int
    size: float  # signed [SI]


class Verdict(NamedTuple):
    """What is said of a flight."""

    delay: float | None  # from the onset until the fault was named [s]; None: it was not
    wrong: bool  # another sensor or axis was named at some time
    unsure: bool  # nothing was named, but something was ambiguous at some time


class Judged(NamedTuple):
    """Verdict on one kind of fault by one observer."""

    kind: str
    observer: str
    verdict: Verdict


def draw_faults(seed: int) -> tuple[float, dict[str, Fault]]:
    """Draw the onset [s] of a flight, and its faults by kind."""
    rng, faults = np.random.default_rng([seed, 1]), dict[str, Fault]()
    onset = float(rng.uniform(*ONSETS))
    for name, kind in KINDS.items():
        size = rng.uniform(kind.smallest, kind.largest) * rng.choice([-1.0, 1.0])
        faults[name] = Fault(kind, int(rng.integers(3)), float(size))
    return onset, faults


@functools.cache
def flyer() -> LoopFlyer:
    """Return what flies vehicles in this process, one after the other."""
    return LoopFlyer()


def _loop_of(seed: int, start: float, torque: Floats) -> tuple[Scenario, ClosedLoop]:
    document = load_scenario(SCENARIO).document
    gusts = {**document.data["disturbances"][0], "history": seed}
    push = {"kind": "constant", "amplitude": torque.tolist(), "start": start, "stop": start + PUSHED}
    changes: dict[Keys, object] = {("faults",): [], ("disturbances",): [gusts, push]}
    scenario = build_scenario(document.replaced(changes, "trial"))
    scenario = with_seed(with_duration(scenario, DURATION), seed)
    return scenario, loop_of(scenario, scenario.scheme("without_diagnosis"))


def record_flight(seed: int, start: float, torque: Floats) -> tuple[FaultObserverInputs, float]:
    """Fly with a push by a torque [N m] from ``start`` [s] on; return samples (n, ...), their period."""
    scenario, loop = _loop_of(seed, start, torque)
    count, parts = sample_count(scenario.duration, scenario.rate), list[Any]()
    for _, made in flyer().fly(loop, seed, count):
        parts.append(joined([(made.left, made.faulty.sample, made.said.attitude.said.output.torque)]))
    left, imu, commanded = joined(parts)
    came = np.flatnonzero(left)
    torque = np.concatenate([np.zeros((1, 3)), commanded[came][:-1]])
    driven = np.ones(len(came), np.bool_)
    return FaultObserverInputs(rows_of(imu, came), torque, driven=driven), 1.0 / scenario.rate


def with_fault(imu: ImuSample, fault: Fault, dt: float) -> ImuSample:
    """Add a fault to samples (n, ...), which begins at the first."""
    elapsed = np.arange(len(imu.body_rate)) * dt
    added = (elapsed**fault.kind.power)[:, None] * fault.size * (np.arange(3) == fault.axis)
    if fault.kind.sensor == GYRO:
        return imu._replace(body_rate=imu.body_rate + added)
    if fault.kind.sensor == ATTITUDE:
        return imu._replace(q_xyzw=quaternion_from_euler(euler_from_quaternion(imu.q_xyzw) + added))
    return imu


def words_of(estimate: FaultEstimate) -> tuple[Words, Words]:
    """Return which axes are named, and which are ambiguous."""
    assert estimate.sensors is not None
    alarm = np.stack([np.isin(each.state, ALARMS) for each in estimate.sensors], axis=1)
    ambiguous = np.stack([each.ambiguous for each in estimate.sensors], axis=1)
    return alarm & ~ambiguous, alarm & ambiguous


def verdict_of(named: Words, ambiguous: Words, fault: Fault, dt: float) -> Verdict:
    """Judge words from the onset of a fault on."""
    right = np.zeros(named.shape[1:], np.bool_)
    if fault.kind.sensor >= 0:
        right[fault.kind.sensor, fault.axis] = True
    hits = np.flatnonzero((named & right).any(axis=(1, 2)))
    wrong = bool((named & ~right).any())
    unsure = bool(ambiguous.any()) and not wrong and not len(hits)
    return Verdict(float(hits[0]) * dt if len(hits) else None, wrong, unsure)


@functools.cache
def runner_of(observer: str) -> CRunner:
    """Return an observer in C; ValueError if it does not say which sensor is faulty."""
    fault_observers.get(observer)  # a ValueError names those that there are
    law = fault_observer_from({"vehicle": load_scenario(SCENARIO).vehicle, "observer": observer})
    inputs = rows_of(record_flight(0, 0.0, np.zeros(3))[0], 0)
    runner = CRunner(law, build_library(recipe_of(law, inputs)))
    if runner.first(inputs)[1].sensors is None:
        raise ValueError(f"observer '{observer}': expected one that says which sensor is faulty")
    return runner


def judge_flight(seed: int, observers: Sequence[str]) -> list[Judged]:
    """Judge all kinds of fault of a flight by all observers."""
    start, faults = draw_faults(seed)
    inertia = load_vehicle(load_scenario(SCENARIO).vehicle).inertia
    healthy, dt = record_flight(seed, start, np.zeros(3))
    onset = math.ceil(start / dt)
    rest, dts = rows_of(healthy, slice(onset, None)), np.full(len(healthy.torque), dt)
    given = dict[str, FaultObserverInputs]()
    for name, fault in faults.items():
        given[name] = rest._replace(imu=with_fault(rest.imu, fault, dt))
        if fault.kind.sensor == PUSH:
            torque = fault.size * inertia * (np.arange(3) == fault.axis)
            given[name] = rows_of(record_flight(seed, start, torque)[0], slice(onset, None))
    judged = list[Judged]()
    for observer in observers:
        runner = runner_of(observer)
        state, _ = runner.first(rows_of(healthy, 0))
        state, before = runner.run(state, rows_of(healthy, slice(1, onset)), dts[1:onset])
        until_onset = runner.tree(state)
        settled = words_of(rows_of(before, slice(round(SETTLED / dt), None)))
        for name, inputs in given.items():
            _, estimate = runner.run(until_onset, inputs, dts[onset:])
            named, ambiguous = words_of(estimate)
            if faults[name].kind.sensor == NOBODY:  # there is no onset
                named, ambiguous = (
                    np.concatenate(pair) for pair in zip(settled, (named, ambiguous), strict=True)
                )
            judged.append(Judged(name, observer, verdict_of(named, ambiguous, faults[name], dt)))
    return judged


def tabulate(judged: Iterable[Judged]) -> str:
    """Write a row for each kind of fault and observer; of a kind, the first row names it."""
    groups: dict[tuple[str, str], list[Verdict]] = {}
    for kind, observer, verdict in judged:
        groups.setdefault((kind, observer), []).append(verdict)
    order, rows, shown = list(KINDS), list[tuple[str, ...]](), ""
    for (kind, observer), verdicts in sorted(groups.items(), key=lambda group: order.index(group[0][0])):
        delays = [each.delay for each in verdicts if each.delay is not None]
        counts = len(delays), sum(each.wrong for each in verdicts), sum(each.unsure for each in verdicts)
        named, *others = (write_per_cent((count / len(verdicts),)) for count in counts)
        times = [float(each) for each in np.quantile(delays, (0.5, 0.95, 1.0))] if delays else [None]
        row = named if KINDS[kind].sensor >= 0 else NOTHING, *others, write_times(tuple(times))
        head = ("", "") if kind == shown else (kind, str(len(verdicts)))
        rows.append((*head, f"`{observer}`", *row))
        shown = kind
    return markdown(HEAD, rows)


def seeds_of(part: str, flights: int) -> range:
    """Return the seeds of a number of flights; ValueError if the set has fewer."""
    seeds = SEEDS[part]
    if not 0 < flights <= len(seeds):
        raise ValueError(f"--flights {flights}: expected 1 to {len(seeds)} of {part}")
    return seeds[:flights]


def make(options: argparse.Namespace) -> Tables:
    """Fly and judge; return the table."""
    seeds, observers = seeds_of(options.part, options.flights), options.observer or ["isolating", "bank"]
    for each in observers:
        runner_of(each)  # compiled once, not by each process
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as workers:
        judge = functools.partial(judge_flight, observers=observers)
        flights = [*workers.map(judge, seeds, chunksize=10)]
    return {"trial": tabulate(each for flight in flights for each in flight)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table into the page, or print it."""
    known = {
        "--flights": {"type": int, "default": 100, "help": "of each kind of fault"},
        "--set": {"choices": SEEDS, "default": "judging", "dest": "part", "help": "of seeds"},
        "--observer": {"action": "append", "help": "one to judge (isolating and bank)"},
    }
    return run_study(PAGE, make, known, arguments)


if __name__ == "__main__":
    sys.exit(main())
