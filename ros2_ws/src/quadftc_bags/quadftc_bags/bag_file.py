# pyright: basic
"""One rosbag2 directory being written: ``metadata.yaml`` and one MCAP file, as rosbag2 Jazzy writes them.

Everything here happens in the caller's thread; only ``sync``, which waits for the disk, may run in another.
After ``flush`` a killed process loses nothing written before; after a ``sync`` that follows, nor does a power
cut.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, Writer

from quadftc_bags.bag_format import COMPRESSIONS, BagSummary, TopicRecord, bag_information, metadata_file

KEPT_BY_WRITER = "_Writer__chunk_indices"  # private list of the library's writer
_Kept: TypeAlias = "tuple[int, dict[str, int], tuple[int, int] | None]"  # bytes, messages by topic, log times
_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json", ".txt": "text/plain"}


class BagFile:
    """Create a rosbag2 directory and write messages to it.

    Parameters
    ----------
    directory : path
        Must not exist; its parents are made.
    attachments : mapping of str to bytes
        Files to store inside the bag, by name.
    metadata : mapping of str to str
        Entries for ``custom_data`` of the bag's metadata and for an MCAP metadata record named ``quadftc``.
    compression : str
        ``zstd``, ``lz4`` or ``none``.
    chunk_size : int
        A chunk with this much in messages is closed [bytes].

    Raises FileExistsError if the directory exists; ValueError if the compression is unknown; OSError if the
    directory cannot be written; the same from every other method.
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
        self._span: tuple[int, int] | None = None  # first and last log time [ns]
        self._kept: _Kept = (0, {}, None)
        self._output = _Output(self.path)
        self._chunk_size = chunk_size
        self._open_size = 0
        never = 2**63  # bytes; chunks are closed by flush alone, so that it is known where the last one ends
        self._writer = Writer(self._output, never, CompressionType[compression.upper()])  # type: ignore[arg-type]
        self._indices = keep_indices_in_file(self._writer, self.directory)
        self._writer.start("ros2", library="quadftc")
        self._writer.add_metadata(
            "rosbag2", {"serialized_metadata": bag_information(self._summary(self._kept))}
        )
        if self._custom:
            self._writer.add_metadata("quadftc", self._custom)
        for name, data in attachments.items():
            media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._writer.add_attachment(0, 0, name, media_type, data)
        self.flush()
        self.sync()

    def add_record(self, name: str, entries: Mapping[str, str]) -> None:
        """Add an MCAP metadata record."""
        self._writer.add_metadata(name, dict(entries))

    def add_topic(self, topic: TopicRecord, definition: str, encoding: str = "ros2msg") -> None:
        """Register a topic with its type's definition; channels are numbered from 1 in the order of calls."""
        if topic.type_name not in self._schemas:
            schema = self._writer.register_schema(topic.type_name, encoding, definition.encode())
            self._schemas[topic.type_name] = schema
        self._writer.register_channel(
            topic.name,
            "cdr",
            self._schemas[topic.type_name],
            {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.type_hash},
        )
        self._topics.append(topic)
        self.counts[topic.name] = 0

    def write(self, channel: int, log_time_ns: int, publish_time_ns: int, data: bytes) -> None:
        """Add a serialised message to the open chunk."""
        start, end = self._span or (log_time_ns, log_time_ns)
        self._span = min(start, log_time_ns), max(end, log_time_ns)
        self.counts[self._topics[channel - 1].name] += 1
        self._writer.add_message(channel, log_time_ns, data, publish_time_ns)
        self._open_size += len(data)
        if self._open_size >= self._chunk_size:
            self.flush()

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system."""
        self._writer.flush()
        self._open_size = 0
        self._kept = (self._output.tell(), dict(self.counts), self._span)

    def sync(self) -> None:
        """Wait until the disk has what was flushed, and let ``metadata.yaml`` say what that is."""
        kept = self._kept
        self._output.sync()
        self._write_metadata_file(kept)

    def close(self) -> None:
        """Write the summary of the MCAP file and the final metadata."""
        self.flush()
        self._writer.add_metadata(
            "rosbag2", {"serialized_metadata": bag_information(self._summary(self._kept))}
        )
        self._writer.finish()
        self._indices.close()
        self.sync()
        self._output.close()

    def abandon(self) -> None:
        """After an error: cut the file back to the last complete chunk and close it; raises nothing.

        The file can be read from its start to that chunk, and ``counts`` are what it holds.
        """
        size, counts, self._span = self._kept
        self.counts = {topic.name: counts.get(topic.name, 0) for topic in self._topics}
        self._indices.close()
        with suppress(OSError):
            self._output.truncate(size)
        with suppress(OSError):
            self._output.close()
        with suppress(OSError):
            self._write_metadata_file(self._kept)

    def _summary(self, kept: _Kept) -> BagSummary:
        _, counts, span = kept
        topics = [(topic, counts.get(topic.name, 0)) for topic in tuple(self._topics)]
        distro = os.environ.get("ROS_DISTRO", "jazzy")
        start_ns, end_ns = span or (0, 0)
        return BagSummary(self.path.name, topics, start_ns, end_ns, self._custom, distro)

    def _write_metadata_file(self, kept: _Kept) -> None:
        target = self.directory / "metadata.yaml"
        partial = target.with_suffix(".yaml.part")
        try:
            with partial.open("w", encoding="utf-8") as stream:
                stream.write(metadata_file(self._summary(kept)))
                stream.flush()
                os.fsync(stream.fileno())
            partial.replace(target)
        except OSError:
            with suppress(OSError):
                partial.unlink()
            raise


def is_being_written(path: Path) -> bool:
    """Return whether a process of this machine has the file of a bag open as a `BagFile`.

    Raises OSError if it cannot be opened.
    """
    with path.open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            return False
    return False


class _Output:
    """A new file without a buffer, so that an error leaves nothing behind that would be written later.

    It is locked for as long as it is open, which ends with the process.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        with suppress(OSError):  # a file system without locks
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._position = 0

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            count = os.write(self._descriptor, rest)
            self._position += count
            rest = rest[count:]
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def sync(self) -> None:
        os.fsync(self._descriptor)

    def truncate(self, size: int) -> None:
        os.ftruncate(self._descriptor, size)

    def close(self) -> None:
        os.close(self._descriptor)


class ChunkIndices:
    """The index of the chunks, kept in a nameless file in a directory; it takes the place of a list.

    The library's writer keeps 1.5 kB for each chunk until the file is finished: 20 MB an hour, as chunks are
    closed four times a second. Every method raises OSError if the file cannot be written.
    """

    def __init__(self, directory: Path) -> None:
        self._file: BinaryIO = tempfile.TemporaryFile(dir=directory, buffering=0)  # noqa: SIM115

    def append(self, index: ChunkIndex) -> None:
        """Keep one entry, serialised."""
        builder = RecordBuilder()
        index.write(builder)
        rest = memoryview(builder.end())
        while rest:
            rest = rest[self._file.write(rest) :]

    def __iter__(self) -> Iterator[ChunkIndices]:
        """Yield one object whose `write` writes all entries."""
        yield self

    def write(self, builder: RecordBuilder) -> None:
        """Write all entries, in order."""
        self._file.seek(0)
        while data := self._file.read(1 << 20):
            builder.write(data)

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()


def keep_indices_in_file(writer: Writer, directory: Path) -> ChunkIndices:
    """Let a new writer keep the index of its chunks in a file; return it, to be closed.

    Raises RuntimeError if the writer of this version of the library has no such index.
    """
    kept: Any = getattr(writer, KEPT_BY_WRITER, None)
    if kept != []:
        raise RuntimeError(f"mcap.writer.Writer has no {KEPT_BY_WRITER}")
    indices = ChunkIndices(directory)
    setattr(writer, KEPT_BY_WRITER, indices)
    return indices
