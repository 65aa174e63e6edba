r"""How many false alarms a verdict may have, if somebody asks: conformal prediction by flight.

The score S of a flight is the largest probability of its findings, 0 without one. Of n healthy flights the
scores are S_1 to S_n. Of another flight those findings count whose probability is above the threshold t, the
(k + 1)-th largest of S_1 to S_n.

**A healthy flight like those has a finding that counts with a probability of at most (k + 1) / (n + 1).**
Proof. If S > t, at most k of the n scores reach S. So S is one of the k + 1 largest of all n + 1, where equal
ones count as larger. Flights that are alike are exchangeable: S has each of the n + 1 ranks with the same
probability, and ties can but lower it. Neither the distribution of the scores nor the judge matters.

Flights last T hours on average, so flights with a false finding come (k + 1) / ((n + 1) T) times an hour. A
level below 1 / ((n + 1) T) cannot be kept. Neither can one whose threshold no finding exceeds, as it would
silence the judge. `crepes` and `mapie` calibrate what a regressor or classifier says of samples; the rank of
one number a flight needs neither.

Source: Vovk, Gammerman and Shafer (2005), Algorithmic Learning in a Random World, section 2.2.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import NamedTuple

from quadftc_replay.inspection.found import CERTAIN
from quadftc_replay.inspection.verdict import Level

FLIGHTS = Path(__file__).parent / "flights.json"
ASKED = re.compile(r"(\d+(?:\.\d+)?)/(\d+(?:\.\d+)?)?h")
ROUNDING = 1e-9  # of a rank


class Calibration(NamedTuple):
    """Healthy flights of one autopilot, as the judge saw them."""

    autopilot: str  # how the names of its formats begin
    flights: int
    hours: float  # all together
    scores: tuple[float, ...]  # those above 0, the largest first

    def threshold(self, rank: int) -> float:
        """Score of a rank, from 1, the largest first."""
        return self.scores[rank - 1] if rank <= len(self.scores) else 0.0

    def rate(self, rank: int) -> float:
        """Flights with a false finding an hour, at most, if those above the score of a rank count."""
        return rank / ((self.flights + 1) * self.hours / self.flights)


def load_calibrations() -> tuple[Calibration, ...]:
    """Read the flights that come with this version of the judge."""
    content = json.loads(FLIGHTS.read_text(encoding="utf-8"))
    return tuple(
        Calibration(name, each["flights"], each["hours"], tuple(each["scores"]))
        for name, each in content["autopilots"].items()
    )


def level_for(asked: str, log_format: str) -> Level:
    """Return the level that was asked for, such as "1/10h", of logs of a format.

    ValueError if it cannot be read, if it cannot be kept, or if there are no flights of that format.
    """
    match = ASKED.fullmatch(asked.replace(" ", ""))
    if match is None or not float(match[1]) or not float(match[2] or 1.0):
        raise ValueError(f"--false-alarms {asked!r}: expected so many in so many hours, such as 1/10h")
    wanted = float(match[1]) / float(match[2] or 1.0)
    known = load_calibrations()
    chosen = next((each for each in known if log_format.startswith(each.autopilot)), None)
    if chosen is None:
        names = ", ".join(each.autopilot for each in known)
        raise ValueError(f"--false-alarms: no calibration flights logged as {log_format}; there are: {names}")
    return find_level(chosen, asked, wanted)


def find_level(known: Calibration, asked: str, wanted: float) -> Level:
    """Return the level for a rate [1/h]; ValueError, with the lowest that can be kept, if it is too low."""
    silent = sum(score >= CERTAIN for score in known.scores)
    rank = min(math.floor(wanted / known.rate(1) + ROUNDING), known.flights)
    if rank <= silent:
        lowest = known.rate(silent + 1)
        raise ValueError(
            f"--false-alarms {asked}: {known.flights} healthy {known.autopilot} flights, {known.hours:.1f} h,"
            f" support no less than {lowest:.2g}/h, 1/{math.floor(10.0 / lowest) / 10.0:g}h"
        )
    return Level(
        asked=asked,
        threshold=known.threshold(rank),
        rate_per_h=known.rate(rank),
        flights=known.flights,
        hours=known.hours,
    )
