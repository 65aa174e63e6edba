r"""Logs of ArduPilot (DataFlash, ``.BIN``) out of tables; `quadftc_replay.dataflash` reads them.

    message: 0xA3 0x95 | type u8 | the fields of its format, one after the other
    format:  a message of type 128: type u8 | length u8 | name char[4] | types char[16] | fields char[64]

All is little-endian. A letter of a format is a type, of some with a factor. The log describes itself: formats
come first, then all messages by time.

Source: ArduPilot, libraries/AP_Logger/LogStructure.h.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike
from pymavlink.DFReader import FORMAT_TO_STRUCT  # type: ignore[import-untyped]

from quadftc_model.arrays import AnyArray
from quadftc_replay.dataflash import BEGIN, FORMAT, FORMAT_TYPE, HEAD, numpy_type

TYPES = cast("dict[str, tuple[str, float | None, object]]", FORMAT_TO_STRUCT)  # letter: code, factor, class
FORMAT_LETTERS, FORMAT_FIELDS = "BBnNZ", "Type,Length,Name,Format,Columns"
STAMP = "TimeUS"


class DataflashWriter:
    """Collects the messages of a log; `write` puts them into a file."""

    def __init__(self) -> None:
        self._formats = {"FMT": (FORMAT_TYPE, FORMAT_LETTERS, FORMAT_FIELDS)}  # name: type, letters, fields
        self._rows: list[tuple[int, bytes]] = []  # stamp [µs], message

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the messages, in the order in which they were added first."""
        return tuple(self._formats)[1:]

    def add(self, name: str, letters: str, fields: Mapping[str, ArrayLike]) -> None:
        """Add messages; ``fields`` are (n,) or one value, ``TimeUS`` [µs] (n,) the first of them.

        Numbers are in the unit of the field; what is beyond the range of its type becomes the nearest end. A
        name has one format; another one is a ValueError.
        """
        kind, *known = self._formats.setdefault(name, (len(self._formats), letters, ",".join(fields)))
        if known != [letters, ",".join(fields)]:
            raise ValueError(f"{name}: expected the fields {known[1]} of the types {known[0]}")
        stamps = np.atleast_1d(np.asarray(fields[STAMP], np.int64))
        codes = [TYPES[letter] for letter in letters]
        pairs = [(field, numpy_type(code[0])) for field, code in zip(fields, codes, strict=True)]
        table = np.zeros(len(stamps), np.dtype([("head", "S2"), ("kind", "u1"), *pairs]))
        table["head"], table["kind"] = HEAD, kind
        for (_, factor, _), (field, values) in zip(codes, fields.items(), strict=True):
            table[field] = _encode(np.asarray(values), factor, table.dtype[field])
        self._rows += [(int(stamp), row.tobytes()) for stamp, row in zip(stamps, table, strict=True)]

    def write(self, path: Path) -> None:
        """Write the log: its formats, then its messages by time; those of one time in the order of `add`."""
        begin: list[bytes] = []
        for name, (kind, letters, fields) in self._formats.items():
            texts = (each.encode() for each in (name, letters, fields))
            begin.append(HEAD + bytes([FORMAT_TYPE]) + FORMAT.pack(kind, _length(letters), *texts))
        rows = (row for _, row in sorted(self._rows, key=lambda each: each[0]))
        path.write_bytes(b"".join([*begin, *rows]))


def _length(letters: str) -> int:
    return BEGIN + sum(np.dtype(numpy_type(TYPES[letter][0])).itemsize for letter in letters)


def _encode(values: AnyArray, factor: float | None, kind: np.dtype) -> AnyArray:
    if kind.kind == "S":
        return values
    scaled = values / factor if factor else values
    if kind.kind == "f":
        return scaled
    ends = np.iinfo(kind)
    return np.clip(np.rint(scaled), ends.min, ends.max)
