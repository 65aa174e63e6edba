# pyright: basic
"""An MCAP writer whose memory does not grow with its file.

`mcap.writer.Writer` keeps an entry of 1.5 kB for each chunk until the file is finished: 20 MB an hour, as
chunks are closed four times a second so that a killed recorder loses little. Here they are kept in a file
without a name, beside the one that is written.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import Writer

KEPT_BY_WRITER = "_Writer__chunk_indices"  # private; `frugal` looks whether it is there


class ChunkIndices:
    """What the writer takes for its list: serialises what is appended, and writes all of it at once.

    Parameters
    ----------
    directory : Path
        Where to keep it.

    Raises
    ------
    OSError
        If it cannot be kept; from `append`, too.
    """

    def __init__(self, directory: Path) -> None:
        self._file: BinaryIO = tempfile.TemporaryFile(dir=directory, buffering=0)  # noqa: SIM115

    def append(self, index: ChunkIndex) -> None:
        """Keep one."""
        builder = RecordBuilder()
        index.write(builder)
        rest = memoryview(builder.end())
        while rest:
            rest = rest[self._file.write(rest) :]

    def __iter__(self) -> Iterator[ChunkIndices]:
        """Give what `write` writes, as if it were one entry."""
        yield self

    def write(self, builder: RecordBuilder) -> None:
        """Write all entries, in order."""
        self._file.seek(0)
        while data := self._file.read(1 << 20):
            builder.write(data)

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()


def frugal(writer: Writer, directory: Path) -> ChunkIndices:
    """Let a new writer keep the index of its chunks in a file in a directory; return it, to be closed.

    Raises
    ------
    RuntimeError
        If the writer of this version of the library has no such index.
    OSError
        If there can be no file.
    """
    kept: Any = getattr(writer, KEPT_BY_WRITER, None)
    if kept != []:
        raise RuntimeError(f"mcap.writer.Writer has no {KEPT_BY_WRITER}")
    indices = ChunkIndices(directory)
    setattr(writer, KEPT_BY_WRITER, indices)
    return indices
