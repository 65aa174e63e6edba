# pyright: basic
"""Between rclpy and a node's callbacks: usable messages come in, others are counted; a tap copies what goes.

A message is usable if its stamp is a time and its frame is that of its topic.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

from quadftc_bags.cdr.layout import FRAME, PLAIN
from quadftc_bags.cdr.message import leading_frame, leading_stamp_ns
from quadftc_ros.conversions import END_NS, stamp_of
from quadftc_ros.topics import IMU, TOPICS
from quadftc_ros.trace import Note

NO_STAMP = "stamp is no time"  # negative, or so late that no message can have it

Count = Callable[[str], None]  # gets the reason why a message is refused
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


def of_messages(
    topic: str, callback: Callable[[int, Any], None], count: Count, note: Note
) -> Callable[[Any], None]:
    """Return what takes the messages of a topic of the table, for ``callback(stamp_ns, message)``."""
    fits = _frame_check(topic, count)

    def receive(message: Any) -> None:
        stamp_ns = stamp_of(message)
        if not 0 <= stamp_ns < END_NS:
            count(f"{topic}: {NO_STAMP}")
            return
        if not fits(getattr(message, "header", message).frame_id):
            return
        note(stamp_ns)
        callback(stamp_ns, message)

    return receive


def of_bytes(
    topic: str, callback: Callable[[int, bytes], None], count: Count, note: Note
) -> Callable[[bytes], None]:
    """Return what takes the serialised messages of a topic of the table, for ``callback(stamp_ns, data)``."""
    fits = _frame_check(topic, count)
    head = TOPICS[topic].frame.encode() + b"\0"
    usual = slice(FRAME, FRAME + len(head))

    def receive(data: bytes) -> None:
        try:
            stamp_ns = leading_stamp_ns(data)
        except ValueError:
            count(f"{topic}: unreadable")
            return
        if not 0 <= stamp_ns < END_NS:
            count(f"{topic}: {NO_STAMP}")
            return
        if data[usual] != head and data[:2] in PLAIN and not fits(leading_frame(data)):
            return
        note(stamp_ns)
        callback(stamp_ns, data)

    return receive


def decoding(
    topic: str, callback: Callable[[int, Any], None], decode: Callable[[bytes], Any], count: Count
) -> Callable[[int, bytes], None]:
    """Return ``callback`` for serialised messages; what `quadftc_ros.wire` cannot decode is counted."""

    def receive(stamp_ns: int, data: bytes) -> None:
        try:
            value = decode(data)
        except ValueError:
            count(f"{topic}: unreadable")
        else:
            callback(stamp_ns, value)

    return receive


def _frame_check(topic: str, count: Count) -> Callable[[str], bool]:
    """Return what says of a frame_id whether a message of a topic can be used; another is counted.

    None at all, and that of a vehicle (``uav1/base_link``), are as good as that of the table. An IMU is
    taken for one that is aligned with the body whatever its driver calls its frame.
    """
    row = TOPICS[topic]
    is_imu = row.type_name == IMU

    def fits(frame: str) -> bool:
        if not frame or frame.rpartition("/")[2] == row.frame:
            return True
        used = ", used all the same" if is_imu else ""
        count(f"{topic}: frame_id is not {row.frame}{used}")
        return is_imu

    return fits
