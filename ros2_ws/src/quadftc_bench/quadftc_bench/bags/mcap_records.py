"""The records of an MCAP file in file order, without an index, so that a file cut short can be read."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import BinaryIO, TypeAlias

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

Record: TypeAlias = Header | Schema | Channel | Attachment | Metadata
OnMessage = Callable[[int, int, int, memoryview], None]

_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_READERS: dict[int, Callable[[ReadDataStream], Record]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.METADATA: Metadata.read,
}
_DAMAGE = (McapError, struct.error, zstandard.ZstdError, RuntimeError, UnicodeDecodeError, ValueError)


class NotMcapError(ValueError):
    """The file does not begin like an MCAP file."""


class CutShortError(ValueError):
    """The file ends, or stops making sense, before its footer."""


def read_records(stream: BinaryIO, on_message: OnMessage) -> Iterator[Record]:
    """Yield all records but messages, which go to ``on_message(channel, log time, publish time, data)``.

    A chunk's records come where the chunk stands. Indexes and statistics are passed over.

    Raises
    ------
    NotMcapError
        If the file is not MCAP.
    CutShortError
        When the rest of the file is missing or damaged; all that came before is good.
    """
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise NotMcapError
    size = os.fstat(stream.fileno()).st_size
    while True:
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise CutShortError
        opcode, length = _HEAD.unpack(head)
        if opcode == Opcode.FOOTER:
            return
        if length > size - stream.tell():
            raise CutShortError
        if opcode == Opcode.CHUNK:
            yield from _read_sequence(_chunk_data(stream.read(length)), on_message)
        elif opcode == Opcode.MESSAGE or opcode in _READERS:
            yield from _read_sequence(head + stream.read(length), on_message)
        else:
            stream.seek(length, os.SEEK_CUR)


def _read_sequence(data: bytes, on_message: OnMessage) -> Iterator[Record]:
    """Read records that stand one after the other in memory."""
    view = memoryview(data)
    position = 0
    try:
        while position < len(data):
            opcode, length = _HEAD.unpack_from(data, position)
            start = position + _HEAD.size
            position = start + length
            if position > len(data):
                raise CutShortError
            if opcode == Opcode.MESSAGE:
                channel, _, log_time, publish_time = _MESSAGE.unpack_from(data, start)
                on_message(channel, log_time, publish_time, view[start + _MESSAGE.size : position])
            elif opcode in _READERS:
                yield _READERS[opcode](ReadDataStream(BytesIO(view[start:position])))
    except _DAMAGE as error:
        raise CutShortError from error


def _chunk_data(body: bytes) -> bytes:
    """Return the records inside a chunk, after checking their sum."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        if chunk.compression == "zstd":
            data = zstandard.decompress(chunk.data, chunk.uncompressed_size)
        elif chunk.compression == "lz4":
            data = bytes(lz4.frame.decompress(chunk.data))  # pyright: ignore
        else:
            data = chunk.data
    except _DAMAGE as error:
        raise CutShortError from error
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise CutShortError
    return data
