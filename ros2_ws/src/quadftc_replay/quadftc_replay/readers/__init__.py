"""Readers of flight logs, one file per format; `read_log` chooses by the first bytes.

A reader takes a path and gives a `FlightLog`. A new format is one more file, and one more line in `READERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from quadftc_bags.bag import BagError
from quadftc_replay.flight_log import FlightLog

HEAD = 16  # bytes that tell a format


class Reader(NamedTuple):
    """A format: how its files begin, and the module with ``read(path)``, imported when it is needed."""

    name: str
    begins: tuple[bytes, ...]
    module: str

    def read(self, path: Path) -> FlightLog:
        """Read a log."""
        read: Callable[[Path], FlightLog] = import_module(f"{__name__}.{self.module}").read
        return read(path)


READERS = (
    Reader("ROS 2 bag", (b"\x89MCAP0\r\n", b"SQLite format 3\0"), "rosbag"),
    Reader("PX4 ULog", (b"ULog\x01\x12\x35",), "ulog"),
    Reader("ArduPilot BIN", (b"\xa3\x95",), "ardupilot"),
    Reader("Crazyflie uSD", (b"\xbc\x01\x00", b"\xbc\x02\x00"), "crazyflie"),
)


OTHERS = {  # what people try as well
    b"\x1f\x8b": "a file compressed by gzip, which has to be unpacked",
    b"\x28\xb5\x2f\xfd": "a file compressed by zstd, which has to be unpacked",
    b"PK\x03\x04": "a ZIP archive, which has to be unpacked",
    b"FMT, ": "an ArduPilot log as text, whose .BIN can be read",
    b"H Product:": "a Blackbox log",
}


def find_reader(path: Path) -> Reader:
    """Find what reads a file; a BagError of one line if nothing does."""
    if path.is_dir():  # of the formats only a bag is a directory
        return READERS[0]
    if path.exists() and not path.is_file():  # a pipe would have us wait
        raise BagError(f"{path}: neither a file nor a directory; expected a log")
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD)
    except OSError as error:
        raise BagError(f"{path}: {error.strerror or error}") from None
    for reader in READERS:
        if head.startswith(reader.begins):
            return reader
    other = next((name for begin, name in OTHERS.items() if head.startswith(begin)), None)
    found = other or (f"a file that begins with {head[:8].hex(' ')}" if head else "an empty file")
    known = ", ".join(reader.name for reader in READERS)
    raise BagError(f"{path}: {found}; expected a log of one of the formats {known}")


def read_log(path: Path) -> FlightLog:
    """Read a log of any format; a BagError of one line says why it cannot be read."""
    return find_reader(path).read(path)
