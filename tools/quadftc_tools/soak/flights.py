# pyright: basic
"""What the parts of `scripts/soak` share: scenarios, priority, and what a bag tells of a flight."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from quadftc_bags.bag import Bag
from quadftc_flight.scenario import Scenario, parse_scenario
from quadftc_model.rotations import wrap
from quadftc_ros.scheduling import ORDINARY, Scheduling, SchedulingError, scheduled

PRIORITY = 20  # of SCHED_RR
RATE = 250.0  # Hz
CONSTANT_DISTURBANCE = "kind: constant, amplitude: [0.05 N m, 0.04 N m, 0.015 N m]"
STEP = "{kind: step, angles: [3 deg, -2 deg, 5 deg], start: 1 s, stop: 3 s, rise: 1 s}"
BASE = """
name: soak
description: Faults of the software, on top of those of sensors and the world
vehicle: qball_x4
sensors: {{grade: mems}}
schemes:
  supervised: {{observer: supervised, disturbance_observer: exosystem, controller: ismc}}
references: [{reference}]
rate: {rate:g} Hz
duration: {duration:g} s
seed: {seed}
faults: [{faults}]
disturbances: [{disturbances}]
"""


def soak_scenario(
    faults: Sequence[str],
    disturbances: Sequence[str],
    duration: float,
    seed: int,
    rate: float = RATE,
    reference: str = STEP,
) -> Scenario:
    """Flight of some length [s] with faults of the attitude and constant disturbances; text is YAML."""
    text = BASE.format(
        reference=reference,
        rate=rate,
        duration=duration,
        seed=seed,
        faults=", ".join(f"{{channel: attitude, {each}}}" for each in faults),
        disturbances=", ".join(f"{{{CONSTANT_DISTURBANCE}, {each}}}" for each in disturbances),
    )
    return parse_scenario(text)


def choose(names: Iterable[str], only: str) -> list[str]:
    """Return the names that have ``only`` in them; ValueError if none has."""
    if not (chosen := [name for name in names if only in name]):
        raise ValueError(f"--only: nothing has '{only}' in it")
    return chosen


def best_scheduling() -> Scheduling:
    """Real-time priority if the machine allows it: what else it does shall not count as a fault."""
    wanted = Scheduling(priority=PRIORITY)
    try:
        with scheduled(wanted):
            return wanted
    except SchedulingError:
        return ORDINARY


def attitude_error(bag: Bag) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Log times (n,) [ns] of the true attitude, and its largest distance from the reference (n,) [deg]."""
    truth, wanted = bag.series("plant/attitude"), bag.series("attitude/reference")
    row = np.searchsorted(wanted.stamp_ns, truth.stamp_ns, side="right") - 1
    errors = np.abs(wrap(truth["vector"] - wanted["angles"][np.maximum(row, 0)]))
    return truth.log_time_ns, np.degrees(errors.max(axis=-1))


def statuses(bag: Bag) -> Iterator[tuple[int, Any]]:
    """Yield log time [ns] and status of all that /diagnostics said."""
    for _, log_time_ns, data in bag.messages(["/diagnostics"]):
        found: Any = deserialize_message(data, DiagnosticArray).status
        yield from ((log_time_ns, status) for status in found)
