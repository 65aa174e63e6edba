"""Serialised messages with texts and lists, written field by field: rclpy takes several times as long."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from quadftc_bags.cdr.layout import NANOSECONDS


class MessageWriter:
    """Writes one message in plain little-endian CDR, its fields in the order of the definition."""

    def __init__(self, stamp_ns: int, frame: str = "") -> None:
        """Begin with the header: a stamp [ns] and a frame."""
        self._data = bytearray(b"\0\1\0\0")
        self.time(stamp_ns)
        self.text(frame)

    @property
    def data(self) -> bytes:
        """The message as far as it is written."""
        return bytes(self._data)

    def number(self, code: str, value: float) -> None:
        """Write a number by its code of `struct`, aligned to its size."""
        size = struct.calcsize(code)
        self._data += bytes((4 - len(self._data)) % size) + struct.pack(f"<{code}", value)

    def time(self, stamp_ns: int) -> None:
        """Write a time [ns]."""
        sec, nanosec = divmod(stamp_ns, NANOSECONDS)
        self.number("i", sec)
        self.number("I", nanosec)

    def text(self, text: str) -> None:
        """Write a string."""
        data = text.encode() + b"\0"
        self.number("I", len(data))
        self._data += data

    def texts(self, texts: Sequence[str]) -> None:
        """Write a sequence of strings."""
        self.number("I", len(texts))
        for each in texts:
            self.text(each)
