"""Logs in a ZIP archive, or compressed by gzip or Zstandard, unpacked block by block up to a limit.

Of an archive only the log is unpacked. With several logs in it, one has to be chosen; with only one, the
choice is one of the logs in that file. An archive that was cut has lost the list of its files, which stands
at its end; the first log is taken.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import IO

import zstandard

from quadftc_bags.bag import BagError
from quadftc_replay.readers.contents import HEAD, list_some

ZIP, GZIP, ZSTANDARD = b"PK\x03\x04", b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
ENTRY = struct.Struct("<4s4sH8s2I2H")  # of a file: signature, method, size packed, length of name and more
PACKED = (ZIP, GZIP, ZSTANDARD)
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others unpack any amount at a time
BLOCK = 1 << 16  # bytes unpacked at a time, so that damage costs no more of what is before it
FREE, RATIO = 64 << 20, 100  # bytes that any log may have unpacked, and more of a packed byte
LARGEST = 8 << 30  # bytes
WINDOW = 1 << 27  # bytes that Zstandard may keep
CUT = "cut or damaged"
MOST_FILES = 1000  # of an archive that are looked at
SHOWN = 10  # of them in one line
DAMAGE = (
    *(OSError, EOFError, NotImplementedError, RuntimeError, ValueError),
    *(zlib.error, zipfile.BadZipFile, zstandard.ZstdError),
)


def unpack(
    path: Path, directory: Path, log: int, is_log: Callable[[bytes], bool]
) -> tuple[Path, int, tuple[str, ...]]:
    """Unpack a log into a directory, of damaged data what comes before the damage.

    Returns the file, which of the logs in it is meant (0: the only one), and notes.

    ``log`` is one of several logs. BagError if there is none, more than one to choose from, or too much.
    """
    file, inner, said = directory / path.name, log, ""
    try:
        with path.open("rb") as stream:
            head = stream.read(len(ZIP))
            stream.seek(0)
            if head == ZIP and zipfile.is_zipfile(stream):
                archive = zipfile.ZipFile(stream)
                entry, inner = _choose(archive, path, log, is_log)
                said, blocks = f"{entry.filename} in the archive", _read_entry(archive, entry)
            elif head == ZIP:
                blocks = _read_first_log(stream, is_log)
            else:
                blocks = _read_gzip(stream) if head.startswith(GZIP) else _read_zstandard(stream)
            problem = _store(blocks, file, path)
    except DAMAGE as error:
        if isinstance(error, BagError):
            raise
        raise BagError(f"{path}: cannot be unpacked: {_words(error)}") from None
    cut = f"{CUT} where it is packed: {problem}; read up to there" if problem else ""
    return file, inner, tuple(filter(None, (said, cut)))


def _choose(
    archive: zipfile.ZipFile, path: Path, log: int, is_log: Callable[[bytes], bool]
) -> tuple[zipfile.ZipInfo, int]:
    """Choose a log of an archive; return it, and which of the logs in it is meant."""
    entries = [entry for entry in archive.infolist() if entry.file_size]
    readable = [entry for entry in entries if entry.compress_type in METHODS][:MOST_FILES]
    logs = [entry for entry in readable if is_log(_head(archive, entry))]
    if not logs:
        raise BagError(f"{path}: a ZIP archive without a log that can be read; it holds {_list(entries)}")
    if len(logs) == 1:
        return logs[0], log
    if not 0 < log <= len(logs):
        problem = f"log {log} of {len(logs)}" if log else f"{len(logs)} logs"
        raise BagError(
            f"{path}: {problem} in the archive; choose one with --log: {_list(logs, numbered=True)}"
        )
    return logs[log - 1], 0


def _head(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    with archive.open(entry) as source:
        return source.read(HEAD)


def _read_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    with archive.open(entry) as source:
        while block := source.read(BLOCK):
            yield block


def _read_first_log(stream: IO[bytes], is_log: Callable[[bytes], bool]) -> Iterator[bytes]:
    """Unpack the first log of an archive without a list of files; EOFError at the cut."""
    at = 0
    while True:
        stream.seek(at)
        header = stream.read(ENTRY.size)
        if len(header) < ENTRY.size or not header.startswith(ZIP):
            raise EOFError("the list of files at the end of the archive is missing, and no log is before it")
        _, _, method, _, size, _, name, extra = ENTRY.unpack(header)
        at += ENTRY.size + name + extra
        stream.seek(at)
        blocks = _inflate(stream) if method == zipfile.ZIP_DEFLATED else iter(lambda: stream.read(BLOCK), b"")
        if is_log((first := next(blocks, b""))[:HEAD]):
            yield first
            yield from blocks
            raise EOFError("the list of files at the end of the archive is missing")
        at += size


def _inflate(stream: IO[bytes]) -> Iterator[bytes]:
    member = zlib.decompressobj(-zlib.MAX_WBITS)
    while not member.eof and (block := member.unconsumed_tail or stream.read(BLOCK)):
        yield member.decompress(block, BLOCK)


def _read_gzip(stream: IO[bytes]) -> Generator[bytes, None, None]:
    member, block = zlib.decompressobj(31), stream.read(BLOCK)
    while block:
        yield member.decompress(block, BLOCK)
        block = member.unconsumed_tail or member.unused_data or stream.read(BLOCK)
        if member.eof:
            block = (member.unused_data or stream.read(BLOCK)).lstrip(b"\0")  # some tools fill up with zeros
            if block:
                member = zlib.decompressobj(31)
    if not member.eof:
        raise EOFError("the end is missing")


def _read_zstandard(stream: IO[bytes]) -> Iterator[bytes]:
    size = zstandard.frame_content_size(stream.read(64))  # -1: not known
    stream.seek(0)
    reader = zstandard.ZstdDecompressor(max_window_size=WINDOW).stream_reader(stream, read_across_frames=True)
    while block := reader.read(BLOCK):
        size -= len(block)
        yield block
    if size > 0:
        raise EOFError(f"the last {size} bytes are missing")


def _store(blocks: Iterator[bytes], file: Path, path: Path) -> str:
    """Write blocks into a file; return what ended them too early, empty if nothing did."""
    limit = min(FREE + RATIO * path.stat().st_size, LARGEST)
    written = 0
    with file.open("wb") as target:
        try:
            for block in blocks:
                written += len(block)
                if written > limit:
                    raise BagError(f"{path}: more than {limit >> 20} MiB unpacked; expected a log")
                target.write(block)
        except DAMAGE as error:
            if isinstance(error, BagError) or not written:
                raise
            return _words(error)
    return ""


def _list(entries: list[zipfile.ZipInfo], *, numbered: bool = False) -> str:
    names = [f"{number} {each.filename}" for number, each in enumerate(entries, 1)]
    return list_some(names if numbered else [each.filename for each in entries], SHOWN)


def _words(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
