# pyright: basic
"""`scripts/soak intruders`: a stranger publishes what a node would, in flight."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from quadftc_bags.bag import Bag, read_bag
from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.runs import GRAPHS
from quadftc_flight.scenario import node_parameters
from quadftc_ros.diagnostics import ERROR, WARN
from quadftc_ros.topics import TOPICS
from quadftc_tools.soak.intruder import ATTACKS, NAME
from quadftc_tools.soak.node_flight import BASE, RATE, best_scheduling, soak_scenario

START, AFTER = 6.0, 3.0  # s; before the attack, which waits for its process, and behind it
LARGEST, SOON = 5.0, 0.2  # deg, s; attitude error, and when the attack has to be named
NANOSECONDS = 1e9


@dataclasses.dataclass(frozen=True)
class Trial:
    """What came of one attack."""

    attack: str
    sent: int  # messages
    largest_deg: float  # attitude error from its begin on
    named_s: float  # from its graph event, or first message, until it stands in /diagnostics; infinite: never
    refused: int  # messages, by the node that refused most
    wrong: str  # empty if all held


def soak(graph: str, duration: float, seed: int, only: str) -> Iterator[Trial]:
    """Fly once with each attack that has ``only`` in its name; ValueError if that leaves none."""
    if not (chosen := [name for name in ATTACKS if only in name]):
        raise ValueError(f"--only: nothing has '{only}' in it")
    for name in chosen:
        with tempfile.TemporaryDirectory(prefix="quadftc_soak_") as folder:
            bag = Path(folder, "bag")
            yield judge(name, _fly(name, graph, duration, seed, bag), read_bag(bag))


def _fly(name: str, graph: str, duration: float, seed: int, bag: Path) -> dict[str, int]:
    """Fly level, with live setpoints where the attack gives some; return what the intruder said."""
    scenario = soak_scenario(BASE, [], [], RATE, START + duration + AFTER, seed)
    parameters = {node: dict(values) for node, values in node_parameters(scenario).items()}
    if ATTACKS[name].topic.endswith("setpoint"):
        parameters["reference"]["source"] = "topic"
    plan = GraphPlan(parameters, "realtime", bag=bag, scheduling=best_scheduling())
    command = [sys.executable, "-m", "quadftc_tools.soak.intruder", name, f"{START}", f"{duration}"]
    intruder: subprocess.Popen[bytes] | None = None

    def progress(samples: int) -> bool:
        nonlocal intruder
        if samples and intruder is None:
            intruder = subprocess.Popen(command, stdout=subprocess.PIPE)
        return True

    try:
        with GRAPHS[graph](plan) as running:
            running.run(progress)
    finally:
        if intruder is not None:
            said, _ = intruder.communicate()
    return json.loads(said)


def judge(name: str, told: dict[str, int], bag: Bag) -> Trial:
    """Judge a flight by its bag."""
    begin_ns, topic = told["begin_ns"], ATTACKS[name].topic
    truth, wanted = bag.series("plant/attitude"), bag.series("attitude/reference")
    row = np.searchsorted(wanted.stamp_ns, truth.stamp_ns, side="right") - 1
    errors = np.degrees(np.abs(truth["vector"] - wanted["angles"][np.maximum(row, 0)])).max(axis=-1)
    largest = float(np.max(errors[truth.log_time_ns >= begin_ns], initial=0.0))
    times = [log_time_ns for log_time_ns, status in _statuses(bag) if _names(status, topic)]
    named = (min(times) - begin_ns) / NANOSECONDS if times else np.inf
    told_counts = (status.values for _, status in _statuses(bag) if status.name.endswith(": samples"))
    counts = [int(pair.value) for values in told_counts for pair in values if topic in pair.key]
    wrong = [f"attitude off by {largest:.1f} deg"] * (not largest <= LARGEST)
    wrong += [f"named after {named:.2f} s"] * (named > SOON)
    return Trial(name, told["sent"], largest, named, max(counts, default=0), "; ".join(wrong))


def _names(status: Any, topic: str) -> bool:
    """Whether a status names the intruder; of a setpoint, which has no other publisher, what is refused."""
    if TOPICS[topic].publishers:
        return (
            status.level == ERROR
            and f"{topic}: " in status.message
            and f"/{NAME} publishes" in status.message
        )
    return (
        status.level == WARN
        and status.name.endswith(": samples")
        and any(topic in pair.key for pair in status.values)
    )


def _statuses(bag: Bag) -> Iterator[tuple[int, Any]]:
    for _, log_time_ns, data in bag.messages(["/diagnostics"]):
        statuses: Any = deserialize_message(data, DiagnosticArray).status
        yield from ((log_time_ns, status) for status in statuses)
