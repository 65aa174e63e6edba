"""What can still be read of an MCAP file whose recording was cut short, or which was damaged later."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Metadata, Schema

from quadftc_bags.storage import BagError, Damage, check_size, read_records

DEFINITIONS = ("ros2msg", "ros2idl")  # encodings of a type's definition that a bag may have


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
    """What a file holds, and what of it cannot be read."""

    path: Path
    size: int  # bytes
    topics: dict[str, Tally] = field(default_factory=dict[str, Tally])  # that can be read, by full name
    channels: dict[int, tuple[Channel, Schema]] = field(default_factory=dict[int, tuple[Channel, Schema]])
    damages: list[Damage] = field(default_factory=list[Damage])  # in the order of the file
    refused: dict[str, str] = field(default_factory=dict[str, str])  # topics unfit for ROS 2: the reason
    unknown: int = 0  # messages of a topic that was refused, or whose name is nowhere in the file
    is_indexed: bool = False  # the file ends as it should, with an index
    attachments: dict[str, bytes] = field(default_factory=dict[str, bytes])
    records: dict[str, dict[str, str]] = field(default_factory=dict[str, dict[str, str]])  # metadata records

    @property
    def messages(self) -> int:
        """How many messages can be read."""
        return sum(tally.count for tally in self.topics.values())

    @property
    def is_whole(self) -> bool:
        """Whether nothing is wrong with the file."""
        return self.is_indexed and not (self.damages or self.refused or self.unknown)


def survey(path: Path) -> Survey:
    """Look through a file; BagError if it is not MCAP, or holds no topic that can be read."""
    found = Survey(path, check_size(path))
    schemas: dict[int, Schema] = {}
    for record in read_records(path, found.damages.append):
        if isinstance(record, tuple):
            _count_message(found, *record[:2])
        elif isinstance(record, Attachment):
            found.attachments[record.name] = record.data
        elif isinstance(record, Metadata):
            found.records[record.name] = record.metadata
        elif isinstance(record, Schema):
            schemas.setdefault(record.id, record)  # of those that come again, as in the index, the first
        elif isinstance(record, Channel) and record.id not in found.channels:
            _add_channel(found, record, schemas.get(record.schema_id))
    if not found.topics:
        raise BagError(f"{path}: {_nothing(found)}")
    found.is_indexed = _is_indexed(path, found.messages)
    return found


def _count_message(found: Survey, channel: int, log_time_ns: int) -> None:
    if channel in found.channels:
        found.topics[found.channels[channel][0].topic].add(log_time_ns)
    else:
        found.unknown += 1


def _add_channel(found: Survey, channel: Channel, schema: Schema | None) -> None:
    reason = _unfit(found, channel, schema)
    if reason or schema is None:
        found.refused[channel.topic] = reason
    else:
        found.channels[channel.id] = channel, schema
        found.topics.setdefault(channel.topic, Tally(schema.name))


def _unfit(found: Survey, channel: Channel, schema: Schema | None) -> str:
    """Say why a ROS 2 bag cannot have a channel; empty if it can."""
    if channel.message_encoding != "cdr":
        return f"its messages are '{channel.message_encoding}', not cdr"
    if schema is None:
        return "the definition of its type is missing"
    if schema.encoding not in DEFINITIONS:
        return f"its type is defined in '{schema.encoding}', not {' or '.join(DEFINITIONS)}"
    if channel.topic in found.topics and found.topics[channel.topic].type_name != schema.name:
        return f"a part of it has another type, {schema.name}"
    return ""


def _nothing(found: Survey) -> str:
    """Say why there is nothing to keep."""
    if found.refused:
        topic, reason = next(iter(found.refused.items()))
        more = f" (and {len(found.refused) - 1} more topics)" if len(found.refused) > 1 else ""
        return f"nothing to repair: topic '{topic}': {reason}{more}"
    if found.damages:
        at = f"byte {found.damages[0].offset} of {found.size}"
        return f"nothing to repair: it ends or breaks at {at}, before any topic"
    return "nothing to repair: it has no topic"


def _is_indexed(path: Path, messages: int) -> bool:
    """Whether a file ends with a summary that counts its messages."""
    try:
        with path.open("rb") as stream:
            summary: Any = make_reader(stream).get_summary()
            return summary is not None and summary.statistics.message_count == messages
    except Exception:  # whatever the library makes of an index that is cut
        return False
