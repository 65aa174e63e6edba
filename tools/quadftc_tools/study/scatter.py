"""How alike the axes of healthy gyros get noisy: of `trust.Scatter.alone`, what `trust.ALONE` is measured by.

    python -m quadftc_tools.study.scatter DATA

DATA holds recordings as for ``study.league``; those below 50 Hz, where vibration is aliased, are left out.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.bank import noise, trust
from quadftc_fdi.fault_observers.bank import BankObserver
from quadftc_replay.flight_log import Signal
from quadftc_tools.study.league import SLOW, read_healthy
from quadftc_tools.study.page import Tables, markdown, run_study

SETTLES = 2.0  # s; from the begin of a recording, until its noise is known
HEADINGS = ("who", "recordings", "time [s]", "rms of the least even", "largest")
LEVEL, NONE, THERE = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.ones(3, bool)
NOBODY = np.array(False)  # no torque is known


def alone_of(gyro: Signal) -> NDArray[np.float64]:
    """Return `Scatter.alone` of each reading and axis (n, 3), once the noise is known."""
    few = 1.0 - BankObserver.level
    whole = np.isfinite(gyro.value).all(axis=1)
    gyro = Signal(gyro.time[whole], gyro.value[whole])
    learning, scatter = noise.start_learning(LEVEL, gyro.value[0]), trust.no_scatter(NONE)
    found = list[NDArray[np.float64]]()
    for last, read, dt in zip(gyro.value, gyro.value[1:], np.diff(gyro.time), strict=False):
        learning = noise.learn(learning, read, last, NONE, LEVEL, LEVEL, THERE, THERE, THERE, dt)
        scatter = trust.watch_scatter(scatter, noise.louder(learning), NOBODY, few, dt)
        found.append(scatter.alone)
    return np.array(found).reshape(-1, 3)[gyro.time[1:] > gyro.time[0] + SETTLES]


def make(options: argparse.Namespace) -> Tables:
    """Watch the first gyro of each recording."""
    rows = list[tuple[str, ...]]()
    for who, logs in read_healthy(options.data).items():
        gyros = [gyro for log in logs for gyro in list(log.gyros.values())[:1] if gyro.rate >= SLOW]
        alone = [each for each in map(alone_of, gyros) if len(each)]
        if alone:
            seconds = sum(gyro.time[-1] - gyro.time[0] for gyro in gyros)
            rms = max(float(np.sqrt(np.mean(each**2))) for each in alone)
            largest = max(float(each.max()) for each in alone)
            rows.append((who, str(len(alone)), f"{seconds:.0f}", f"{rms:.2f}", f"{largest:.2f}"))
    return {"scatter": markdown(HEADINGS, rows)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    return run_study("bank.md", make, {"data": {"type": Path, "help": "directory of recordings"}}, arguments)


if __name__ == "__main__":
    sys.exit(main())
