# pyright: basic
r"""Logs of ArduPilot (DataFlash, ``.BIN``): their bytes as columns, by the names of message and field.

    message: 0xA3 0x95 | type u8 | the fields of its format, one after the other
    format:  a message of type 128: type u8 | length u8 | name char[4] | types char[16] | fields char[64]

All is little-endian. A letter of a format is a type, of some with a factor; pymavlink knows them. Its own
reader is not used: it ends a log at the first message it does not know, and decodes message by message.
Source: ArduPilot, libraries/AP_Logger/LogStructure.h.

The file is mapped, not read; of the messages that were asked for the places are kept, 8 bytes each, thinned
out where there are too many. Behind bytes that make no message the next one is looked for. A message that has
the beginning of another inside, and none behind it, is left out.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pymavlink.DFReader import FORMAT_TO_STRUCT

from quadftc_bags.bag import BagError
from quadftc_model.arrays import AnyArray
from quadftc_replay.thinning import Data, Forgetting, Places, mapped, rows_at

HEAD = b"\xa3\x95"
BEGIN = 3  # bytes before the fields
FORMAT_TYPE = 128
FORMAT = struct.Struct("<BB4s16s64s")
PARAMETER, PARAMETER_FIELDS = "PARM", ("Name", "Value")
# bytes; a board writes a log in chunks of 512 or a multiple (AP_Logger_File), and may leave out the last
CHUNK = 512
MOST_LEFT = 256  # bytes; the longest message is shorter


class DataflashLog(NamedTuple):
    """The messages that were asked for: name, such as ``IMU``, to field to (n,), in the unit of the log."""

    messages: Mapping[str, Mapping[str, AnyArray]]
    parameters: Mapping[str, float]  # at the end of the log
    notes: tuple[str, ...]  # one line each
    lacks_chunk: bool = False  # the log ends within a message, with a chunk that a board wrote


class _Format(NamedTuple):
    name: str
    row: np.dtype
    factors: Mapping[str, float]  # of fields that are numbers


def read_dataflash(
    path: Path, names: Mapping[str, Collection[str]], instances: Collection[str] = ()
) -> DataflashLog:
    """Read messages of some names, of each some fields; BagError if the file holds no format.

    ``instances`` are fields that tell sensors apart: too many messages are thinned out for each by itself.
    """
    with mapped(path) as data:
        scan = _Scan(data, {*names, PARAMETER}, instances)
        scan.run()
        formats = {scan.formats[kind].name: kind for kind, places in scan.places.items() if places}
        messages = {name: scan.gather(formats[name], names[name]) for name in names if name in formats}
        parameters = scan.gather(formats[PARAMETER], PARAMETER_FIELDS) if PARAMETER in formats else {}
    if not scan.formats:
        raise BagError(f"{path}: not an ArduPilot log: no format of a message (FMT) in it")
    return DataflashLog(messages, parameters_of(parameters), tuple(scan.notes()), scan.lacks_chunk)


def parameters_of(table: Mapping[str, AnyArray]) -> dict[str, float]:
    """Parameters by name; of those that come again the last counts."""
    if not {*PARAMETER_FIELDS} <= table.keys():
        return {}
    return {text_of(name): float(value) for name, value in zip(table["Name"], table["Value"], strict=True)}


def text_of(raw: bytes) -> str:
    """Return a text that ends with a zero byte."""
    return bytes(raw).split(b"\0")[0].decode("utf-8", "replace")


def numpy_type(code: str) -> str:
    """Type of NumPy for one of `struct`, little-endian."""
    return f"S{code[:-1]}" if code.endswith("s") else f"<{code}"


class _Scan:
    """Finds the messages, and counts the bytes that are none."""

    def __init__(self, data: Data, names: Collection[str], instances: Collection[str]) -> None:
        self.data, self.names, self.instances = data, names, instances
        self.formats: dict[int, _Format] = {}
        self.places: dict[int, defaultdict[int, Places]] = {}  # type -> instance -> places
        self._instance_at: dict[int, int] = {}  # type -> byte of a message that tells the instance
        self.is_cut = self.lacks_chunk = False  # the log ends within a message: anywhere, or with a chunk
        self.skipped = self.gaps = self.left = self.wrong_formats = 0
        self._lengths = [0] * 256
        self._lengths[FORMAT_TYPE] = BEGIN + FORMAT.size

    def run(self) -> None:
        """Go through the file."""
        data, lengths, places, size = self.data, self._lengths, self.places, len(self.data)
        forgetting = Forgetting(data)
        at = end = 0
        while at + BEGIN <= size:
            forgetting.passed(at)
            is_head = data[at] == HEAD[0] and data[at + 1] == HEAD[1]
            after = at + (lengths[data[at + 2]] if is_head else 0)
            if after == at or after > size or not self._is_followed(at, after, size):
                found = data.find(HEAD, at + 1)
                at = found if found >= 0 else size
                continue
            self.skipped += at - end
            self.gaps += at > end
            kind = data[at + 2]
            if kind in places:
                places[kind][data[at + self._instance_at[kind]]].add(at)
            elif kind == FORMAT_TYPE:
                self._learn(at)
            at = end = after
        self.left = size - end
        begins = data[end : end + len(HEAD)] == HEAD[: self.left] if self.left else False
        is_partial = begins and (self.left < BEGIN or lengths[data[end + len(HEAD)]] > self.left)
        self.is_cut, self.lacks_chunk = is_partial and size % CHUNK > 0, is_partial and size % CHUNK == 0

    def _is_followed(self, at: int, after: int, size: int) -> bool:
        """Whether a message is followed by another or the end, or has at least no other inside."""
        data = self.data
        if after + 2 > size or (data[after] == HEAD[0] and data[after + 1] == HEAD[1]):
            return True
        return data.find(HEAD, at + BEGIN, after) < 0

    def _learn(self, at: int) -> None:
        """Learn a format, if it makes sense; of those that come again the first counts."""
        kind, length, *raw = FORMAT.unpack_from(self.data, at + BEGIN)
        name, types, text = map(text_of, raw)
        fields = text.split(",") if text else []
        if kind in self.formats or kind == FORMAT_TYPE:
            return
        is_known = {*types} <= FORMAT_TO_STRUCT.keys() and len(fields) == len(types) == len({*fields})
        codes = [FORMAT_TO_STRUCT[each] for each in types] if is_known and name else []
        row = np.dtype([(field, numpy_type(code[0])) for field, code in zip(fields, codes, strict=False)])
        is_again = name in {each.name for each in self.formats.values()}
        if not codes or row.itemsize + BEGIN != length or is_again:
            self.wrong_formats += name in self.names
            self._lengths[kind] = self._lengths[kind] or (length if length > BEGIN else 0)
            return
        both = zip(fields, codes, strict=True)
        factors = {field: factor or 1.0 for field, (code, factor, _) in both if not code.endswith("s")}
        self.formats[kind], self._lengths[kind] = _Format(name, row, factors), length
        if name in self.names:
            field = next((each for each in self.instances if each in fields), None)
            self._instance_at[kind] = 0 if field is None else BEGIN + int(row.fields[field][1])  # type: ignore
            self.places[kind] = defaultdict(Places)

    def notes(self) -> Iterator[str]:
        """Say what is wrong with the log."""
        if self.gaps:
            yield f"{self.skipped} bytes at {self.gaps} places are no messages; left out"
        if self.is_cut:
            yield "cut short: the log ends within a message"
        elif self.left > MOST_LEFT:
            yield f"cut short or damaged: {self.left} bytes behind the last message; left out"
        if self.wrong_formats:
            yield f"{self.wrong_formats} formats of messages make no sense; left out"
        for kind, instances in self.places.items():
            for number, places in instances.items():
                name = self.formats[kind].name
                yield from places.thinning.notes(f"{name} {number}" if self._instance_at[kind] else name)

    def gather(self, kind: int, fields: Collection[str]) -> dict[str, AnyArray]:
        """Copy fields of a type of message out of the file, block by block; numbers with their factors."""
        row, factors = self.formats[kind].row, self.formats[kind].factors
        each_at = [np.frombuffer(places.at, np.uint64) for places in self.places[kind].values()]
        places = np.sort(np.concatenate(each_at)).astype(np.int64) + BEGIN
        there = [field for field in fields if field in (row.names or ())]
        columns: dict[str, AnyArray] = {
            field: np.empty(len(places), row[field] if factors.get(field, 1.0) == 1.0 else np.float64)
            for field in there
        }
        for block, table in rows_at(self.data, places, row):
            with np.errstate(invalid="ignore"):  # damaged bytes may be a signalling NaN
                for field in there:
                    columns[field][block] = table[field]
        for field in there:
            if (factor := factors.get(field, 1.0)) != 1.0:
                columns[field] *= factor
        return columns
