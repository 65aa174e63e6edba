"""Recordings for the league: which flights are healthy, and parts of them."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.diagnosis import read_with_layout

RECORDINGS = ("ardupilot/*/*.BIN", "broad/*", "crazyflie/*/*", "px4/**/*.ulg")
SIMULATED = "ardupilot/sitl"  # a file says which are healthy
# in the names of logs that are not healthy; the controller of DeLorean's 00000004 flies by a position that
# leaves the estimator's by 2.000 m on each axis from 9.1 s on
FAULTY = ("cut", "tape", "motor_failure", "brownout", "00000004")
ATTACK = "Attack Started"  # DeLorean's words; its flights are healthy until then
SLOW = 50.0  # Hz; of the gyro: default rates of autopilots are below


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
