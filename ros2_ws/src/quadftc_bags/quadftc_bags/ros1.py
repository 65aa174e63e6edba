r"""ROS 1 bags (version 2.0) as records like those of ROS 2: definitions without ``seq``, messages in CDR.

    #ROSBAG V2.0\n, then records:  length u32 | header | length u32 | data
    header:  for each field:  length u32 | name=value

All is little-endian. The file is read in its order, without the index at its end, so that a bag that was cut
short can be read; the reader of rosbags needs the index. Its types turn the messages into CDR.
Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame  # pyright: ignore[reportMissingTypeStubs]
from mcap.records import Channel, Schema
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype
from rosbags.typesys.store import Typestore

from quadftc_bags.storage import BagError, Damage, IsWanted, Message, Record, bag_errors

ROS1_MAGIC = b"#ROSBAG V2.0\n"
_LENGTH, _TIME = struct.Struct("<I"), struct.Struct("<II")
_MESSAGE, _BAG, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 5, 6, 7  # values of the field op
HEADER, TIMES = "std_msgs/msg/Header", ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_LARGEST = 1 << 30  # bytes of a chunk; a greater one is damage


def is_ros1(path: Path) -> bool:
    """Whether a file is a ROS 1 bag of version 2.0."""
    with path.open("rb") as stream:
        return stream.read(len(ROS1_MAGIC)) == ROS1_MAGIC


def read_ros1(path: Path, is_wanted: IsWanted) -> Iterator[Record]:
    """Yield schemas, channels and messages of the wanted topics, as `read_records` does of MCAP.

    What is damaged comes as a `Damage`. BagError if the file cannot be read or is no such bag.
    """
    with bag_errors(path), path.open("rb") as stream:
        if stream.read(len(ROS1_MAGIC)) != ROS1_MAGIC:
            raise BagError(f"{path}: not a ROS 1 bag of version 2.0")
        yield from _read_file(stream, _Topics(is_wanted))


class _Topics:
    """The topics of a bag, and how their messages become CDR."""

    def __init__(self, is_wanted: IsWanted) -> None:
        self.is_wanted = is_wanted
        self._converters: dict[int, Callable[[memoryview], memoryview] | None] = {}

    def learn(self, header: dict[str, bytes], data: bytes) -> Iterator[Record]:
        """Take a connection; those that come again are known."""
        number, topic = _LENGTH.unpack(header["conn"])[0], header["topic"].decode("utf-8", "replace")
        if number in self._converters:
            return
        fields = _fields(data)
        kind = normalize_msgtype(fields["type"].decode("utf-8", "replace"))
        self._converters[number] = None
        if self.is_wanted(topic, kind):
            store = _types(fields["message_definition"].decode("utf-8", "replace"), kind)
            self._converters[number] = lambda raw: store.ros1_to_cdr(raw, kind)
            text = store.generate_msgdef(kind, ros_version=2)[0]
            yield Schema(number + 1, text.encode(), "ros2msg", kind)
            yield Channel(number, topic, "cdr", {}, number + 1)

    def message(self, header: dict[str, bytes], data: memoryview) -> Message | None:
        """Turn a message into CDR; None if its topic is not wanted."""
        number = _LENGTH.unpack(header["conn"])[0]
        seconds, nanoseconds = _TIME.unpack(header["time"])
        if (convert := self._converters[number]) is None:
            return None
        time_ns = seconds * 1_000_000_000 + nanoseconds
        return number, time_ns, time_ns, convert(data)


def _types(text: str, kind: str) -> Typestore:
    """Types that a definition defines, with headers as ROS 2 has them; rosbags drops ``seq`` then."""
    types = get_types_from_msg(text, kind)
    if HEADER in types:
        constants, fields = types[HEADER]
        types[HEADER] = (constants, [field for field in fields if field[0] != "seq"])
    present = get_typestore(Stores.ROS2_JAZZY).fielddefs
    store = get_typestore(Stores.EMPTY)
    store.register({name: present[name] for name in TIMES} | types)
    return store


def _fields(data: bytes | memoryview) -> dict[str, bytes]:
    """Fields of a header."""
    found, at, data = dict[str, bytes](), 0, bytes(data)
    while at < len(data):
        end = at + _LENGTH.size + _LENGTH.unpack_from(data, at)[0]
        if end > len(data):
            raise ValueError("a field is longer than its header")
        name, _, value = data[at + _LENGTH.size : end].partition(b"=")
        found[name.decode("ascii")] = value
        at = end
    return found


def _read_file(stream: BinaryIO, topics: _Topics) -> Iterator[Record]:
    size, missing = os.fstat(stream.fileno()).st_size, 0  # chunks of which the index has still to tell
    while (offset := stream.tell()) < size:
        header, data, is_cut = dict[str, bytes](), b"", False
        try:
            header = _fields(_block(stream)[0])
            data, is_cut = _block(stream)
            if header["op"] == bytes([_CHUNK]):
                yield from _read_chunk(header, data, topics)
            elif header["op"] == bytes([_BAG]):  # whose index begins at 0 if the bag was never closed
                missing = _LENGTH.unpack(header["chunk_count"])[0] + (not any(header["index_pos"]))
            elif header["op"] == bytes([_CHUNK_INFO]):
                missing -= 1
            elif not is_cut:
                yield from _read_record(header, memoryview(data), topics)
            if is_cut:
                raise EOFError
        except Exception:  # whatever the libraries find wrong
            is_end = is_cut or not data  # else the next record may be good
            yield Damage(offset, (size if is_end else stream.tell()) - offset, is_end, False, None)
            if is_end:
                return
    if missing > 0:
        yield Damage(size, 0, True, True, None)


def _block(stream: BinaryIO) -> tuple[bytes, bool]:
    """Bytes behind their length, and whether some are missing at the end of the file."""
    length = _LENGTH.unpack(stream.read(_LENGTH.size))[0]
    data = stream.read(length)
    return data, len(data) < length


def _read_chunk(header: dict[str, bytes], data: bytes, topics: _Topics) -> Iterator[Record]:
    """Yield the records of a chunk, of one that is cut those before the cut; ValueError then."""
    view, at = memoryview(_unpack(data, header["compression"], _LENGTH.unpack(header["size"])[0])), 0
    while at < len(view):
        parts: list[memoryview] = []
        for _ in range(2):
            end = at + _LENGTH.size + _LENGTH.unpack_from(view, at)[0]
            if end > len(view):
                raise ValueError("the last record is cut")
            parts.append(view[at + _LENGTH.size : end])
            at = end
        yield from _read_record(_fields(parts[0]), parts[1], topics)


def _unpack(data: bytes, how: bytes, length: int) -> bytes:
    if length > _LARGEST:
        raise ValueError("a chunk is too large")
    if how == b"bz2":
        return bz2.BZ2Decompressor().decompress(data, length)
    if how == b"lz4":
        unpacker: Any = lz4.frame.LZ4FrameDecompressor()
        return unpacker.decompress(data, length)
    return data


def _read_record(header: dict[str, bytes], data: memoryview, topics: _Topics) -> Iterator[Record]:
    operation = header["op"]
    if operation == bytes([_CONNECTION]):
        yield from topics.learn(header, bytes(data))
    elif operation == bytes([_MESSAGE]) and (message := topics.message(header, data)):
        yield message
