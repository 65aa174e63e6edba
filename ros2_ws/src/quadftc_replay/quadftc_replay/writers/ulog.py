r"""Logs of PX4 (ULog) out of tables.

    file: "ULog" 01 12 35 | version u8 | start u64 [µs] | messages
    message: size u16 | type char | content
    F format | P parameter | A a topic gets a number | D a sample of a topic | L what the autopilot said

All is little-endian. The log describes itself; samples and texts come by time.

Source: PX4 documentation, "ULog File Format".
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

MAGIC, VERSION = b"ULog\x01\x12\x35", 1
HEADER, FLAGS = struct.Struct("<7sBQ"), bytes(40)  # no flag is set, nothing is appended
TYPES = {
    "uint64_t": "<u8",
    "uint32_t": "<u4",
    "int32_t": "<i4",
    "uint8_t": "<u1",
    "float": "<f4",
    "double": "<f8",
}
STAMP = "uint64_t timestamp"
INFO = b"6"  # level of what the autopilot says, as in the kernel of Linux


class UlogWriter:
    """Collects the samples of a log; `write` puts them into a file."""

    def __init__(self) -> None:
        self._parameters: list[bytes] = []
        self._formats: dict[str, bytes] = {}
        self._types = {name: np.dtype(code) for name, code in TYPES.items()}
        self._topics: dict[str, int] = {}  # topic: number
        self._rows: list[tuple[int, bytes]] = []  # stamp [µs], message

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the topics, in the order in which they were added first."""
        return tuple(self._topics)

    def set(self, name: str, value: float) -> None:
        """Note a parameter, whole numbers as such."""
        kind, packed = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
        key = f"{kind} {name}".encode()
        self._parameters.append(_message("P", bytes([len(key)]) + key + struct.pack(packed, value)))

    def add(self, topic: str, fields: Mapping[str, ArrayLike]) -> None:
        """Add samples: ``fields`` are "type name" or "type[k] name" to (n,), (n, k) or one value.

        The first is ``uint64_t timestamp`` [µs]. A type may be one of `define`. A topic has one format;
        another one is a ValueError.
        """
        self._define(topic, list(fields))
        number = self._topics.setdefault(topic, len(self._topics))
        stamps = np.asarray(fields[STAMP], np.int64)
        table = np.zeros(len(stamps), [self._column(each) for each in fields])
        for each, values in fields.items():
            is_whole = np.issubdtype(table.dtype[each].base, np.integer)
            table[each] = np.rint(values) if is_whole else values
        begin = struct.pack("<H", number)
        self._rows += [
            (int(stamp), _message("D", begin + row.tobytes()))
            for stamp, row in zip(stamps, table, strict=True)
        ]

    def define(self, name: str, fields: Sequence[str]) -> np.dtype:
        """Define a type out of fields; return what holds one of it in NumPy."""
        self._define(name, fields)
        self._types[name] = np.dtype([self._column(each) for each in fields])
        return self._types[name]

    def say(self, stamp: int, text: str) -> None:
        """Add what the autopilot says at a time [µs]."""
        self._rows.append((stamp, _message("L", INFO + struct.pack("<Q", stamp) + text.encode())))

    def write(self, path: Path) -> None:
        """Write the log: what describes it, then samples and texts by time."""
        start = min((stamp for stamp, _ in self._rows), default=0)
        begin = [HEADER.pack(MAGIC, VERSION, start), _message("B", FLAGS)]
        rows = (row for _, row in sorted(self._rows, key=lambda each: each[0]))
        topics = (
            _message("A", struct.pack("<BH", 0, number) + topic.encode())
            for topic, number in self._topics.items()
        )
        described = [*begin, *self._formats.values(), *self._parameters, *topics]
        path.write_bytes(b"".join([*described, *rows]))

    def _define(self, name: str, fields: Sequence[str]) -> None:
        form = _message("F", f"{name}:{''.join(f'{each};' for each in fields)}".encode())
        if self._formats.setdefault(name, form) != form:
            raise ValueError(f"{name}: expected the fields {self._formats[name][3:].decode()}")

    def _column(self, field: str) -> tuple[str, np.dtype, tuple[int, ...]]:
        """Column of NumPy for "type name" or "type[k] name"."""
        name, _, width = field.partition(" ")[0].partition("[")
        return field, self._types[name], (int(width.rstrip("]")),) if width else ()


def _message(kind: str, content: bytes) -> bytes:
    return struct.pack("<Hc", len(content), kind.encode()) + content
