# pyright: basic
"""Telemetry logs of a ground station (MAVLink, ``.tlog``): their bytes as tables, by the names of the fields.

    message:  time of receipt u64, big-endian, since 1970 [µs] | MAVLink message of version 1 or 2

pymavlink knows the fields and the check sums. Its own reader is not used: it decodes message by message,
which takes 0.2 ms each. Here the places of the messages that were asked for are kept, and each kind is
decoded at once, check sums included. Behind bytes that make no message the next one is looked for.
Source: mavlink.io/en/guide/serialization.html.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_model.arrays import AnyArray
from quadftc_replay.readers.contents import LATEST, STAMP, message_length
from quadftc_replay.thinning import Data, Forgetting, Places, mapped

NUMBERS = {kind.msgname: number for number, kind in dialect.mavlink_map.items()}  # of messages, by name
OLD, NEW = 0xFE, 0xFD  # first bytes of version 1 and 2
STAMP_SIZE = STAMP.size  # bytes
HEADERS = {OLD: 6, NEW: 10}  # bytes before the payload
CHECK_SUM = 2  # bytes
BLOCK = 65536  # messages decoded at a time
RECEIVED = "received_us"  # field beside those of the message
TYPES = {"c": "S", "b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "q": "i8", "Q": "u8"}
TYPES |= {"f": "f4", "d": "f8"}
SHORTEST = STAMP_SIZE + HEADERS[OLD] + CHECK_SUM


class TelemetryLog(NamedTuple):
    """The messages of one kind, as fields (n, ...), by system and name."""

    messages: Mapping[int, Mapping[str, Mapping[str, AnyArray]]]
    notes: tuple[str, ...]  # one line each


def read_telemetry(path: Path, names: Collection[str]) -> TelemetryLog:
    """Read messages of some names; BagError if there are none.

    Of several components of a system that send the same message, the one that sends most of it counts.
    """
    wanted = {NUMBERS[name]: name for name in names}
    with mapped(path) as data:
        scan = _Scan(data, wanted)
        scan.run()
        most: dict[tuple[int, int], int] = {}  # system, message -> component
        for system, component, number in sorted(scan.places, key=lambda key: -scan.count(key)):
            most.setdefault((system, number), component)
        messages: dict[int, dict[str, dict[str, AnyArray]]] = {}
        for (system, number), component in most.items():
            table = scan.gather((system, component, number))
            if len(table[RECEIVED]):
                messages.setdefault(system, {})[wanted[number]] = table
    return TelemetryLog(messages, tuple(scan.notes()))


def check_sums(rows: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """CRC-16/MCRF4XX of each row (n, bytes)."""
    total = np.full(len(rows), 0xFFFF, np.uint16)
    for column in rows.T:
        part = column ^ (total & 0xFF).astype(np.uint8)
        part = part ^ (part << 4)
        wide = part.astype(np.uint16)
        total = (total >> 8) ^ (wide << 8) ^ (wide << 3) ^ (wide >> 4)
    return total


def _row_type(kind: Any) -> np.dtype:
    """Fields of a message in the order in which they are sent."""
    codes = kind.native_format.decode().lstrip("<")
    fields: list[tuple[object, ...]] = []
    for name, code, count in zip(kind.ordered_fieldnames, codes, kind.array_lengths, strict=True):
        if code == "c":
            fields.append((name, f"S{max(count, 1)}"))
        else:
            fields.append((name, f"<{TYPES[code]}", (count,)) if count else (name, f"<{TYPES[code]}"))
    return np.dtype(fields)


class _Scan:
    """Finds the messages, and counts the bytes that are none."""

    def __init__(self, data: Data, wanted: Collection[int]) -> None:
        self.data, self.wanted = data, wanted
        self.places: dict[tuple[int, int, int], Places] = {}  # system, component, message
        self.skipped = self.gaps = self.left = self.wrong = 0
        self._found = dict.fromkeys(HEADERS, -1)  # next place of each first byte that was looked for

    def count(self, key: tuple[int, int, int]) -> int:
        """How many messages there are."""
        return self.places[key].thinning.count

    def run(self) -> None:
        """Go through the file."""
        data, size, wanted = self.data, len(self.data), self.wanted
        forgetting, at, end = Forgetting(data), 0, 0
        while at + SHORTEST <= size:
            forgetting.passed(at)
            after = self._end(at, size)
            if not after:
                at = self._next(at + 1, size)
                continue
            self.skipped += at - end
            self.gaps += at > end
            head = at + STAMP_SIZE
            if data[head] == NEW:
                number, place = int.from_bytes(data[head + 7 : head + 10], "little"), head + 5
            else:
                number, place = data[head + 5], head + 3
            if number in wanted:
                key = data[place], data[place + 1], number
                if key not in self.places:
                    self.places[key] = Places()
                self.places[key].add(at)
            at = end = after
        self.left = size - end

    def _end(self, at: int, size: int) -> int:
        """Place behind the message at a place; 0 if there is none, or neither another nor the end follows."""
        head = at + STAMP_SIZE
        if self.data[head] not in HEADERS or STAMP.unpack_from(self.data, at)[0] > LATEST:
            return 0
        after = head + message_length(self.data, head)
        if after > size:
            return 0
        return after if after + STAMP_SIZE >= size or self.data[after + STAMP_SIZE] in HEADERS else 0

    def _next(self, at: int, size: int) -> int:
        """Place of the next stamp that may have a message behind it."""
        for first, found in self._found.items():
            if found < at + STAMP_SIZE:
                later = self.data.find(bytes([first]), at + STAMP_SIZE)
                self._found[first] = later if later >= 0 else size + STAMP_SIZE
        return min(self._found.values()) - STAMP_SIZE

    def notes(self) -> Iterator[str]:
        """Say what is wrong with the log."""
        if self.gaps:
            yield f"{self.skipped} bytes at {self.gaps} places are no messages; left out"
        if self.left:
            yield f"cut short or damaged: {self.left} bytes behind the last message; left out"
        if self.wrong:
            yield f"{self.wrong} messages with a wrong check sum left out"
        for (system, _, number), places in self.places.items():
            yield from places.thinning.notes(f"{dialect.mavlink_map[number].msgname} of system {system}")

    def gather(self, key: tuple[int, int, int]) -> dict[str, AnyArray]:
        """Decode the messages of a kind, those with the right check sum, and when they were received [µs]."""
        kind: Any = dialect.mavlink_map[key[2]]
        row = _row_type(kind)
        places = np.frombuffer(self.places[key].at, np.uint64).astype(np.int64)
        payload = np.zeros((len(places), row.itemsize), np.uint8)
        good = np.zeros(len(places), np.bool_)
        received = np.zeros(len(places), np.int64)
        view, forgetting = np.frombuffer(self.data, np.uint8), Forgetting(self.data)
        for first in range(0, len(places), BLOCK):
            block = slice(first, first + BLOCK)
            part = _decode(view, places[block], row.itemsize, kind.crc_extra)
            received[block], payload[block], good[block] = part
            forgetting.passed(int(places[block][-1]))
        del view  # else the map could not be closed
        self.wrong += int(np.sum(~good))
        table = payload[good].view(row)[:, 0]
        with np.errstate(invalid="ignore"):  # damaged bytes may be a signalling NaN
            fields = {name: np.array(table[name]) for name in row.names or ()}
        return {RECEIVED: received[good], **fields}


def _decode(
    view: NDArray[np.uint8], places: NDArray[np.int64], width: int, extra: int
) -> tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.bool_]]:
    """Times of receipt (n,), payloads (n, width), whose zeros at the end need not be sent; which are good."""
    received = view[places[:, None] + np.arange(STAMP_SIZE)].copy().view(">u8")[:, 0].astype(np.int64)
    heads = places + STAMP_SIZE
    shapes = np.stack([view[heads], view[heads + 1]], axis=-1)  # version, bytes of the payload
    payload, good = np.zeros((len(places), width), np.uint8), np.zeros(len(places), np.bool_)
    for shape in np.unique(shapes, axis=0):
        rows = np.flatnonzero((shapes == shape).all(axis=1))
        header, length = HEADERS[int(shape[0])], int(shape[1])
        whole = view[heads[rows, None] + np.arange(1, header + length)]
        whole = np.concatenate([whole, np.full((len(rows), 1), extra, np.uint8)], axis=1)
        sums = view[heads[rows, None] + header + length + np.arange(CHECK_SUM)].copy().view("<u2")[:, 0]
        used = min(length, width)
        payload[rows, :used] = whole[:, header - 1 : header - 1 + used]
        good[rows] = check_sums(whole) == sums
    return received, payload, good
