"""The tables on real gyros in docs/diagnosis.md: steps overlaid on flights of a Crazyflie.

    python -m quadftc_tools.study.crazyflie DIR [--docs docs]

DIR holds logs of the uSD card in ``crazyswarm2/`` (torque commands) and ``sysid/`` (motor commands). Without
``--docs`` the tables are printed.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadftc_bags.bag import BagError
from quadftc_cli.commands import BAD_INPUT, GOOD
from quadftc_cli.screen import say
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.rotors import torque_from_commands
from quadftc_model.samples import AXES
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.imu_from_usdlog import CrazyflieFlight, flight_from_usdlog
from quadftc_tools.study import gyro_steps
from quadftc_tools.study.acceleration_model import (
    AccelerationModel,
    Floats,
    Motion,
    explained,
    fit_model,
    predict,
)
from quadftc_tools.study.gyro_steps import SIZES, GyroTest, JumpTest, Mask, ObserverTest, Recorded, Result
from quadftc_tools.study.numbers import write_number, write_times
from quadftc_tools.study.page import NOTHING, markdown, publish_tables

PAGE = "diagnosis.md"
VEHICLE = "crazyflie_2x"
BY_FILE = "of the vehicle's file"
FITTED = {"crazyswarm2": ("log106", "log113", "log119"), "sysid": ("log15",)}  # in their first half
STALE = 10  # rows; the first few of a log are older than their stamps
TURNING = 0.2  # 1; mean motor command of rotors that turn
TAKE_OFF = 1.5  # s; from motors on to flight
CRASH, BEFORE = 0.5, 0.3  # rad/s between two rows; s, how long before it counts as the ground


class Log(NamedTuple):
    """A log as the study takes it."""

    group: str
    name: str
    motion: Motion
    q_xyzw: Floats | None
    flying: Mask

    @property
    def is_fitted(self) -> bool:
        """Whether the first half of the flight went into the model."""
        return self.name in FITTED[self.group]

    @property
    def take_off(self) -> int:
        """First row in flight."""
        return int(np.argmax(self.flying))

    @property
    def has_ground(self) -> bool:
        """Whether the log begins on the ground."""
        return self.take_off > STALE

    def half(self, number: int) -> Motion:
        """Return the first (0) or second (1) half of the flight."""
        rows = np.flatnonzero(self.flying)
        first, middle, last = int(rows[0]), int(rows[len(rows) // 2]), int(rows[-1]) + 1
        return self.motion.part(slice(middle, last) if number else slice(first, middle))


def read_log(path: Path) -> Log:
    """Read a log; torque per inertia by the vehicle's file, with motor commands by its mixer."""
    flight, vehicle = flight_from_usdlog(path), load_vehicle(VEHICLE)
    torque = flight.torque
    if torque is None:
        if flight.motors is None:
            raise BagError(f"{path}: neither torque nor motor commands; the study needs one")
        torque = torque_from_commands(vehicle, flight.motors)
    time = (flight.stamp_ns - flight.stamp_ns[0]) / NANOSECONDS_PER_SECOND
    motion = Motion(time, flight.body_rate, torque / vehicle.inertia)
    return Log(path.parent.name, path.name, motion, flight.q_xyzw, in_flight(flight, time))


def in_flight(flight: CrazyflieFlight, time: Floats) -> Mask:
    """Return the rows in flight: those between take-off and crash, where motors tell; (n,)."""
    flying = np.arange(len(time)) >= STALE
    if flight.motors is None:
        return flying
    turning = np.flatnonzero(flight.motors.mean(axis=1) > TURNING)
    jumps = np.abs(np.diff(flight.body_rate, axis=0)).max(axis=1) > CRASH
    crashes = time[1:][jumps]
    end = min(crashes[0] - BEFORE if len(crashes) else np.inf, time[turning[-1]])
    return flying & (time > time[turning[0]] + TAKE_OFF) & (time < end)


def fit_groups(logs: Sequence[Log]) -> dict[str, AccelerationModel]:
    """Fit a model for each group of logs, to the first half of the flights in `FITTED`."""
    return {
        group: fit_model([log.half(0) for log in logs if log.group == group and log.is_fitted])
        for group in dict.fromkeys(log.group for log in logs)
    }


def recorded(log: Log, model: AccelerationModel | None, attitude: bool = False) -> Recorded:
    """Return a log as samples; without a model the torque acts as it is commanded, at once."""
    motion = log.motion
    drive = motion.torque[:-1] if model is None else predict(model, motion)
    drive = np.vstack([np.zeros(3), drive])
    return Recorded(motion.time, motion.body_rate, log.q_xyzw if attitude else None, drive, log.flying)


def model_table(logs: Sequence[Log], models: Mapping[str, AccelerationModel]) -> str:
    """Lag and gain of each group, and what they explain of each log where it was not fitted."""
    rows: list[list[str]] = []
    for group, model in models.items():
        shares = {log.name: explained(model, log.half(1)) for log in logs if log.group == group}
        names = FITTED[group]
        for k, axis in enumerate(AXES):
            others = [share[k] for name, share in shares.items() if name not in names]
            spread = " to ".join(dict.fromkeys(f"{end:.2f}" for end in (min(others), max(others))))
            rows.append(
                [
                    f"{group}, {axis}",
                    f"{1e3 * model.lag[k]:.0f} ms",
                    f"{model.gain[k]:.2f}",
                    " / ".join(f"{shares[name][k]:.2f}" for name in names if name in shares),
                    spread,
                ]
            )
    heads = ["logs, axis", "lag", "gain", "R², second half of the fitted logs", "R², logs not fitted"]
    return markdown(heads, rows)


def innovation_table(logs: Sequence[Log], models: Mapping[str, AccelerationModel]) -> str:
    """Noise of the gyro in flight: change from row to row less torque and trend, by log and axis."""
    rows: list[list[str]] = []
    for log in logs:
        change = _innovations(recorded(log, models[log.group]))[log.flying]
        sigma = change.std(axis=0)
        tails = np.mean((change / sigma) ** 4, axis=0) - 3.0
        raw = np.diff(log.motion.body_rate, axis=0)[log.flying[1:]]
        rows.append(
            [
                f"{log.group} {log.name}",
                _three(raw.std(axis=0)),
                _three(sigma),
                _three(np.abs(change).max(axis=0)),
                " / ".join(f"{value:.1f}" for value in tails),
            ]
        )
    heads = ["log", "change from row to row, RMS", "innovation, RMS", "largest", "excess kurtosis"]
    return markdown(heads, rows)


def _innovations(flight: Recorded) -> Floats:
    """Innovation of `JumpTest` at each row (n, 3) [rad/s], were it never to find a jump."""
    test = JumpTest(level=np.inf)
    state, found = test.start(flight.sample(0)), [np.zeros(3)]
    for row, dt in enumerate(np.diff(flight.time).tolist(), 1):
        found.append(flight.gyro[row] - state.gyro - (flight.drive[row] + state.trend) * dt)
        state, _ = test.step(state, flight.sample(row), dt)
    return np.array(found)


def _three(values: Floats) -> str:
    return " / ".join(f"{value:.4f}" for value in values)


class Run(NamedTuple):
    """A test with a torque model, on the logs that have what it needs."""

    test: str
    model: str
    results: Mapping[tuple[str, str], Result]  # group, name of the log


class Entry(NamedTuple):
    """A test, and what it gets."""

    test: GyroTest
    models: Sequence[str]  # of the torque, see `run_tests`
    attitude: bool = False  # as logged, of the same gyro
    airborne: bool = False  # begins in flight, so that only logs with a take-off count

    def takes(self, log: Log) -> bool:
        """Whether a log has what it gets."""
        return (log.q_xyzw is not None or not self.attitude) and (log.has_ground or not self.airborne)


def run_tests(
    entries: Mapping[str, Entry], logs: Sequence[Log], fitted: Mapping[str, AccelerationModel]
) -> list[Run]:
    """Run every test with each torque model that it takes, on all cores."""
    rotors = load_vehicle(VEHICLE).rotors
    by_file = AccelerationModel(np.full(3, rotors.time_constant), np.ones(3))
    models = {
        "fitted": fitted,
        BY_FILE: dict.fromkeys(fitted, by_file),
        "no lag": dict.fromkeys(fitted, None),
        "no torque": dict.fromkeys(fitted, by_file._replace(gain=np.zeros(3))),
    }
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        jobs = [
            (name, model, log, pool.submit(judge_log, entry, log, models[model][log.group]))
            for name, entry in entries.items()
            for model in entry.models
            for log in logs
            if entry.takes(log)
        ]
        results: dict[tuple[str, str], dict[tuple[str, str], Result]] = {}
        for name, model, log, job in jobs:
            results.setdefault((name, model), {})[log.group, log.name] = job.result()
    return [Run(*which, of_logs) for which, of_logs in results.items()]


def judge_log(entry: Entry, log: Log, model: AccelerationModel | None) -> Result:
    """Run a test on a log with a torque model, from the ground or from take-off on."""
    rows = slice(log.take_off if entry.airborne else 0, None)
    return gyro_steps.judge(entry.test, recorded(log, model, entry.attitude).part(rows))


def tests() -> dict[str, Entry]:
    """Return the tests to compare, by name."""
    vehicle, kind = load_vehicle(VEHICLE), fault_observers.get("isolating")
    alone, with_attitude = kind(vehicle=vehicle), kind(vehicle=vehicle, attitude_from_gyro=True)
    return {
        "jump": Entry(JumpTest(), ("fitted", BY_FILE, "no lag", "no torque")),
        "isolating": Entry(ObserverTest(alone), (BY_FILE, "no lag")),
        "isolating, from take-off on": Entry(ObserverTest(alone), (BY_FILE, "no lag"), airborne=True),
        "isolating, with the attitude": Entry(ObserverTest(with_attitude), (BY_FILE,), attitude=True),
    }


HEADS = (
    "steps",
    *(f"{size:g} rad/s: within 12 ms / 100 ms, isolated" for size in SIZES),
    "delay, median / largest",
    "false alarms in flight",
    "elsewhere",
)


def sum_table(runs: Sequence[Run]) -> str:
    """Sum up each run, group by group."""
    rows: list[list[str]] = []
    for run in runs:
        for group in dict.fromkeys(group for group, _ in run.results):
            results = [result for (of, _), result in run.results.items() if of == group]
            rows.append([run.test, run.model, group, *_step_cells(results)])
    return markdown(["test", "torque model", "logs", *HEADS], rows)


def log_table(runs: Sequence[Run], model: str) -> str:
    """Every log by itself, with one torque model."""
    rows: list[list[str]] = []
    for run in runs:
        if run.model == model:
            for (group, name), result in run.results.items():
                rows.append([run.test, f"{group} {name}", *_step_cells([result])])
    return markdown(["test", "log", *HEADS], rows)


def _step_cells(results: Sequence[Result]) -> list[str]:
    cells = [str(gyro_steps.rates(results, SIZES[0]).steps)]
    for size in SIZES:
        found = gyro_steps.rates(results, size)
        cells.append(" / ".join(f"{100.0 * share:.1f}" for share in (*found.found, found.isolated)) + " %")
    delays = gyro_steps.delays(results)
    alarms = sum(int(result.alarms.sum()) for result in results)
    elsewhere = sum(int(result.alarms_elsewhere.sum()) for result in results)
    hours = sum(result.hours for result in results)
    per_hour = f"{alarms} in {3600.0 * hours:.0f} s ({write_number(alarms / hours)} per hour)"
    delay = float(np.median(delays)), float(delays.max())
    return [*cells, write_times(delay) if np.isfinite(delay[0]) else NOTHING, per_hour, str(elsewhere)]


def make(directory: Path) -> dict[str, str]:
    """Read the logs, run all tests, return the tables."""
    paths = [path for group in FITTED for path in sorted((directory / group).glob("log*"))]
    if not paths:
        raise ValueError(f"{directory}: no logs in {' or '.join(FITTED)}")
    logs = [read_log(path) for path in paths]
    models = fit_groups(logs)
    runs = run_tests(tests(), logs, models)
    return {
        "real-gyros-model": model_table(logs, models),
        "real-gyros-innovations": innovation_table(logs, models),
        "real-gyros": sum_table(runs),
        "real-gyros-each": log_table(runs, BY_FILE),
    }


def main() -> int:
    """Write the tables into the page, or print them."""
    parser = argparse.ArgumentParser(prog="crazyflie", description=f"Tables on real gyros of docs/{PAGE}.")
    parser.add_argument("directory", type=Path, help="directory of the logs")
    parser.add_argument("--docs", type=Path, help=f"directory of {PAGE}")
    options = parser.parse_args()
    try:
        publish_tables(make(options.directory), options.docs and options.docs / PAGE)
    except (ValueError, OSError) as error:
        say(f"error: {error}", stderr=True)
        return BAD_INPUT
    return GOOD


if __name__ == "__main__":
    raise SystemExit(main())
