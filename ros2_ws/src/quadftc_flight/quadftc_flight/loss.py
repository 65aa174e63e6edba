"""How a flight was lost: when, and what went before it, from the truth and from what the diagnosis said."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.flight import Flight
from quadftc_flight.metrics import lost_rows
from quadftc_model.samples import AXES, FAULTY

GRACE = 1.0  # s; after the end of a fault it may still be named
SHORT_OF_TORQUE = 0.5  # share of the last second in which an axis was cut
LAST = 1.0  # s before the loss


class _Element(NamedTuple):
    name: str
    faulty: NDArray[np.bool_]  # (n,) it really is
    named: NDArray[np.bool_]  # (n,) the diagnosis says so


def lost_at(flight: Flight) -> float | None:
    """Return the scenario time [s] at which a flight is lost, None if it is not."""
    rows = np.flatnonzero(lost_rows(flight))
    return float(flight.time[rows[0]]) if len(rows) else None


def loss_story(flight: Flight) -> str:
    """Return when a flight was lost and what led there, as one line; empty if it was not."""
    end = lost_at(flight)
    if end is None:
        return ""
    told = "; ".join([*_verdicts(flight, end), *_authority(flight, end)])
    return f"lost at {end:.2f} s: {told or 'no wrong verdict, and no lack of torque, before it'}"


def command_up_to_loss(flight: Flight, run: Path, scheme: str) -> str:
    """Return the command that flies only so much of a lost ``run`` that the loss is seen, as it was flown."""
    end = lost_at(flight)
    assert end is not None
    what = "quadftc", "run", str(run / "scenario.yaml"), "--scheme", scheme
    return shlex.join([*what, "--until", f"{math.ceil(end) + 1}s", "--out", str(run.parent / "up_to_loss")])


def _verdicts(flight: Flight, end: float) -> Iterator[str]:
    """Say which healthy part was named first, and which faults were not named at the loss."""
    before = flight.time <= end
    named = (
        (each.name, before & each.named & ~_lately(flight.time, each.faulty)) for each in _elements(flight)
    )
    wrong = [(float(flight.time[rows][0]), name) for name, rows in named if rows.any()]
    if wrong:
        begin, name = min(wrong)
        yield f"{name}, healthy, was named from {begin:.2f} s"
    last = int(np.flatnonzero(before)[-1])
    for element in _elements(flight):
        if element.faulty[last] and not element.named[last]:
            begin = int(np.flatnonzero(~element.faulty[: last + 1])[-1]) + 1 if not element.faulty[0] else 0
            yield f"{element.name}, faulty from {flight.time[begin]:.2f} s, was not named"


def _authority(flight: Flight, end: float) -> Iterator[str]:
    rows = (flight.time <= end) & (flight.time > end - LAST)
    for axis, share in zip(AXES, np.mean(flight.saturated[rows], axis=0), strict=True):
        if share > SHORT_OF_TORQUE:
            yield f"the {axis} torque was cut in {share:.0%} of the last second"


def _elements(flight: Flight) -> Iterator[_Element]:
    for sensor, fault in (
        ("attitude", flight.fault),
        ("gyro", flight.gyro_fault),
        ("accelerometer", flight.accelerometer_fault),
    ):
        state = getattr(flight, f"{sensor}_state")
        for k, axis in enumerate(AXES if sensor == "attitude" else "xyz"):
            yield _Element(f"{sensor} {axis}", np.nan_to_num(fault[:, k]) != 0.0, state[:, k] == FAULTY)
    for k in range(flight.rotor_state.shape[1]):
        weak = flight.rotor_effectiveness[:, k] < 1.0
        yield _Element(f"rotor {k + 1}", weak, flight.rotor_state[:, k] == FAULTY)


def _lately(time: NDArray[np.float64], faulty: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (n,) whether a part is faulty, or was within the grace."""
    last = np.maximum.accumulate(np.where(faulty, time, -np.inf))
    return time - last <= GRACE
