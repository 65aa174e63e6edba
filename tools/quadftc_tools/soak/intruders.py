# pyright: basic
"""`scripts/soak intruders`: a stranger publishes what a node would, in flight.

The stranger is a process of its own, ``python -m quadftc_tools.soak.intruders ATTACK BEGIN SECONDS``. It
publishes beside a node, or in place of an operator, what that would never say.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3Stamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu

from quadftc_bags.bag import Bag, read_bag
from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.runs import GRAPHS
from quadftc_flight.scenario import node_parameters
from quadftc_ros.conversions import NANOSECONDS, time_message
from quadftc_ros.diagnostics import ERROR, WARN
from quadftc_ros.topics import TOPICS
from quadftc_tools.soak.flights import attitude_error, best_scheduling, choose, soak_scenario, statuses

NAME = "intruder"
START, AFTER = 6.0, 3.0  # s; before the attack, which waits for its process, and behind it
LARGEST, SOON = 5.0, 0.2  # deg, s; attitude error, and when the attack has to be named
HOUR, EVER = 3600.0, math.inf  # s; EVER: the last stamp that there is
DEPTH = 100  # messages
SETTLING = 0.2  # s, after which no first message is lost
CONNECTED = 10.0  # s, within which somebody has to read


def _imu(
    frame: str, now_ns: int, roll: float = 0.5, ahead: float = 0.0, wrong: float | None = None, of: str = ""
) -> Imu:
    """Return a sample that is rolled [rad], with a stamp ahead of time [s]."""
    message = Imu()
    message.header.stamp, message.header.frame_id = _time(now_ns, ahead), of or frame
    message.orientation.x, message.orientation.w = math.sin(roll / 2), math.cos(roll / 2)
    message.linear_acceleration.z = 9.81
    if wrong is not None:
        message.orientation.x = message.angular_velocity.x = message.linear_acceleration.z = wrong
    return message


def _vector(frame: str, now_ns: int, x: float = 0.0, ahead: float = 0.0) -> Vector3Stamped:
    message = Vector3Stamped()
    message.header.stamp, message.header.frame_id, message.vector.x = _time(now_ns, ahead), frame, x
    return message


def _time(now_ns: int, ahead: float) -> Time:
    if ahead == EVER:
        return Time(sec=2**31 - 1, nanosec=2**32 - 1)
    return time_message(now_ns + round(ahead * NANOSECONDS))


@dataclasses.dataclass(frozen=True)
class Attack:
    """What is published: on a topic, at a rate [Hz]."""

    topic: str
    rate: float
    make: Callable[[str, int], Any]  # of the frame of the topic and the present [ns]


def _on(topic: str, rate: float, **values: object) -> Attack:
    return Attack(topic, rate, partial(_imu if topic in (RAW, CORRECTED) else _vector, **values))


RAW, CORRECTED, TORQUE, SETPOINT = "imu/data", "imu/corrected", "torque/command", "attitude/setpoint"
DISTURBANCE = "disturbance/estimate"
ATTACKS = {
    "imu NaN": _on(RAW, 250.0, wrong=math.nan),
    "imu 1e300": _on(RAW, 250.0, wrong=1e300),
    "imu roll 0.5 rad, same rate": _on(RAW, 250.0),
    "imu future 1 h, once": _on(RAW, 0.05, ahead=HOUR),
    "imu future 1000 s": _on(RAW, 250.0, ahead=1000.0),
    "imu past 1 h": _on(RAW, 250.0, ahead=-HOUR),
    "imu year 2038": _on(RAW, 1.0, ahead=EVER),
    "imu frame mars": _on(RAW, 250.0, of="mars"),
    "imu flood": _on(RAW, 10_000.0),
    "corrected roll 0.5 rad": _on(CORRECTED, 250.0),
    "corrected NaN": _on(CORRECTED, 250.0, wrong=math.nan),
    "corrected future 1000 s": _on(CORRECTED, 250.0, ahead=1000.0),
    "torque 1e3 N m": _on(TORQUE, 250.0, x=1e3),
    "torque 0.5 N m": _on(TORQUE, 250.0, x=0.5),
    "torque NaN": _on(TORQUE, 250.0, x=math.nan),
    "torque future 1000 s": _on(TORQUE, 250.0, x=0.3, ahead=1000.0),
    "fault estimate 1 rad": _on("fault/estimate", 250.0, x=1.0),
    "disturbance 1e6 rad/s²": _on(DISTURBANCE, 250.0, x=1e6),
    "disturbance 50 rad/s²": _on(DISTURBANCE, 250.0, x=50.0),
    "setpoint 1e9 rad": _on(SETPOINT, 50.0, x=1e9),
    "setpoint NaN": _on(SETPOINT, 50.0, x=math.nan),
}


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
    for name in choose(ATTACKS, only):
        with tempfile.TemporaryDirectory(prefix="quadftc_soak_") as folder:
            bag = Path(folder, "bag")
            yield judge(name, _fly(name, graph, duration, seed, bag), read_bag(bag))


def _fly(name: str, graph: str, duration: float, seed: int, bag: Path) -> dict[str, int]:
    """Fly level, with live setpoints where the attack gives some; return what the intruder said."""
    scenario = soak_scenario([], [], START + duration + AFTER, seed)
    parameters = {node: dict(values) for node, values in node_parameters(scenario).items()}
    if ATTACKS[name].topic.endswith("setpoint"):
        parameters["reference"]["source"] = "topic"
    plan = GraphPlan(parameters, "realtime", bag=bag, scheduling=best_scheduling())
    intruder: subprocess.Popen[bytes] | None = None

    def progress(samples: int) -> bool:
        nonlocal intruder
        if samples and intruder is None:
            when = f"{time.monotonic() + START}", f"{duration}"
            intruder = subprocess.Popen((sys.executable, "-m", __name__, name, *when), stdout=subprocess.PIPE)
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
    log_ns, errors = attitude_error(bag)
    largest = float(np.max(errors[log_ns >= begin_ns], initial=0.0))
    times = [log_time_ns for log_time_ns, status in statuses(bag) if _names(status, topic)]
    named = (min(times) - begin_ns) / NANOSECONDS if times else np.inf
    told_counts = (status.values for _, status in statuses(bag) if status.name.endswith(": samples"))
    counts = [int(pair.value) for values in told_counts for pair in values if topic in pair.key]
    wrong = [f"attitude off by {largest:.1f} deg"] * (not largest <= LARGEST)
    wrong += [f"named after {named:.2f} s"] * (named > SOON)
    return Trial(name, told["sent"], largest, named, max(counts, default=0), "; ".join(wrong))


def _names(status: Any, topic: str) -> bool:
    """Whether a status names the intruder; of a setpoint, which has no other publisher, what is refused."""
    if TOPICS[topic].publishers:
        said = status.message
        return status.level == ERROR and f"{topic}: " in said and f"/{NAME} publishes" in said
    refused = status.level == WARN and status.name.endswith(": samples")
    return refused and any(topic in pair.key for pair in status.values)


def attack(name: str, begin: float, duration: float) -> dict[str, int]:
    """Wait until a monotonic time [s], then publish for some seconds.

    Return when the publisher was connected [ns], and how many messages it sent.
    """
    this = ATTACKS[name]
    row, node = TOPICS[this.topic], Node(NAME)
    time.sleep(max(0.0, begin - time.monotonic()))
    kind = type(this.make(row.frame, 0))
    publisher = node.create_publisher(kind, this.topic, QoSProfile(depth=DEPTH))
    end = time.monotonic() + CONNECTED * bool(row.readers)
    while publisher.get_subscription_count() == 0 and time.monotonic() < end:
        time.sleep(0.001)
    began_ns = time.time_ns()
    time.sleep(SETTLING)
    if not row.publishers:  # it is the first, and what it says has to be noticed
        began_ns = time.time_ns()
    begin, sent = time.monotonic(), 0
    while (passed := time.monotonic() - begin) < duration:
        if sent <= passed * this.rate:
            publisher.publish(this.make(row.frame, time.time_ns()))
            sent += 1
        else:
            time.sleep(min(0.1, sent / this.rate - passed))
    node.destroy_node()
    return {"begin_ns": began_ns, "sent": sent}


if __name__ == "__main__":
    chosen, *seconds = sys.argv[1:]
    rclpy.init(args=[])
    sys.stdout.write(json.dumps(attack(chosen, *map(float, seconds))))
    sys.stdout.flush()
    os._exit(0)  # the node is gone from the graph
