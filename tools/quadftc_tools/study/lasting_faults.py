"""Offsets of gyro and accelerometer that begin anywhere in a real log and last to its end.

    python -m quadftc_tools.study.lasting_faults DATA [--faults 2] [--seed 1]

On every log below DATA in which `quadftc diagnose` finds nothing, each channel gets ``--faults`` offsets on
random axes, from 10 to 90 % of the log. The first finding counts: channel, axis, onset within 0.1 s (0.5 s
below `FAST`), size within two sigma or a tenth. What is wrong is listed.
"""

from __future__ import annotations

import argparse
import zlib
from collections import Counter
from pathlib import Path

import numpy as np

from quadftc_bags.bag import BagError
from quadftc_cli.screen import say
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.overlay import overlay_faults
from quadftc_replay.inspection.verdict import Verdict
from quadftc_replay.overlay import faults_from
from quadftc_replay.readers.bounded import read_bounded
from quadftc_tools.study.golden_logs import find_logs

SIZES = {"gyro": (0.1, 0.2, 0.3, 0.5), "accelerometer": (1.5, 2.0, 3.0, 4.0)}  # rad/s, m/s²
ROLL, UNITS = {"x": "roll", "y": "pitch", "z": "yaw"}, {"gyro": "rad/s", "accelerometer": "m/s^2"}
FAST = 60.0  # Hz
CHECKS = ("component", "axis", "onset", "size", "all")


def judge(log: FlightLog, channel: str, axis: str, size: float, start: float) -> tuple[list[bool], Verdict]:
    """Put an offset on a log; whether component, axis, onset and size are right, and all of them."""
    spec = f"bias channel={channel} axis={ROLL[axis]} value={size:g}{UNITS[channel]} start={start:.3f}s"
    verdict = inspect(overlay_faults(log, faults_from((), (spec,)))).verdict
    first = verdict.findings[0] if verdict.findings else None
    if first is None:
        return [False] * len(CHECKS), verdict
    sensors = {"gyro": log.gyros, "accelerometer": log.accelerometers}[channel].values()
    late = 0.1 if max((each.rate for each in sensors), default=0.0) > FAST else 0.5
    near = max(2.0 * (first.sigma or 0.0), 0.1 * abs(size))
    right = [
        first.component == channel,
        first.element == axis,
        abs(first.onset_s - start) <= late,
        first.size is not None and abs(first.size - size) <= near,
    ]
    return [*right, all(right)], verdict


def main() -> None:
    """Print which share is right, and what is not."""
    parser = argparse.ArgumentParser(description="Judge lasting offsets on recorded logs.")
    parser.add_argument("data", type=Path, help="folder of the logs")
    parser.add_argument("--faults", type=int, default=2, help="of each channel and log")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    tally, flown = Counter[tuple[str, str]](), Counter[str]()
    for path in find_logs(options.data):
        try:
            log = read_bounded(path)
        except BagError:
            continue
        if log.end < 5.0 or inspect(log).verdict.findings:
            continue
        name = path.relative_to(options.data).as_posix()
        rng = np.random.default_rng([options.seed, zlib.crc32(name.encode())])
        for channel, sizes in SIZES.items():
            if not (log.gyros if channel == "gyro" else log.accelerometers):
                continue
            for _ in range(options.faults):
                axis, size = "xyz"[rng.integers(3)], float(rng.choice(sizes) * rng.choice((-1.0, 1.0)))
                start = float(rng.uniform(0.1, 0.9) * log.end)
                checks, verdict = judge(log, channel, axis, size, start)
                flown[channel] += 1
                tally.update(
                    {(channel, check): int(is_so) for check, is_so in zip(CHECKS, checks, strict=True)}
                )
                if not checks[-1]:
                    say(f"{name}: {channel} {axis} {size:+g} from {start:.2f} s: {verdict.sentence[:150]}")
    for channel, count in flown.items():
        say(f"{channel}, {count}: " + ", ".join(f"{check} {tally[channel, check]}" for check in CHECKS))


if __name__ == "__main__":
    main()
