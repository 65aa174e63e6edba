# pyright: basic
"""A bad network for tests: between publishers and readers, losing or holding back messages at random.

    python -m quadftc_tools.soak.relay drop 5.0 9.0 imu/data torque/command

The publisher of each topic is remapped to the name that `sent` gives; the relay publishes the topic. It loses
or holds back messages between two times, in seconds after the first message.
"""

from __future__ import annotations

import heapq
import random
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.node import Node

from quadftc_bags.interfaces import load_message_class
from quadftc_ros.executor import run_node
from quadftc_ros.qos import topic_profile
from quadftc_ros.topics import TOPICS

DROP, DELAY = "drop", "delay"
SHARE = 0.05  # of the messages
HELD_BACK = 0.02  # s; two and a half samples at 125 Hz: others overtake
LOOK = 0.002  # s; how often it is looked for messages whose time has come


def sent(topic: str) -> str:
    """Name under which a topic comes to the relay."""
    return f"{topic}/sent"


class Relay(Node):
    """Passes most messages on; ``kind`` is `DROP` or `DELAY`, times are seconds after the first."""

    def __init__(self, kind: str, begin: float, end: float, topics: Sequence[str]) -> None:
        super().__init__("relay")
        self._kind, self._begin, self._end = kind, begin, end
        self._random = random.Random(1)
        self._first: float | None = None
        self._held: list[tuple[float, int, Callable[[bytes], None], bytes]] = []
        self._count = 0
        for topic in topics:
            row = TOPICS[topic]
            kind_of, profile = load_message_class(row.type_name), topic_profile(row.qos, "realtime")
            publisher = self.create_publisher(kind_of, topic, profile)
            pass_on = partial(self._on_message, publisher.publish)
            self.create_subscription(kind_of, sent(topic), pass_on, profile, raw=True)
        self.create_timer(LOOK, self._release)

    def _on_message(self, publish: Callable[[Any], None], data: bytes) -> None:
        now = time.monotonic()
        if self._first is None:
            self._first = now
        acts = self._begin <= now - self._first < self._end and self._random.random() < SHARE
        if not acts:
            publish(data)
        elif self._kind == DELAY:
            self._count += 1
            heapq.heappush(self._held, (now + HELD_BACK, self._count, publish, data))

    def _release(self) -> None:
        while self._held and self._held[0][0] <= time.monotonic():
            _, _, publish, data = heapq.heappop(self._held)
            publish(data)


def main() -> None:
    """Run the node."""
    kind, begin, end, *topics = sys.argv[1:]
    sys.argv = sys.argv[:1]
    sys.exit(run_node(lambda: Relay(kind, float(begin), float(end), topics)))


if __name__ == "__main__":
    main()
