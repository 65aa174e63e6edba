"""What can still be read of an MCAP file whose recording was cut short, or which was damaged later."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from quadftc_bags.directory import BagError
from quadftc_bags.mcap_records import Damage, NotMcapError, read_records

DEFINITIONS = ("ros2msg", "ros2idl")  # encodings of a type's definition that a bag may have

OnTopic = Callable[[int, Channel, Schema], None]
OnMessage = Callable[[int, int, int, memoryview], None]
OnRecord = Callable[["Attachment | Metadata"], None]


@dataclass
class Tally:
    """What was found of one topic: number of messages, first and last log time [ns]."""

    type_name: str
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0

    def add(self, log_time_ns: int) -> None:
        """Count a message."""
        self.first_ns = min(self.first_ns, log_time_ns) if self.count else log_time_ns
        self.last_ns = max(self.last_ns, log_time_ns) if self.count else log_time_ns
        self.count += 1


@dataclass
class Survey:
    """What a file holds.

    Parameters
    ----------
    path : Path
    size : int
        Of the file [bytes].
    topics : dict of str to Tally
        Topics that can be read, by full name.
    damages : list of Damage
        What cannot be read, in the order of the file.
    refused : dict of str to str
        Topics that no ROS 2 bag may have, with the reason.
    unknown : int
        Messages of a topic whose name is nowhere in the file, or that was refused.
    is_indexed : bool
        The file ends as it should, with an index.
    attachments : dict of str to bytes
    records : dict of str to dict
        Metadata records; of several with one name the last.
    """

    path: Path
    size: int
    topics: dict[str, Tally] = field(default_factory=dict[str, Tally])
    damages: list[Damage] = field(default_factory=list[Damage])
    refused: dict[str, str] = field(default_factory=dict[str, str])
    unknown: int = 0
    is_indexed: bool = False
    attachments: dict[str, bytes] = field(default_factory=dict[str, bytes])
    records: dict[str, dict[str, str]] = field(default_factory=dict[str, dict[str, str]])

    @property
    def messages(self) -> int:
        """How many messages can be read."""
        return sum(tally.count for tally in self.topics.values())

    @property
    def is_whole(self) -> bool:
        """Whether nothing is wrong with the file."""
        return self.is_indexed and not (self.damages or self.refused or self.unknown)


def survey(path: Path) -> Survey:
    """Look through a file.

    Raises
    ------
    BagError
        If it is not MCAP, or holds no topic that can be read; one line.
    """
    found = Survey(path, _size(path))

    def on_record(record: Attachment | Metadata) -> None:
        if isinstance(record, Attachment):
            found.attachments[record.name] = record.data
        else:
            found.records[record.name] = record.metadata

    names: dict[int, str] = {}

    def on_topic(number: int, channel: Channel, schema: Schema) -> None:
        names[number] = channel.topic
        found.topics.setdefault(channel.topic, Tally(schema.name))

    def on_message(number: int, log_time_ns: int, publish_time_ns: int, data: memoryview) -> None:
        found.topics[names[number]].add(log_time_ns)

    try:
        walk(found, on_topic, on_message, on_record)
    except OSError as error:
        raise BagError(f"{path}: {error.strerror or error}") from None
    if not found.topics:
        raise BagError(f"{path}: {_nothing(found)}")
    found.is_indexed = _is_indexed(path, found.messages)
    return found


def walk(found: Survey, on_topic: OnTopic, on_message: OnMessage, on_record: OnRecord) -> None:
    """Go through a file; ``found`` gets what cannot be read.

    Parameters
    ----------
    found : Survey
    on_topic : callable
        ``on_topic(number, channel, schema)`` before the first message of a channel.
    on_message : callable
        ``on_message(number, log time, publish time, data)`` [ns].
    on_record : callable
        Called with every attachment and metadata record.

    Raises
    ------
    BagError
        If the file is not MCAP.
    OSError
        If it cannot be read; and what the callables raise.
    """
    found.damages, found.unknown = [], 0
    channels = _Channels(found, on_topic)

    def checked(number: int, log_time_ns: int, publish_time_ns: int, data: memoryview) -> None:
        if number in channels.known:
            on_message(number, log_time_ns, publish_time_ns, data)
        else:
            found.unknown += 1

    try:
        with found.path.open("rb") as stream:
            for record in read_records(stream, checked, found.damages.append):
                if isinstance(record, (Attachment, Metadata)):
                    on_record(record)
                else:
                    channels.add(record)
    except NotMcapError:
        raise BagError(f"{found.path}: not an MCAP file") from None


class _Channels:
    """The channels met so far, and the definitions of their types."""

    def __init__(self, found: Survey, on_topic: OnTopic) -> None:
        self.known: set[int] = set()
        self._found, self._on_topic = found, on_topic
        self._schemas: dict[int, Schema] = {}
        self._types: dict[str, str] = {}  # by topic

    def add(self, record: Header | Schema | Channel) -> None:
        """Take a record; of those that come again, as in the index, the first counts."""
        if isinstance(record, Schema):
            self._schemas.setdefault(record.id, record)
        elif isinstance(record, Channel) and record.id not in self.known:
            schema = self._schemas.get(record.schema_id)
            reason = _unfit(record, schema, self._types)
            if reason or schema is None:
                self._found.refused[record.topic] = reason
                return
            self._types[record.topic] = schema.name
            self._on_topic(record.id, record, schema)
            self.known.add(record.id)


def _unfit(channel: Channel, schema: Schema | None, types: Mapping[str, str]) -> str:
    """Say why a ROS 2 bag cannot have a channel; empty if it can."""
    if channel.message_encoding != "cdr":
        return f"its messages are '{channel.message_encoding}', not cdr"
    if schema is None:
        return "the definition of its type is missing"
    if schema.encoding not in DEFINITIONS:
        return f"its type is defined in '{schema.encoding}', not {' or '.join(DEFINITIONS)}"
    if types.get(channel.topic, schema.name) != schema.name:
        return f"a part of it has another type, {schema.name}"
    return ""


def _nothing(found: Survey) -> str:
    """Say why there is nothing to keep."""
    if found.refused:
        topic, reason = next(iter(found.refused.items()))
        more = f" (and {len(found.refused) - 1} more topics)" if len(found.refused) > 1 else ""
        return f"nothing to repair: topic '{topic}': {reason}{more}"
    if found.damages:
        damage = found.damages[0]
        return (
            f"nothing to repair: it ends or breaks at byte {damage.offset} of {found.size}, before any topic"
        )
    return "nothing to repair: it has no topic"


def _is_indexed(path: Path, messages: int) -> bool:
    """Whether a file ends with a summary that counts its messages."""
    try:
        with path.open("rb") as stream:
            summary: Any = make_reader(stream).get_summary()
            return summary is not None and summary.statistics.message_count == messages
    except (McapError, ValueError, AttributeError, OSError, EOFError, OverflowError, MemoryError):
        return False
    except Exception:  # whatever else the library makes of an index that is cut
        return False


def _size(path: Path) -> int:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from None
    if size == 0:
        raise BagError(f"{path}: empty file")
    return size
