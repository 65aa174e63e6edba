# pyright: basic
"""Publish a bag on the live graph, as serialised bytes, with the recorded timing and quality of service."""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Mapping
from contextlib import ExitStack

import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import ok, try_shutdown
from ruamel.yaml import YAML, YAMLError

from quadftc_bags.bag import Bag, BagError, read_bag
from quadftc_bags.interfaces import load_message_class

LAST_MESSAGES = Duration(seconds=1)  # what reliable readers get to fetch the last messages
DEEPEST = 100_000  # messages; a recorded depth beyond makes no sense
LONGEST_SLEEP = 0.1  # s, between two looks at whether to go on


def play(
    path: str | os.PathLike[str],
    rate: float = 1.0,
    *,
    loop: bool = False,
    topics: Collection[str] | None = None,
    delay: float = 0.0,
    context: Context | None = None,
) -> int:
    """Publish a bag until its end, or until Ctrl-C or the shutdown of the context; return how many messages.

    ``path`` and ``topics`` are as of `read_bag`; ``rate`` is a multiple of the recorded speed. With ``loop``
    the bag begins again at its end. Stamps stay as recorded. The first message comes ``delay`` [s] after the
    publishers; nothing waits for readers. The default context is initialised and shut down here unless it is
    in use. ValueError for a rate that is not positive, an unreadable bag, or a type that is not installed.
    """
    if not rate > 0.0:
        raise ValueError(f"rate: {rate}, expected > 0")
    bag = read_bag(path, topics)
    if not bag.topics:
        raise BagError(f"{bag.path}: nothing to play")
    with ExitStack() as undo:
        if context is None and not ok():
            rclpy.init()
            undo.callback(try_shutdown)
        node = Node("player", context=context, start_parameter_services=False)
        undo.callback(node.destroy_node)
        return _publish(bag, node, rate, loop, delay)


def profile_from_record(text: str) -> QoSProfile:
    """Return the recorded quality of service (a YAML list); what rosbag2 could not know is reliable."""
    try:
        entries = YAML(typ="safe").load(text) or [{}]
        entry: Mapping[str, object] = dict(entries[0])
    except (YAMLError, LookupError, TypeError, ValueError, RecursionError):
        entry = {}
    best_effort = entry.get("reliability") in ("best_effort", 2)
    latched = entry.get("durability") in ("transient_local", 1)
    keep_all = entry.get("history") in ("keep_all", 2)
    depth = entry.get("depth")
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
        depth=depth if isinstance(depth, int) and 0 < depth <= DEEPEST else 10,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _publish(bag: Bag, node: Node, rate: float, loop: bool, delay: float) -> int:
    """Publish until the end, or the shutdown of the node's context; return how many messages."""
    publishers: dict[str, Publisher] = {}
    try:
        for name, topic in bag.topics.items():
            message_class, profile = load_message_class(topic.type_name), profile_from_record(topic.qos)
            publishers[name] = node.create_publisher(message_class, name, profile)
    except NameValidationException as error:
        raise BagError(f"{bag.path}: {' '.join(str(error).split())}") from None
    published = 0
    try:
        again = _wait_until(time.monotonic() + delay, node.context)
        while again:
            before, start, first_ns = published, time.monotonic(), None
            for name, log_time_ns, data in bag.messages():
                first_ns = log_time_ns if first_ns is None else first_ns
                if not _wait_until(start + (log_time_ns - first_ns) * 1e-9 / rate, node.context):
                    return published
                publishers[name].publish(data)
                published += 1
            again = loop and published > before
        if node.context.ok():
            for publisher in publishers.values():
                publisher.wait_for_all_acked(LAST_MESSAGES)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    return published


def _wait_until(due: float, context: Context) -> bool:
    """Sleep until a time of the monotonic clock; return whether the context is still alive."""
    while (rest := due - time.monotonic()) > 0.0 and context.ok():
        time.sleep(min(rest, LONGEST_SLEEP))
    return context.ok()
