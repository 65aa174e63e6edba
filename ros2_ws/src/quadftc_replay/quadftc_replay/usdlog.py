r"""Logs of a Crazyflie's uSD card: their bytes as columns, by the names of event and variable.

    magic 0xBC | version u16 | number of events u16
    for each event:  id u16 | name \0 | number of variables u16 | for each: name(type) \0
    rows:  id u16 | time | the variables of the event, one after the other
    CRC-32 of all before, u32

All is little-endian; a type is a letter of `struct`. Time counts from the start of the vehicle: in version 1
in ms (u32), in version 2 in µs (u64). Source: bitcraze/crazyflie-firmware, usddeck.c and tools/usdlog.

A log that was cut off, as by an empty battery, is read up to the cut. Behind bytes that make no row, the next
row is looked for. Warnings say how much was left out, and whether the check sum is right.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import BagError
from quadftc_model.arrays import AnyArray
from quadftc_replay.thinning import Data, Forgetting, Places, mapped, rows_at

MAGIC = 0xBC
TIMES = {1: ("I", 1_000_000), 2: ("Q", 1000)}  # version -> type of a time, its unit [ns]
TYPES = "BbHhIief"  # of a variable: integers of 1, 2, 4 bytes, floats of 2 and 4
CHECK_SUM = 4  # bytes at the end
BLOCK = 1 << 20  # bytes summed up at a time
MAX_STEP_NS = 10_000_000_000  # between two rows of a damaged log
MAX_STAMP_NS = 2**62
SHOWN = 20  # characters of a name that is none


class EventRows(NamedTuple):
    """What was logged at one kind of event, such as ``fixedFrequency``."""

    stamp_ns: NDArray[np.int64]  # (n,) in the order of the file
    columns: Mapping[str, AnyArray]  # variable, such as ``gyro.x``, to (n,), in type and unit of the log


class UsdLog(NamedTuple):
    """A whole log."""

    events: Mapping[str, EventRows]
    warnings: tuple[str, ...]  # one line each


class _Event(NamedTuple):
    name: str
    variables: list[str]
    row: np.dtype  # fields f0, f1, ...: id, time, variables


def read_usdlog(path: Path, wanted: Container[str] | None = None) -> UsdLog:
    """Read a log, of each event the variables that are wanted, or all.

    The file is mapped. A BagError of one line says where the header is wrong, and what was expected.
    """
    with mapped(path) as data:
        return _read(data, path, wanted)


def _read(data: Data, path: Path, wanted: Container[str] | None) -> UsdLog:
    header = _Header(data, path)
    events = header.events()
    is_whole = _check_sum(data) == int.from_bytes(data[-CHECK_SUM:], "little")
    rows = _Rows(data, events, header, len(data) - CHECK_SUM if is_whole else len(data), is_whole)
    places = {key: Places() for key in events}
    end, forgetting = header.at, Forgetting(data)
    for key, at in rows:
        forgetting.passed(at)
        places[key].add(at)
        end = at + events[key].row.itemsize
    read = {
        event.name: _columns(data, places[key], event, header.unit_ns, wanted)
        for key, event in events.items()
    }
    thinned = [note for key, event in events.items() for note in places[key].thinning.notes(event.name)]
    return UsdLog(read, (*_damage(path, is_whole, rows, len(data) - end), *thinned))


def _check_sum(data: Data) -> int:
    """CRC-32 of all but the last bytes, block by block."""
    total, forgetting = 0, Forgetting(data)
    for first in range(0, len(data) - CHECK_SUM, BLOCK):
        forgetting.passed(first)
        total = zlib.crc32(data[first : min(first + BLOCK, len(data) - CHECK_SUM)], total)
    return total


def _damage(path: Path, is_whole: bool, rows: _Rows, left: int) -> Iterator[str]:
    """Say what is wrong with a log; ``left`` bytes are behind its last row, the check sum among them."""
    if rows.skipped:
        yield f"{path}: {rows.skipped} bytes at {rows.places} places are no rows; left out"
    if not is_whole:
        rest = f"; {left} bytes behind the last row"
        yield f"{path}: cut short or damaged, no check sum (CRC-32) that matches; read what makes sense{rest}"
    elif left > CHECK_SUM:
        yield f"{path}: {left - CHECK_SUM} bytes between the last row and the check sum; left out"


class _Header:
    def __init__(self, data: Data, path: Path) -> None:
        self.data, self.path, self.at = data, path, 0
        magic = self._number("B", "magic")
        if magic != MAGIC:
            raise self._wrong(0, "magic", hex(magic), hex(MAGIC))
        version = self._number("H", "version")
        if version not in TIMES:
            raise self._wrong(1, "version", str(version), " or ".join(map(str, TIMES)))
        self.time_type, self.unit_ns = TIMES[version]

    def events(self) -> dict[int, _Event]:
        """Read which events there are, by their id."""
        begin, count = self.at, self._number("H", "number of events")
        if not count:
            raise self._wrong(begin, "number of events", "0", "at least 1")
        events: dict[int, _Event] = {}
        for _ in range(count):
            begin, key = self.at, self._number("H", "id of an event")
            event = self._event()
            if key in events or event.name in {other.name for other in events.values()}:
                raise self._wrong(begin, "event", f"'{event.name}' with id {key} again", "each once")
            events[key] = event
        return events

    def _event(self) -> _Event:
        begin, name = self.at, self._text("name of an event")
        count = self._number("H", f"number of variables of '{name}'")
        variables = dict[str, str]()
        for _ in range(count):
            variable, kind = self._variable(name)
            if variable in variables:
                raise self._wrong(begin, f"event '{name}'", f"variable '{variable}' again", "each once")
            variables[variable] = kind
        types = ("H", self.time_type, *variables.values())
        row = np.dtype([(f"f{k}", f"<{kind}") for k, kind in enumerate(types)])
        return _Event(name, list(variables), row)

    def _variable(self, event: str) -> tuple[str, str]:
        """Name and type of a variable, which is written ``gyro.x(f)``."""
        begin, text = self.at, self._text(f"variable of '{event}'")
        name, bracket, kind = text[:-1].rpartition("(")
        if not (name and bracket and text.endswith(")") and len(kind) == 1 and kind in TYPES):
            expected = f"name(type) with a type of {', '.join(TYPES)}"
            raise self._wrong(begin, f"variable of '{event}'", f"'{text}'", expected)
        return name, kind

    def _number(self, kind: str, what: str) -> int:
        begin, self.at = self.at, self.at + struct.calcsize(f"<{kind}")
        if self.at > len(self.data):
            raise self._wrong(begin, what, "end of the file", "a whole header")
        return struct.unpack_from(f"<{kind}", self.data, begin)[0]

    def _text(self, what: str) -> str:
        begin, end = self.at, self.data.find(b"\0", self.at)
        if end < 0:
            raise self._wrong(begin, what, "end of the file", "a name that ends with a zero byte")
        self.at, raw = end + 1, self.data[begin:end]
        if not raw or not all(0x21 <= byte <= 0x7E for byte in raw):
            raise self._wrong(begin, what, repr(raw[:SHOWN]), "printable ASCII")
        return raw.decode("ascii")

    def _wrong(self, at: int, what: str, found: str, expected: str) -> BagError:
        return BagError(f"{self.path}: not a uSD log: {what} at byte {at}: {found}; expected {expected}")


class _Rows:
    """Finds the rows up to a byte ``end``, and counts the bytes that are none."""

    def __init__(
        self, data: Data, events: Mapping[int, _Event], header: _Header, end: int, is_whole: bool
    ) -> None:
        self.data, self.at, self.end, self.is_whole = data, header.at, end, is_whole
        self.sizes = {key: event.row.itemsize for key, event in events.items()}
        self.start = struct.Struct(f"<H{header.time_type}")
        self.step, self.last = MAX_STEP_NS // header.unit_ns, MAX_STAMP_NS // header.unit_ns
        self.skipped = self.places = 0

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Yield id and place of each row."""
        at, end, before = self.at, self.at, None
        while at + self.start.size <= self.end:
            row = self._look(at)
            if row is None or not (self.is_whole or self._makes_sense(row, before)):
                at += 1
                continue
            self.places += at > end
            self.skipped += at - end
            yield row[0], at
            _, before, end = row
            at = end

    def _look(self, at: int) -> tuple[int, int, int] | None:
        """Id, time and end of the row at a place; None: there is none."""
        if at + self.start.size > self.end:
            return None
        key, time = self.start.unpack_from(self.data, at)
        after = at + self.sizes.get(key, self.end)
        return (key, time, after) if after <= self.end and time <= self.last else None

    def _makes_sense(self, row: tuple[int, int, int], before: int | None) -> bool:
        """Whether the time of a row is near that of the row before, or else near that of the next."""
        _, time, after = row
        if before is not None and abs(time - before) <= self.step:
            return True
        following = self._look(after)
        return following is not None and abs(following[1] - time) <= self.step


def _columns(
    data: Data, places: Places, event: _Event, unit_ns: int, wanted: Container[str] | None
) -> EventRows:
    names = {name: f"f{k}" for k, name in enumerate(event.variables, 2) if wanted is None or name in wanted}
    rows = np.frombuffer(places.at, np.uint64).astype(np.int64)
    stamp_ns = np.empty(len(rows), np.int64)
    columns = {name: np.empty(len(rows), event.row[field]) for name, field in names.items()}
    for block, table in rows_at(data, rows, event.row):
        stamp_ns[block] = table["f1"].astype(np.int64) * unit_ns
        for name, field in names.items():
            columns[name][block] = table[field]
    return EventRows(stamp_ns, columns)
