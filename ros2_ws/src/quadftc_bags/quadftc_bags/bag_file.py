# pyright: basic
"""One rosbag2 directory being written: ``metadata.yaml`` and one MCAP file, as rosbag2 Jazzy writes them.

Only ``sync``, which waits for the disk, may run in another thread than the caller's. After ``flush`` a killed
process loses nothing written before; after a ``sync`` that follows, nor does a power cut.
"""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from textwrap import indent
from types import SimpleNamespace
from typing import Any, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, Writer

from quadftc_bags.bag_format import COMPRESSIONS, TopicRecord, metadata_text

KEPT_BY_WRITER = "_Writer__chunk_indices"  # private list of the library's writer
_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json", ".txt": "text/plain"}


class _Flushed(NamedTuple):
    size: int  # bytes that the operating system has
    counts: dict[str, int]  # messages by topic
    span_ns: tuple[int, int] | None  # first and last log time [ns]


class BagFile:
    """Create a rosbag2 directory, else FileExistsError, and write messages to it.

    ``attachments`` are files to store inside the bag, by name. ``metadata`` becomes ``custom_data`` of the
    bag's metadata and an MCAP metadata record named ``quadftc``. A ``compression`` that is none of
    `COMPRESSIONS` is a ValueError. A chunk is closed when it has ``chunk_size`` bytes in messages. Every
    method but ``abandon`` raises OSError if it cannot write.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        attachments: Mapping[str, bytes],
        metadata: Mapping[str, str],
        compression: str,
        chunk_size: int,
    ) -> None:
        if compression not in COMPRESSIONS:
            raise ValueError(f"compression '{compression}': expected one of {', '.join(COMPRESSIONS)}")
        self.directory = Path(directory).resolve()
        try:
            self.directory.mkdir(parents=True)
        except FileExistsError as error:
            raise FileExistsError(f"bag directory {self.directory} exists already") from error
        self.path = self.directory / f"{self.directory.name}_0.mcap"
        self.counts: dict[str, int] = {}
        self._custom = dict(metadata)
        self._topics: list[TopicRecord] = []
        self._schemas: dict[str, int] = {}
        self._span_ns: tuple[int, int] | None = None
        self._flushed = _Flushed(0, {}, None)
        self._file = io.FileIO(self.path, "x")
        with suppress(OSError, ImportError):  # a system without locks; the lock ends with the process
            import fcntl

            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._chunk_size = chunk_size
        self._open_size = 0
        # Unbuffered, so that an error leaves nothing behind that would be written later; around a `RawIOBase`
        # itself the library puts a buffer. Chunks are closed by `flush` alone, so that their ends are known.
        write = partial(_write_all, self._file)
        output: Any = SimpleNamespace(write=write, tell=self._file.tell, flush=self._file.flush)
        self._writer = Writer(output, 2**63, CompressionType[compression.upper()])
        self._indices = ChunkIndices(self._writer, self.directory)
        self._writer.start("ros2", library="quadftc")
        self._add_own_record()
        if self._custom:
            self.add_record("quadftc", self._custom)
        for name, data in attachments.items():
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._writer.add_attachment(0, 0, name, media_type, data)
        self.flush()
        self.sync()

    def add_record(self, name: str, entries: Mapping[str, str]) -> None:
        """Add an MCAP metadata record."""
        self._writer.add_metadata(name, dict(entries))

    def add_topic(self, topic: TopicRecord) -> None:
        """Register a topic; channels are numbered from 1 in the order of calls."""
        if topic.type_name not in self._schemas:
            schema = self._writer.register_schema(topic.type_name, topic.encoding, topic.definition.encode())
            self._schemas[topic.type_name] = schema
        metadata = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.type_hash}
        self._writer.register_channel(topic.name, "cdr", self._schemas[topic.type_name], metadata)
        self._topics.append(topic)
        self.counts[topic.name] = 0

    def write(self, channel: int, log_time_ns: int, publish_time_ns: int, data: bytes) -> None:
        """Add a serialised message to the open chunk."""
        start, end = self._span_ns or (log_time_ns, log_time_ns)
        self._span_ns = min(start, log_time_ns), max(end, log_time_ns)
        self.counts[self._topics[channel - 1].name] += 1
        self._writer.add_message(channel, log_time_ns, data, publish_time_ns)
        self._open_size += len(data)
        if self._open_size >= self._chunk_size:
            self.flush()

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system."""
        self._writer.flush()
        self._open_size = 0
        self._flushed = _Flushed(self._file.tell(), dict(self.counts), self._span_ns)

    def sync(self) -> None:
        """Wait until the disk has what was flushed, and let ``metadata.yaml`` say what that is."""
        flushed = self._flushed
        os.fsync(self._file.fileno())
        self._write_metadata_file(flushed)

    def close(self) -> None:
        """Write the summary of the MCAP file and the final metadata."""
        self.flush()
        self._add_own_record()
        self._writer.finish()
        self._indices.close()
        self.sync()
        self._file.close()

    def abandon(self) -> None:
        """After an error: cut the file back to the last complete chunk and close it; raises nothing.

        The file can be read from its start to that chunk, and ``counts`` are what it holds.
        """
        size, counts, self._span_ns = self._flushed
        self.counts = {topic.name: counts.get(topic.name, 0) for topic in self._topics}
        self._indices.close()
        with suppress(OSError, ValueError):  # it may be closed
            self._file.truncate(size)
        with suppress(OSError):
            self._file.close()
        with suppress(OSError):
            self._write_metadata_file(self._flushed)

    def _add_own_record(self) -> None:
        self.add_record("rosbag2", {"serialized_metadata": self._metadata(self._flushed)})

    def _metadata(self, flushed: _Flushed) -> str:
        topics = [(topic, flushed.counts.get(topic.name, 0)) for topic in tuple(self._topics)]
        return metadata_text(self.path.name, topics, flushed.span_ns, self._custom)

    def _write_metadata_file(self, flushed: _Flushed) -> None:
        target = self.directory / "metadata.yaml"
        part = target.with_suffix(".yaml.part")
        try:
            with part.open("w", encoding="utf-8") as stream:
                stream.write("rosbag2_bagfile_information:\n" + indent(self._metadata(flushed), "  "))
                stream.flush()
                os.fsync(stream.fileno())
            part.replace(target)
        except OSError:
            part.unlink(missing_ok=True)
            raise


def is_being_written(path: Path) -> bool:
    """Return whether a process of this machine has the file of a bag open as a `BagFile`."""
    try:
        import fcntl

        with path.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (OSError, ImportError) as error:  # another one: the file cannot be opened, or there are no locks
        return isinstance(error, BlockingIOError)
    return False


def _write_all(file: io.RawIOBase, data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


class ChunkIndices:
    """The index of the chunks in a nameless file; a new ``writer`` has a list that grows by 20 MB an hour.

    RuntimeError if the writer of this version of the library has no such list.
    """

    def __init__(self, writer: Writer, directory: Path) -> None:
        kept: Any = getattr(writer, KEPT_BY_WRITER, None)
        if kept != []:
            raise RuntimeError(f"mcap.writer.Writer has no {KEPT_BY_WRITER}")
        self._file: Any = tempfile.TemporaryFile(dir=directory, buffering=0)  # noqa: SIM115
        self.close = self._file.close
        setattr(writer, KEPT_BY_WRITER, self)

    def append(self, index: ChunkIndex) -> None:
        """Keep one entry, serialised."""
        builder = RecordBuilder()
        index.write(builder)
        _write_all(self._file, builder.end())

    def __iter__(self) -> Iterator[ChunkIndices]:
        """Yield one object whose `write` writes all entries."""
        yield self

    def write(self, builder: RecordBuilder) -> None:
        """Write all entries, in order."""
        self._file.seek(0)
        while data := self._file.read(1 << 20):
            builder.write(data)
