"""Readers of flight logs, one file per format; `read_log` chooses by the first bytes.

A reader takes a path and gives a `FlightLog`. A new format is one more file, and one more line in `READERS`.
`bounded` runs a reader in a process with limits, as whatever comes from outside has to.
"""

from __future__ import annotations

import contextlib
import dataclasses
import tempfile
from collections.abc import Callable, Generator
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from quadftc_bags.bag import BagError
from quadftc_bags.ros1 import ROS1_MAGIC
from quadftc_bags.storage import bag_errors
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.readers.contents import (
    HEAD,
    begins,
    is_blackbox,
    is_dataflash_text,
    is_mavlink,
    is_text,
    name_content,
)
from quadftc_replay.readers.unpacking import CUT, PACKED, unpack


class LogChoice(NamedTuple):
    """What of a file is meant, and how it is to be read."""

    log: int = 0  # of several in a file, from 1; 0: the only one
    system: int = 0  # of several vehicles in a telemetry log: MAVLink system; 0: the only one
    mapping: Path | None = None  # what the columns of a table mean


ONLY_ONE = LogChoice()


class Source(NamedTuple):
    """A file with a log, perhaps unpacked."""

    file: Path
    choice: LogChoice  # of the logs in it
    notes: tuple[str, ...]  # of the unpacking, one line each

    def finish(self, log: FlightLog, path: Path) -> FlightLog:
        """Name the log by the file it came in."""
        cut = next((note for note in self.notes if note.startswith(CUT)), "")
        incomplete = log.incomplete or cut
        return dataclasses.replace(log, path=path, notes=(*self.notes, *log.notes), incomplete=incomplete)


class Reader(NamedTuple):
    """A format: how its files are known, and the module with ``read(path)``, imported when it is needed."""

    name: str
    knows: Callable[[bytes], bool]  # by the first `HEAD` bytes
    module: str
    cost: float  # processor time of 1 MB [s], measured on the costliest log at hand
    option: str = ""  # field of `LogChoice` that `read` takes
    function: str = "read"

    def read(self, path: Path, choice: LogChoice = ONLY_ONE) -> FlightLog:
        """Read a log."""
        read: Callable[..., FlightLog] = getattr(import_module(f"{__name__}.{self.module}"), self.function)
        return read(path, **({self.option: getattr(choice, self.option)} if self.option else {}))


ULOG = Reader("PX4 ULog", begins(b"ULog\x01\x12\x35"), "ulog", 0.1)
READERS = (
    Reader("ROS 2 bag", begins(b"\x89MCAP0\r\n", b"SQLite format 3\0"), "rosbag", 0.1),
    Reader("ROS 1 bag", begins(ROS1_MAGIC), "rosbag", 0.3),
    ULOG,
    Reader("ArduPilot BIN", begins(b"\xa3\x95"), "ardupilot", 0.1),
    Reader("ArduPilot .log", is_dataflash_text, "ardupilot", 0.1, function="read_text"),
    Reader("MAVLink tlog", is_mavlink, "telemetry", 0.1, "system"),
    Reader("blackbox", is_blackbox, "blackbox", 0.1, "log"),
    Reader("Crazyflie uSD", begins(b"\xbc\x01\x00", b"\xbc\x02\x00"), "crazyflie", 0.1),
)
TABLE = Reader("CSV", is_text, "table", 0.1, "mapping")


def find_reader(path: Path, choice: LogChoice = ONLY_ONE) -> Reader:
    """Find what reads a file; a BagError of one line if nothing does, or not with this choice."""
    if path.is_dir():  # of the formats only a bag is a directory
        reader = READERS[0]
    else:
        head = read_head(path)
        known = [TABLE] if choice.mapping and is_text(head) else READERS
        reader = next((each for each in known if each.knows(head)), None)
        if reader is None:
            names = ", ".join(each.name for each in (*READERS, TABLE)) + " with --mapping"
            raise BagError(f"{path}: {name_content(head)}; expected a log of one of the formats {names}")
    for option, value in choice._asdict().items():
        if value and option != reader.option:
            raise BagError(f"--{option} {value}: {path} is a {reader.name} log, which takes no --{option}")
    return reader


def read_head(path: Path) -> bytes:
    """Read the bytes that tell a format; BagError if the path is no file that can be read."""
    if path.exists() and not path.is_file():  # a pipe would have us wait
        raise BagError(f"{path}: neither a file nor a directory; expected a log")
    with bag_errors(path), path.open("rb") as stream:
        return stream.read(HEAD)


@contextlib.contextmanager
def unpacked(path: Path, choice: LogChoice) -> Generator[Source, None, None]:
    """Give the log itself and what is meant of it, unpacked into a directory that goes away behind it."""
    if path.is_dir() or not read_head(path).startswith(PACKED):
        yield Source(path, choice, ())
        return
    with tempfile.TemporaryDirectory(prefix="quadftc-") as directory:
        known = (*READERS, TABLE) if choice.mapping else READERS
        file, log, notes = unpack(
            path, Path(directory), choice.log, lambda head: any(each.knows(head) for each in known)
        )
        try:
            yield Source(file, choice._replace(log=log), notes)
        except BagError as error:  # whose text names the unpacked file
            raise BagError(str(error).replace(str(file), str(path))) from None


def read_log(path: Path, choice: LogChoice = ONLY_ONE) -> FlightLog:
    """Read a log of any format; a BagError of one line says why it cannot be read."""
    with unpacked(path, choice) as source:
        return source.finish(read_unpacked(source.file, source.choice), path)


def read_unpacked(path: Path, choice: LogChoice = ONLY_ONE) -> FlightLog:
    """Read a log that is not packed."""
    return find_reader(path, choice).read(path, choice)
