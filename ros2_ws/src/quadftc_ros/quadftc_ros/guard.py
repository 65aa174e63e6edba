# pyright: basic
"""Between middleware and node: every subscription of a node is made here, and messages are judged.

A message passes if it is of the publisher that was first (`quadftc_ros.streams`), and if its stamp goes on as
time does. Others are dropped and counted. Publishers beside the first are reported as an ERROR on
/diagnostics, by name, on the topics that the node reads and those it publishes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from quadftc_bags.cdr.message import leading_stamp_ns
from quadftc_ros.conversions import END_NS
from quadftc_ros.diagnostics import ERROR, OK, Diagnostics
from quadftc_ros.streams import UNKNOWN, Mark, Publishers, Streams
from quadftc_ros.transport import Take

SHARED = ("/diagnostics",)  # topics on which every node publishes
LOOK = 0.1  # s; how often the publishers are counted
JUMP_NS = 2_000_000_000  # ns; by so much stamps may be ahead of time, or behind, from one message to the next
DOUBT_NS = 50_000_000  # ns; after a message that was good, one that is not stays doubtful for so long
NUMBER, SENT = "publication_sequence_number", "source_timestamp"  # of what rclpy says of a message


class Guard:
    """The subscriptions of a node, and who publishes beside it.

    ``publish()`` sends the diagnostics at once.
    """

    def __init__(self, node: Node, diagnostics: Diagnostics, publish: Callable[[], None]) -> None:
        self._node, self._diagnostics, self._publish = node, diagnostics, publish
        self._streams: dict[str, Streams] = {}  # by topic
        self._clocks: list[Clock] = []
        self._counts: dict[str, int] = {}
        self._said: dict[str, str] = {}

    def subscribe(
        self, topic: str, message_class: type, take: Take, profile: QoSProfile, timed: bool = False
    ) -> Subscription:
        """Subscribe to a topic: ``take(serialised)`` gets what passes; ``timed``: its stamps are judged."""
        if topic in SHARED:
            return self._node.create_subscription(message_class, topic, take, profile, raw=True)
        streams, clock, count = Streams(partial(self._publishers, topic)), Clock(), self._diagnostics.count
        self._streams[topic], self._counts[topic] = streams, 0
        if timed:
            self._clocks.append(clock)
        dropped = f"{topic}: of a second publisher, dropped"
        jumped = f"{topic}: stamp jumps by more than {JUMP_NS * 1e-9:g} s, refused"

        def judge(data: Any, info: Any = None) -> None:
            if info is None and isinstance(data, tuple):  # EventsExecutor passes one argument
                data, info = data
            try:
                stamp_ns = leading_stamp_ns(data)
            except ValueError:
                take(data)  # which counts it
                return
            now_ns = time.monotonic_ns()
            numbers = info or {}  # none where a test calls this; None in a middleware that does not count
            number = numbers.get(NUMBER)
            if number is not None and not streams.follows(Mark(number, numbers[SENT], stamp_ns), now_ns):
                count(dropped)
            elif timed and not clock.goes_on(stamp_ns, now_ns):
                count(jumped)
            else:
                take(data)

        reader = self._node.create_subscription(message_class, topic, judge, profile, raw=True)
        # else EventsExecutor passes the message alone
        reader._callback_type = Subscription.CallbackType.WithMessageInfo
        return reader

    def watch(self, topic: str) -> None:
        """Watch a topic that the node publishes: who else does?"""
        own = self._node.get_fully_qualified_name()
        self._streams[topic], self._counts[topic] = Streams(partial(self._publishers, topic), own), 0

    def forget(self) -> None:
        """Take the next stamp for the first of each topic."""
        for clock in self._clocks:
            clock.stamp_ns = -1

    def look(self) -> None:
        """Look at the topics whose publishers have become more, or less; call it every `LOOK` seconds."""
        for topic, count in self._counts.items():
            if count > 1 or self._node.count_publishers(self._node.resolve_topic_name(topic)) != count:
                streams = self._streams[topic]
                streams.see(self._publishers(topic))
                self._counts[topic] = len(streams.publishers)
                self._see(topic)

    def _see(self, topic: str) -> None:
        """Report the publishers of a topic, if they are others than before."""
        streams = self._streams[topic]
        strangers, words = streams.strangers(), ""
        if strangers:
            names = {gid: _name(streams.publishers, gid) for gid in streams.publishers}
            first = next(names[gid] for gid in names if gid not in strangers)
            words = f"{topic}: {', '.join(names[gid] for gid in strangers)} publishes beside {first}"
        if words == self._said.get(topic, ""):
            return
        self._said[topic] = words
        said = [each for each in self._said.values() if each]
        level, message = (ERROR, "; ".join(said)) if said else (OK, "one on each topic")
        self._diagnostics.report("publishers", level, message)
        if words:
            self._node.get_logger().error(words)
        self._publish()

    def _publishers(self, topic: str) -> Publishers:
        """Return who publishes a topic, by the graph."""
        infos = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
        return {
            bytes(info.endpoint_gid).hex(): UNKNOWN
            if info.node_name == UNKNOWN
            else f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in infos
        }


def _name(publishers: Publishers, gid: str) -> str:
    """Return what a publisher is called: by its node, or by its GID if that has no name."""
    name = publishers[gid]
    return f"a publisher without a name (GID {gid})" if name == UNKNOWN else name


class Clock:
    """Whether stamps go on as time does. After a pause any stamp is the first of a new series."""

    def __init__(self) -> None:
        self.stamp_ns = -1  # the last; negative: none
        self._now_ns = 0

    def goes_on(self, stamp_ns: int, now_ns: int) -> bool:
        """Note a stamp that came at a monotonic time [ns]; return whether it is to be believed."""
        if not 0 <= stamp_ns < END_NS:
            return True  # no time at all, which is counted elsewhere
        passed_ns = now_ns - self._now_ns
        jump_ns = stamp_ns - self.stamp_ns - passed_ns
        if self.stamp_ns >= 0 and abs(jump_ns) > JUMP_NS and passed_ns < DOUBT_NS:
            return False
        self.stamp_ns, self._now_ns = stamp_ns, now_ns
        return True
