"""The records of an MCAP file in file order, without an index, so that a file cut short can be read."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple, TypeAlias

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

Record: TypeAlias = Header | Schema | Channel | Attachment | Metadata
OnMessage = Callable[[int, int, int, memoryview], None]

_NONE = 0  # no opcode: what a file is full of that lost its end with the power
_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_LATEST = 2**63 - 1  # ns; a later time is none
_CHUNK_SPAN = struct.Struct("<QQ")  # first and last log time, with which a chunk begins
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


class Damage(NamedTuple):
    """A part of a file that cannot be read.

    Parameters
    ----------
    offset, size : int
        Where it begins, and its length [bytes].
    is_end : bool
        The file ends with it.
    is_index : bool
        It lies behind the messages: none is lost with it.
    span_ns : tuple of int, optional
        First and last log time of a chunk [ns], as far as its beginning is there.
    """

    offset: int
    size: int
    is_end: bool
    is_index: bool
    span_ns: tuple[int, int] | None


OnDamage = Callable[[Damage], None]


def read_records(
    stream: BinaryIO, on_message: OnMessage, on_damage: OnDamage | None = None
) -> Iterator[Record]:
    """Yield all records but messages, which go to ``on_message(channel, log time, publish time, data)``.

    A chunk's records come where the chunk stands. Indexes and statistics are passed over. With ``on_damage``
    so is a chunk whose sum is wrong, after it was told of it, and it is told of an end that is missing.

    Raises
    ------
    NotMcapError
        If the file is not MCAP.
    CutShortError
        Without ``on_damage``, when the rest of the file is missing or damaged; all that came before is good.
    """
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise NotMcapError
    size = os.fstat(stream.fileno()).st_size
    is_index = False
    while True:
        offset = stream.tell()
        head = stream.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (_NONE, 0)
        if opcode == Opcode.FOOTER:
            return
        if opcode == _NONE or length > size - stream.tell():
            rest = stream.read(_CHUNK_SPAN.size)
            damage = Damage(offset, size - offset, True, is_index, _chunk_span(opcode, rest))
            _report(damage, on_damage)
            return
        if opcode != Opcode.CHUNK and opcode != Opcode.MESSAGE and opcode not in _READERS:
            stream.seek(length, os.SEEK_CUR)
            is_index = is_index or opcode == Opcode.DATA_END
            continue
        body = stream.read(length)
        try:
            yield from _read_sequence(
                _chunk_data(body) if opcode == Opcode.CHUNK else head + body, on_message
            )
        except CutShortError:
            span_ns = _chunk_span(opcode, body)
            _report(Damage(offset, _HEAD.size + length, False, is_index, span_ns), on_damage)


def _report(damage: Damage, on_damage: OnDamage | None) -> None:
    if on_damage is None:
        raise CutShortError
    on_damage(damage)


def _chunk_span(opcode: int, body: bytes) -> tuple[int, int] | None:
    """First and last log time of a chunk [ns]."""
    if opcode != Opcode.CHUNK or len(body) < _CHUNK_SPAN.size:
        return None
    first, last = _CHUNK_SPAN.unpack_from(body)
    return (first, last) if 0 < first <= last else None


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
                if log_time > _LATEST or publish_time > _LATEST:
                    raise CutShortError
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
