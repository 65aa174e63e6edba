"""Logs of ArduPilot as text (``.log``): their lines as columns, by the names of message and field.

    FMT, 129, 35, IMU, QBffffff, TimeUS,I,GyrX,...
    IMU, 1000, 0, 0.01, ...
    2026-01-01 10:00:00.00: IMU {TimeUS : 1000, I : 0, GyrX : 0.01, ...}

Ground stations write the first two, where a format names the fields; mavlogdump prints the third.
Numbers are in the unit of the field already: the factors of a format count in the binary log alone.
Source: pymavlink, DFReader.py (DFReader_text); its reader keeps the whole file in memory.
"""

from __future__ import annotations

import re
from array import array
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.storage import bag_errors
from quadftc_replay.dataflash import PARAMETER, PARAMETER_FIELDS, DataflashLog, parameters_of
from quadftc_replay.thinning import Thinning

FORMAT = b"FMT"
PRINTED = re.compile(rb"\S+ \S+: ([A-Z0-9]+) \{(.*)\}\s*")
PAIRS = re.compile(rb"(?:^|, )(\w+) : ")
LONGEST = 4096  # bytes of a line
TEXTS = ("Message", "Name")  # fields that are no numbers
LONGEST_TEXT = 64  # bytes
MOST_FIELDS = 64


class _Table:
    def __init__(self, fields: Sequence[str]) -> None:
        self.numbers = {field: array("d") for field in fields if field not in TEXTS}
        self.texts = {field: list[bytes]() for field in fields if field in TEXTS}
        self.lines = array("Q")  # their numbers
        self.thinning = Thinning()

    def add(self, row: Mapping[str, bytes], line: int) -> None:
        """Take a row; ValueError or KeyError if a field is no number or missing."""
        values = {field: float(row[field]) for field in self.numbers}
        words = {field: row[field][:LONGEST_TEXT] for field in self.texts}
        if not self.thinning.keeps():
            return
        self.lines.append(line)
        for field, value in values.items():
            self.numbers[field].append(value)
        for field, text in words.items():
            self.texts[field].append(text)
        if self.thinning.is_full():
            for kept in (self.lines, *self.numbers.values(), *self.texts.values()):
                del kept[1::2]

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """Fields of all rows (n,)."""
        texts = {field: np.array(rows, f"S{LONGEST_TEXT}") for field, rows in self.texts.items()}
        return {field: np.array(rows) for field, rows in self.numbers.items()} | texts


def read_dataflash_text(
    path: Path, names: Mapping[str, Collection[str]], instances: Collection[str] = ()
) -> DataflashLog:
    """Read messages of some names, of each some fields, as `read_dataflash` does from the binary log."""
    wanted = {name.encode(): tuple(fields) for name, fields in {**names, PARAMETER: PARAMETER_FIELDS}.items()}
    reader = _LineReader(wanted, instances)
    with bag_errors(path), path.open("rb") as stream:
        for line in iter(lambda: stream.readline(LONGEST), b""):
            reader.take(line)
    messages = reader.messages()
    parameters = messages.pop(PARAMETER, {})
    return DataflashLog(messages, parameters_of(parameters), tuple(reader.notes()))


class _LineReader:
    def __init__(self, wanted: Mapping[bytes, tuple[str, ...]], instances: Collection[str]) -> None:
        self.wanted, self.instances = wanted, instances
        self._formats: dict[bytes, list[str]] = {}
        self._tables: dict[bytes, dict[bytes, _Table]] = defaultdict(dict)  # message -> instance -> rows
        self._line = self._wrong = 0
        self._is_cut = False

    def take(self, line: bytes) -> None:
        """Take a line."""
        self._line += 1
        self._is_cut = not line.endswith(b"\n")
        if printed := PRINTED.fullmatch(line):
            self._add(printed[1], _pairs(printed[2]) if printed[1] in self.wanted else {})
            return
        name, comma, rest = line.partition(b",")
        if name == FORMAT:
            self._learn(rest)
        elif comma and name in self._formats:
            fields = self._formats[name]
            values = [value.strip() for value in rest.split(b",", len(fields) - 1)]
            if len(values) == len(fields):
                self._add(name, dict(zip(fields, values, strict=True)))
            else:
                self._wrong += 1

    def _learn(self, rest: bytes) -> None:
        """Learn the fields of a message, if they are wanted; of formats that come again the first counts."""
        parts = [part.strip() for part in rest.split(b",")]
        if len(parts) > 4 and parts[2] in self.wanted and len(parts) < MOST_FIELDS:
            fields = [part.decode("ascii", "replace") for part in parts[4:]]
            self._formats.setdefault(parts[2], fields)

    def _add(self, name: bytes, row: Mapping[str, bytes]) -> None:
        if not row:
            return
        key = next((row[field] for field in self.instances if field in row), b"")
        tables = self._tables[name]
        if key not in tables:
            tables[key] = _Table([field for field in self.wanted[name] if field in row])
        try:
            tables[key].add(row, self._line)
        except (ValueError, KeyError):
            self._wrong += 1

    def messages(self) -> dict[str, dict[str, NDArray[np.generic]]]:
        """Columns of all messages, of all instances together in the order of the lines."""
        found: dict[str, dict[str, NDArray[np.generic]]] = {}
        for name, tables in self._tables.items():
            whole = [table for table in tables.values() if table.lines]  # others have damaged rows alone
            if not whole:
                continue
            each = [table.columns() for table in whole]
            shared = [field for field in each[0] if all(field in columns for columns in each)]
            order = np.argsort(np.concatenate([np.array(table.lines) for table in whole]))
            found[name.decode()] = {
                field: np.concatenate([columns[field] for columns in each])[order] for field in shared
            }
        return found

    def notes(self) -> Iterator[str]:
        """Say what is wrong with the log."""
        if self._wrong:
            yield f"{self._wrong} lines make no sense; left out"
        if self._is_cut:
            yield "cut short: the last line is not whole"
        for name, tables in self._tables.items():
            for key, table in tables.items():
                yield from table.thinning.notes(f"{name.decode()} {key.decode('ascii', 'replace')}".strip())


def _pairs(text: bytes) -> dict[str, bytes]:
    """Fields of a message as mavlogdump prints it."""
    found = list(PAIRS.finditer(text))
    ends = [match.start() for match in found[1:]] + [len(text)]
    return {match[1].decode(): text[match.end() : end] for match, end in zip(found, ends, strict=True)}
