"""A tap on what a node publishes: in one process, the recorder gets its messages without subscribing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

Take = Callable[[bytes], None]  # gets a message in CDR
Tap = Callable[[str], Take | None]  # full name of a topic -> what gets its messages, if anything does


def tapped(publisher: Publisher, tap: Tap | None) -> Callable[[Any], None]:
    """Return the ``publish`` of a publisher, which gives a copy to the tap, if there is one.

    The message is serialised once, for both.
    """
    send = publisher.publish
    take = None if tap is None else tap(publisher.topic_name)
    if take is None:
        return send

    def publish(message: Any) -> None:
        data = message if isinstance(message, bytes) else serialize_message(message)
        send(data)
        take(data)

    return publish
