# pyright: basic
"""A stranger in the graph: publishes beside a node, or in place of an operator, what that would never say.

    python -m quadftc_tools.soak.intruder "imu NaN" 5.0 10.0

It waits, then publishes for a time [s]. It prints one JSON object: when its publisher was connected, when it
ended [ns], and how many messages it sent.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3Stamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu

from quadftc_ros.conversions import NANOSECONDS
from quadftc_ros.topics import TOPICS

NAME = "intruder"
HOUR = 3600.0  # s
DEPTH = 100  # messages
SETTLING = 0.2  # s, after which no first message is lost
CONNECTED = 10.0  # s, within which somebody has to read


@dataclass(frozen=True)
class Attack:
    """What is published: on a topic, at a rate [Hz]."""

    topic: str
    rate: float
    make: Callable[[str, int], Any]  # of the frame of the topic and the present [ns]


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


def _last(frame: str, now_ns: int) -> Imu:
    message = _imu(frame, now_ns)
    message.header.stamp = Time(sec=2**31 - 1, nanosec=2**32 - 1)
    return message


def _vector(frame: str, now_ns: int, x: float = 0.0, ahead: float = 0.0) -> Vector3Stamped:
    message = Vector3Stamped()
    message.header.stamp, message.header.frame_id, message.vector.x = _time(now_ns, ahead), frame, x
    return message


def _time(now_ns: int, ahead: float) -> Time:
    sec, nanosec = divmod(now_ns + round(ahead * NANOSECONDS), NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def _on(topic: str, rate: float, make: Callable[..., Any], **values: Any) -> Attack:
    return Attack(topic, rate, partial(make, **values))


RAW, CORRECTED, TORQUE, SETPOINT = "imu/data", "imu/corrected", "torque/command", "attitude/setpoint"
DISTURBANCE = "disturbance/estimate"
ATTACKS = {
    "imu NaN": _on(RAW, 250.0, _imu, wrong=math.nan),
    "imu 1e300": _on(RAW, 250.0, _imu, wrong=1e300),
    "imu roll 0.5 rad, same rate": _on(RAW, 250.0, _imu),
    "imu future 1 h, once": _on(RAW, 0.05, _imu, ahead=HOUR),
    "imu future 1000 s": _on(RAW, 250.0, _imu, ahead=1000.0),
    "imu past 1 h": _on(RAW, 250.0, _imu, ahead=-HOUR),
    "imu year 2038": _on(RAW, 1.0, _last),
    "imu frame mars": _on(RAW, 250.0, _imu, of="mars"),
    "imu flood": _on(RAW, 10_000.0, _imu),
    "corrected roll 0.5 rad": _on(CORRECTED, 250.0, _imu),
    "corrected NaN": _on(CORRECTED, 250.0, _imu, wrong=math.nan),
    "corrected future 1000 s": _on(CORRECTED, 250.0, _imu, ahead=1000.0),
    "torque 1e3 N m": _on(TORQUE, 250.0, _vector, x=1e3),
    "torque 0.5 N m": _on(TORQUE, 250.0, _vector, x=0.5),
    "torque NaN": _on(TORQUE, 250.0, _vector, x=math.nan),
    "torque future 1000 s": _on(TORQUE, 250.0, _vector, x=0.3, ahead=1000.0),
    "fault estimate 1 rad": _on("fault/estimate", 250.0, _vector, x=1.0),
    "disturbance 1e6 rad/s²": _on(DISTURBANCE, 250.0, _vector, x=1e6),
    "disturbance 50 rad/s²": _on(DISTURBANCE, 250.0, _vector, x=50.0),
    "setpoint 1e9 rad": _on(SETPOINT, 50.0, _vector, x=1e9),
    "setpoint NaN": _on(SETPOINT, 50.0, _vector, x=math.nan),
}


def attack(name: str, wait: float, duration: float) -> dict[str, int]:
    """Wait, then publish for a time [s]; return ``begin_ns``, ``end_ns`` and ``sent``."""
    this, begin = ATTACKS[name], time.monotonic() + wait
    row = TOPICS[this.topic]
    node = Node(NAME)
    time.sleep(max(0.0, begin - time.monotonic()))
    kind = Imu if this.topic in (RAW, CORRECTED) else Vector3Stamped
    publisher = node.create_publisher(kind, this.topic, QoSProfile(depth=DEPTH))
    began_ns, begin, sent = time.time_ns(), time.monotonic(), 0
    while publisher.get_subscription_count() == 0 and time.monotonic() - begin < CONNECTED * bool(
        row.readers
    ):
        time.sleep(0.001)
    began_ns = time.time_ns() if row.readers else began_ns
    time.sleep(SETTLING)
    if not row.publishers:  # it is the first, and what it says has to be noticed
        began_ns = time.time_ns()
    begin = time.monotonic()
    while (passed := time.monotonic() - begin) < duration:
        if sent <= passed * this.rate:
            publisher.publish(this.make(row.frame, time.time_ns()))
            sent += 1
        else:
            time.sleep(min(0.1, sent / this.rate - passed))
    found = {"begin_ns": began_ns, "end_ns": time.time_ns(), "sent": sent}
    node.destroy_node()
    return found


if __name__ == "__main__":
    chosen, *seconds = sys.argv[1:]
    rclpy.init(args=[])
    sys.stdout.write(json.dumps(attack(chosen, *map(float, seconds))))
    sys.stdout.flush()
    os._exit(0)  # the node is gone from the graph
