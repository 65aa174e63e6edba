# pyright: basic
"""A node whose callbacks a test calls itself, what it publishes, and messages that are wrong."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message

from node_bench import destroy_half_made
from quadftc_bags.interfaces import load_message_class
from quadftc_ros.conversions import END_NS, NANOSECONDS
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import TOPICS

SPECIAL = ("zero", "one", "negative", "end", "nanoseconds", "beyond", "same", "next")  # stamps
PERIOD_NS = 4_000_000  # ns; from the present to the next

# serialised messages that are none: cut short, of another encoding, of lengths that are not there
NO_MESSAGES = (
    b"",
    b"\0",
    b"\0\1\0\0",
    b"\0\1\0\0" + bytes(7),
    b"\0\1\0\0" + struct.pack("<iII", 5, 5, 2**32 - 1),
    b"\0\1\0\0" + struct.pack("<iII", 5, 5, 1) + b"\0",
    b"\0\7\0\0" + bytes(400),
    b"\xff\xff\xff\xff" + b"\xff" * 40,
)


class Wired:
    """A node with its callbacks by topic and by service, and all that it publishes; a context manager.

    Parameters
    ----------
    make : callable
        Class of the node.
    mode : str
    **parameters
        Of the node.
    """

    def __init__(self, make: Callable[..., GraphNode], mode: str, **parameters: Any) -> None:
        self.context = Context()
        self.context.init()
        self._out: deque[tuple[str, bytes]] = deque()  # a thread of the node may publish meanwhile
        given = {"mode": mode, **parameters}
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        try:
            self.node = make(tap=self._tap, context=self.context, parameter_overrides=overrides)
        except Exception as error:
            destroy_half_made(error)  # else its services answer nobody, and others are asked in vain
            self.context.try_shutdown()
            raise
        self.topics = {reader.topic_name.lstrip("/"): reader for reader in self.node.subscriptions}
        self.topics.pop("parameter_events", None)
        self.services = {service.srv_name.rpartition("/")[2]: service for service in self.node.services}

    def __enter__(self) -> Wired:
        """Return it."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the node."""
        self.node.destroy_node()
        self.context.try_shutdown()

    def _tap(self, topic: str) -> Callable[[bytes], None]:
        return lambda data: self._out.append((topic.removeprefix("/"), data))

    def feed(self, topic: str, message: Any) -> None:
        """Have the node take a message, or serialised bytes."""
        reader = self.topics[topic]
        if reader.raw:
            message = message if isinstance(message, bytes) else serialize_message(message)
        reader.callback(message)

    def call(self, name: str, request: Any) -> Any:
        """Have a service (the last word of its name) answer a request; return the response."""
        service: Any = self.services[name]
        return service.callback(request, service.srv_type.Response())

    def take(self) -> list[tuple[str, Any]]:
        """Return all that was published since the last time, in that order: topic and message."""
        found: list[tuple[str, Any]] = []
        while self._out:
            topic, data = self._out.popleft()
            message_class = load_message_class(TOPICS[topic if topic in TOPICS else f"/{topic}"].type_name)
            found.append((topic, deserialize_message(data, message_class)))
        return found


def numbers_of(message: Any) -> Iterator[float]:
    """Yield every float of a message."""
    if isinstance(message, float):
        yield message
    elif hasattr(message, "get_fields_and_field_types"):
        for name in message.get_fields_and_field_types():
            yield from numbers_of(getattr(message, name))
    elif not isinstance(message, (str, int, bytes, np.generic)):
        for part in message:
            yield from numbers_of(part)


def number_places(message: Any) -> Iterator[tuple[Any, str | int]]:
    """Yield where the floats of a message are: holder and name, of an array its first."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind == "double":
            yield message, name
        elif kind.startswith("double["):
            yield value, 0
        elif hasattr(value, "get_fields_and_field_types"):
            yield from number_places(value)


def put_number(place: tuple[Any, str | int], number: float) -> None:
    """Set a float where `number_places` has found one."""
    holder, name = place
    if isinstance(name, int):
        holder[name] = number
    else:
        setattr(holder, name, number)


def set_bad_stamp(message: Any, kind: int | str, now_ns: int) -> Any:
    """Set a stamp that is so much later than the present [ns], or one of `SPECIAL`; return the message."""
    stamp = getattr(message, "header", message).stamp
    special = {"zero": 0, "one": 1, "end": END_NS - 1, "same": now_ns, "next": now_ns + PERIOD_NS}
    if kind == "negative":
        stamp.sec, stamp.nanosec = -(2**31), 5
    elif kind == "nanoseconds":
        stamp.sec, stamp.nanosec = now_ns // NANOSECONDS, 2**32 - 1
    elif kind == "beyond":
        stamp.sec, stamp.nanosec = 2**31 - 1, 2**32 - 1
    else:
        stamp_ns = special[kind] if isinstance(kind, str) else now_ns + kind
        stamp.sec, stamp.nanosec = divmod(stamp_ns, NANOSECONDS)
    return message
