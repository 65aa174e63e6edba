"""The files of a bag and the records in them: MCAP, and SQLite (.db3) as older ROS 2 writes it.

MCAP is read in file order, without its index, so that a file that was cut short can be read.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias, cast

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC
from ruamel.yaml import YAML, YAMLError

if TYPE_CHECKING:
    from rosbags.rosbag2 import Reader

_NONE = 0  # no opcode; zeros fill a file that lost its end with the power
_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_LATEST = 2**63 - 1  # ns; a later time is damage
_LARGEST = 1 << 30  # bytes of a chunk; a greater one is damage
_RATIO = 100  # bytes unpacked for a byte of the file, beside `_LARGEST`; beyond, it is no recording
_CHUNK_SPAN = struct.Struct("<QQ")  # first and last log time, with which a chunk begins
_READERS: dict[int, Callable[[ReadDataStream], Header | Schema | Channel | Attachment | Metadata]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.METADATA: Metadata.read,
}
_DAMAGE = (
    *(McapError, struct.error, zstandard.ZstdError, RuntimeError, UnicodeDecodeError, ValueError),
    *(OverflowError, MemoryError),
)


class BagError(ValueError):
    """A bag that cannot be read, or does not hold what was asked for; the text is one line."""


@dataclass(frozen=True)
class Damage:
    """A part of a file that cannot be read."""

    offset: int  # where it begins, and its length [bytes]
    size: int
    is_end: bool  # the file ends with it
    is_index: bool  # it lies behind the messages: none is lost with it
    span_ns: tuple[int, int] | None  # first and last log time of a chunk [ns], if its beginning is there


Message: TypeAlias = tuple[int, int, int, memoryview]  # channel, log time, publish time [ns], data
IsWanted: TypeAlias = Callable[[str, str], bool]  # by name and type of a topic
Record: TypeAlias = Header | Schema | Channel | Attachment | Metadata | Message | Damage


@contextlib.contextmanager
def bag_errors(path: Path) -> Generator[None, None, None]:
    """Make an OSError meanwhile a BagError on a path."""
    try:
        yield
    except OSError as error:
        raise BagError(f"{path}: {error.strerror or error}") from None


def storage_files(path: Path) -> list[Path]:
    """Return the files of a bag in order, of a SQLite bag itself; BagError if one is missing or empty."""
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    if path.is_file():
        check_size(path)
    if path.is_file() or is_sqlite(path):
        return [path]
    information = bag_information(path / "metadata.yaml")
    mode = str(information.get("compression_mode") or "").lower()
    if mode not in ("", "none", "storage"):
        raise BagError(f"{path}: compressed by {mode}; unpack it with 'ros2 bag convert'")
    names = cast("list[object]", information.get("relative_file_paths") or [])
    files = [path / Path(str(name)).name for name in names] or sorted(path.glob("*.mcap"))
    if not files:
        raise BagError(f"{path}: no bag in this directory (neither metadata.yaml nor an .mcap file)")
    for file in files:
        if not file.is_file():
            what = f"metadata.yaml names {file.name}, which is missing"
            raise BagError(f"{path}: {what}; run quadftc repair {path}")
        if file.suffix != ".mcap":
            raise BagError(f"{path}: {file.name} is not MCAP; convert the bag with 'ros2 bag convert'")
        check_size(file)
    return files


def check_size(file: Path) -> int:
    """Return the size of a file [bytes]; BagError if it is empty."""
    with bag_errors(file):
        size = file.stat().st_size
    if size == 0:
        raise BagError(f"{file}: empty file")
    return size


def bag_information(path: Path) -> dict[str, Any]:
    """Return what ``metadata.yaml`` says; nothing if it is missing, BagError if it makes no sense."""
    if not path.exists():
        return {}
    try:
        content: Any = YAML(typ="safe").load(path.read_text("utf-8"))  # pyright: ignore
        return dict(content["rosbag2_bagfile_information"])
    except (OSError, YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, RecursionError) as error:
        what = f"not the metadata of a bag ({type(error).__name__})"
        raise BagError(f"{path}: {what}; run quadftc repair {path.parent}") from error


def is_sqlite(path: Path) -> bool:
    """Whether a bag (directory or file) is stored in SQLite."""
    if path.is_dir():
        return any(path.glob("*.db3*")) and not any(path.glob("*.mcap"))
    return path.suffix == ".db3"


def read_records(path: Path) -> Iterator[Record]:
    """Yield the records of an MCAP file, those of a chunk where it stands, without indexes and statistics.

    A chunk with a wrong checksum and a missing end come as a `Damage`; what comes before and behind is good.
    BagError if the file cannot be read or is not MCAP.
    """
    with bag_errors(path), path.open("rb") as stream:
        if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise BagError(f"{path}: not an MCAP file")
        yield from _read_file(stream)


def _read_file(stream: BinaryIO) -> Iterator[Record]:
    size = os.fstat(stream.fileno()).st_size
    is_index, left = False, _LARGEST + _RATIO * size  # bytes that may still be unpacked
    while True:
        offset = stream.tell()
        head = stream.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (_NONE, 0)
        if opcode == _NONE or length > size - stream.tell():
            span_ns = _chunk_span(opcode, stream.read(_CHUNK_SPAN.size))
            yield Damage(offset, size - offset, True, is_index or opcode == Opcode.FOOTER, span_ns)
            return
        if opcode == Opcode.FOOTER:
            if stream.read(length + len(MCAP0_MAGIC) + 1)[length:] != MCAP0_MAGIC:
                yield Damage(offset, size - offset, True, True, None)
            return
        if opcode not in (Opcode.CHUNK, Opcode.MESSAGE, *_READERS):
            stream.seek(length, os.SEEK_CUR)
            is_index = is_index or opcode == Opcode.DATA_END
            continue
        body = stream.read(length)
        try:
            data = _chunk_data(body) if opcode == Opcode.CHUNK else head + body
            if (left := left - len(data)) < 0:
                raise BagError(f"{stream.name}: more than {_RATIO} bytes unpacked for each byte of the file")
            yield from _read_sequence(data)
        except BagError:
            raise
        except _DAMAGE:
            yield Damage(offset, _HEAD.size + length, False, is_index, _chunk_span(opcode, body))


def _chunk_span(opcode: int, body: bytes) -> tuple[int, int] | None:
    """First and last log time of a chunk [ns]."""
    if opcode != Opcode.CHUNK or len(body) < _CHUNK_SPAN.size:
        return None
    first, last = _CHUNK_SPAN.unpack_from(body)
    return (first, last) if 0 < first <= last else None


def _read_sequence(data: bytes) -> Iterator[Record]:
    """Read records that stand one after the other in memory."""
    view = memoryview(data)
    position = 0
    while position < len(data):
        opcode, length = _HEAD.unpack_from(data, position)
        start = position + _HEAD.size
        position = start + length
        if position > len(data):
            raise ValueError("the last record is cut")
        if opcode == Opcode.MESSAGE:
            channel, _, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            if log_time > _LATEST or publish_time > _LATEST:
                raise ValueError("a time is none")
            yield channel, log_time, publish_time, view[start + _MESSAGE.size : position]
        elif opcode in _READERS:
            yield _READERS[opcode](ReadDataStream(BytesIO(view[start:position])))


def _chunk_data(body: bytes) -> bytes:
    """Return the records inside a chunk, after checking their size and sum; never more than it states."""
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    size = chunk.uncompressed_size
    if size > _LARGEST:
        raise ValueError("a chunk is too large")
    data = chunk.data
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == "lz4":
        unpacker: Any = lz4.frame.LZ4FrameDecompressor()
        data = unpacker.decompress(data, size + 1)
    elif chunk.compression:
        raise ValueError(f"compression {chunk.compression}")
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("a chunk is not what it states")
    return data


@contextlib.contextmanager
def open_sqlite(path: Path) -> Generator[Reader, None, None]:
    """Open a SQLite bag; BagError, in one line, for whatever the library finds wrong with it."""
    from rosbags.rosbag2 import Reader

    try:
        with Reader(path) as reader:
            names: list[object] = list(reader.topics)  # as metadata.yaml has them
            if wrong := [name for name in names if not isinstance(name, str)]:
                raise BagError(f"{path}: topic {wrong[0]!r}: expected a name")
            yield reader
    except BagError:
        raise
    except Exception as error:  # of the library, of SQLite, of the file system
        words = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"{path}: not a bag that can be read: {words}") from None


def read_sqlite(path: Path, is_wanted: IsWanted) -> Iterator[Record]:
    """Yield the schemas and channels of the wanted topics as `read_records` does, then their messages."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_typestore

    with open_sqlite(path) as reader:
        chosen = [each for each in reader.connections if is_wanted(each.topic, each.msgtype)]
        for each in chosen:
            form, text = each.msgdef
            if form is MessageDefinitionFormat.NONE:  # then the type is as ROS 2 Jazzy has it
                text = get_typestore(Stores.ROS2_JAZZY).generate_msgdef(each.msgtype, ros_version=2)[0]
            encoding = "ros2idl" if form is MessageDefinitionFormat.IDL else "ros2msg"
            yield Schema(each.id, text.encode(), encoding, each.msgtype)
            yield Channel(each.id, each.topic, "cdr", {}, each.id)
        for connection, log_time, data in reader.messages(chosen) if chosen else ():
            yield connection.id, log_time, log_time, memoryview(data)
