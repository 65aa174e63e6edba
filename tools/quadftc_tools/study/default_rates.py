"""Losses of rotors in logs at default rates: simulated flights of random vehicles through `quadftc diagnose`.

    python -m quadftc_tools.study.default_rates [--flights 60] [--seed 9000]

Each vehicle of `quadftc_tools.study.random_flights` flies healthy, and with a rotor that stops or gives half
its thrust. Each flight is written as ArduPilot and as PX4 log it by default, read back and judged.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from quadftc_cli.screen import say
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.readers import read_log
from quadftc_replay.writers import WRITERS
from quadftc_tools.study.random_flights import Loss
from quadftc_tools.study.simulated_logs import fly_log

HEALTHY = 25.0  # s; length of a flight without a loss
SHARES = (0.5, 1.0)  # of a rotor's thrust that are lost, in turn


def judge_seed(seed: int, share: float | None) -> Iterator[tuple[str, str, float]]:
    """Fly a seed; yield autopilot, what is said of its log, and how far the onset is off [s]."""
    rng = np.random.default_rng([seed, 1])
    onset, after = rng.uniform(6.0, 18.0), float(rng.choice([1.5, 4.0, 8.0]))
    loss = None if share is None else Loss(rng.random(), share, onset)
    flight, log = fly_log(seed, HEALTHY if loss is None else onset + after, loss)
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        for name, write in WRITERS.items():
            path = Path(folder, name)
            write(log, path)
            verdict = inspect(read_log(path)).verdict
            if not verdict.findings:
                yield name, verdict.outcome, 0.0
                continue
            first = verdict.findings[0]
            is_right = (first.component, first.element) == ("rotor", str(flight.rotor))
            yield name, "named" if is_right else f"wrong: {first.name}", abs(first.onset_s - onset)


def main() -> None:
    """Fly all, and print a table."""
    parser = argparse.ArgumentParser(description="Judge simulated flights logged at default rates.")
    parser.add_argument("--flights", type=int, default=60)
    parser.add_argument("--seed", type=int, default=9000, help="of the first flight")
    options = parser.parse_args()
    said, late = Counter[tuple[str, str, str]](), list[float]()
    for seed in range(options.seed, options.seed + options.flights):
        for share in (None, SHARES[seed % 2]):
            truth = "healthy" if share is None else f"rotor loses {100 * share:.0f} %"
            for autopilot, what, error in judge_seed(seed, share):
                said[autopilot, truth, what] += 1
                late += [error] if what == "named" else []
    say(*(f"{name}, {truth}: {what} {count}" for (name, truth, what), count in sorted(said.items())))
    if late:
        say(f"onset: half within {np.median(late):.2f} s, nine of ten within {np.quantile(late, 0.9):.2f} s")


if __name__ == "__main__":
    main()
