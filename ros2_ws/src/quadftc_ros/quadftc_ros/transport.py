# pyright: basic
"""Between rclpy and a node's callbacks: usable messages come in, others are counted; a tap copies what goes.

A message is usable if its stamp is a time and its frame is that of its topic. A trace notes when messages
come and go, by the monotonic clock.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

from quadftc_bags.cdr.layout import FRAME, PLAIN
from quadftc_bags.cdr.message import leading_frame, leading_stamp_ns
from quadftc_ros.conversions import END_NS
from quadftc_ros.limits import Limit
from quadftc_ros.topics import IMU, TOPICS

T = TypeVar("T")

PIECE = 65536  # messages of a trace: a minute at 1 kHz
NO_STAMP = "stamp is no time"  # negative, or so late that no message can have it

Count = Callable[[str], None]  # gets the reason why a message is refused
Note = Callable[[int], None]  # gets the stamp of a message [ns]
Take = Callable[[bytes], None]  # gets a message in CDR
Tap = Callable[[str], Take | None]  # full name of a topic -> what gets its messages, if anything does


def tapped(publisher: Publisher, tap: Tap | None) -> Callable[[object], None]:
    """Return the ``publish`` of a publisher; a tap gets a copy. The message is serialised once, for both."""
    take = None if tap is None else tap(publisher.topic_name)
    if take is None:
        return publisher.publish
    handle = publisher.handle  # for bytes, without the detours of `publish`

    def publish(message: object) -> None:
        data = message if isinstance(message, bytes) else serialize_message(message)
        with handle:
            handle.publish_raw(data)
        take(data)

    return publish


def both(first: Tap, second: Tap | None) -> Tap:
    """Return a tap for two that want messages."""
    if second is None:
        return first

    def choose(topic: str) -> Take | None:
        takers = [take for take in (first(topic), second(topic)) if take is not None]

        def take_all(data: bytes) -> None:
            for take in takers:
                take(data)

        return take_all if len(takers) > 1 else takers[0] if takers else None

    return choose


def receiver(topic: str, callback: Callable[[int, bytes], None], count: Count, note: Note) -> Take:
    """Return what takes the serialised messages of a topic of the table, for ``callback(stamp_ns, data)``.

    No frame, and that of a vehicle (``uav1/base_link``), are as good as that of the table. An IMU is taken
    for one that is aligned with the body whatever its driver calls its frame.
    """
    row = TOPICS[topic]
    is_imu = row.type_name == IMU
    head = row.frame.encode() + b"\0"  # the last frame that was right
    usual = slice(FRAME, FRAME + len(head))
    wrong_frame = f"{topic}: frame_id is not {row.frame}{', used all the same' if is_imu else ''}"

    def receive(data: bytes) -> None:
        nonlocal head, usual
        try:
            stamp_ns = leading_stamp_ns(data)
        except ValueError:
            count(f"{topic}: unreadable")
            return
        if not 0 <= stamp_ns < END_NS:
            count(f"{topic}: {NO_STAMP}")
            return
        if data[usual] != head and data[:2] in PLAIN:
            frame = leading_frame(data)
            if frame and frame.rpartition("/")[2] != row.frame:
                count(wrong_frame)
                if not is_imu:
                    return
            elif frame:
                head = frame.encode() + b"\0"
                usual = slice(FRAME, FRAME + len(head))
        note(stamp_ns)
        callback(stamp_ns, data)

    return receive


def decoding(
    topic: str,
    callback: Callable[[int, T], None],
    decode: Callable[[bytes], T],
    count: Count,
    limit: Limit | None = None,
) -> Callable[[int, bytes], None]:
    """Return ``callback`` for serialised messages; what cannot be decoded or is beyond a limit is counted."""
    beyond = f"{topic}: more than the vehicle can do, refused"

    def receive(stamp_ns: int, data: bytes) -> None:
        try:
            value = decode(data)
        except ValueError:
            count(f"{topic}: unreadable")
            return
        if limit is not None and limit(value):
            count(beyond)
        else:
            callback(stamp_ns, value)

    return receive


class MessageTrace:
    """Times at which a node takes and gives messages, topic by topic.

    A note takes tenths of a microsecond, in memory that is there already: growing it can take milliseconds.
    """

    def __init__(self) -> None:
        self._rows: dict[str, _Rows] = {}

    def noting(self, event: str) -> Note:
        """Return what notes messages "taken <topic>" or, before they are published, "given <topic>"."""
        return self._rows.setdefault(event, _Rows()).note

    def save(self, path: Path) -> None:
        """Write the times as a NumPy archive, see `load_trace`; OSError if it cannot be written."""
        np.savez(path, allow_pickle=False, **{name: rows.noted() for name, rows in self._rows.items()})


def load_trace(path: Path) -> dict[str, NDArray[np.int64]]:
    """Return a saved trace: by "taken <topic>" and "given <topic>", (n, 2) of stamp and time [ns]."""
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name].astype(np.int64) for name in archive.files}


class _Rows:
    """Stamps and times [ns], in pieces of a fixed size."""

    def __init__(self) -> None:
        self._pieces = [array("q", bytes(16 * PIECE))]
        self._end = 0  # in the last piece

    def note(self, stamp_ns: int) -> None:
        if self._end == 2 * PIECE:
            self._pieces.append(array("q", bytes(16 * PIECE)))
            self._end = 0
        piece, end = self._pieces[-1], self._end
        piece[end], piece[end + 1] = stamp_ns, time.monotonic_ns()
        self._end = end + 2

    def noted(self) -> NDArray[np.int64]:
        *whole, last = self._pieces
        return np.concatenate([*whole, last[: self._end]]).astype(np.int64).reshape(-1, 2)
