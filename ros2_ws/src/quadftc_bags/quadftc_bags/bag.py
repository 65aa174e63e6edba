"""Reading bags: any rosbag2 bag (MCAP or SQLite) or ROS 1 bag, whole topics as NumPy arrays.

>>> bag = read_bag("out/paper_faults-proposed")
>>> imu = bag.series("imu/data")
>>> imu.stamp_ns, imu["angular_velocity"]   # (n,), (n, 3)

`quadftc_bags.cdr.arrays` says how the fields of a message become arrays.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path

import numpy as np
from mcap.records import Attachment, Channel, Metadata, Schema
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from quadftc_bags.cdr.arrays import Arrays, Column, decode_topic
from quadftc_bags.ros1 import is_ros1, read_ros1
from quadftc_bags.storage import (
    BagError,
    Damage,
    IsWanted,
    Record,
    is_sqlite,
    open_sqlite,
    read_records,
    read_sqlite,
    storage_files,
)

__all__ = ["Bag", "BagError", "Series", "TopicInfo", "bag_topics", "read_bag"]


@dataclass(frozen=True)
class Series:
    """All messages of one topic, in the order of log time; ``series[name]`` is one field over all of them."""

    topic: str  # full name
    type_name: str
    stamp_ns: NDArray[np.int64]  # (n,) the stamp each message begins with [ns]; the log time if it has none
    log_time_ns: NDArray[np.int64]  # (n,) when it was recorded [ns]
    fields: Mapping[str, Column]  # (n, ...) each, units as in the message

    def __len__(self) -> int:
        return len(self.log_time_ns)

    def __getitem__(self, name: str) -> Column:
        try:
            return self.fields[name]
        except KeyError:
            known = ", ".join(self.fields) or "none, as there is no message"
            raise BagError(f"topic '{self.topic}' has no field '{name}'; fields: {known}") from None


@dataclass
class TopicInfo:
    """A topic of a bag, and the messages of it that were kept, in the order of the file."""

    name: str  # full
    type_name: str
    count: int = 0  # messages in the bag
    first_ns: int = 0  # log times of its first and last message [ns]; 0 without messages
    last_ns: int = 0
    qos: str = ""  # offered quality of service (a YAML list)
    type_hash: str = ""
    encoding: str = "cdr"  # of the messages
    definition: Schema | None = None  # of the type
    messages: list[bytes] = field(default_factory=list[bytes])
    log_times: array[int] = field(default_factory=lambda: array("q"))  # [ns]

    def add(self, log_time: int, data: memoryview, *, keep: bool) -> None:
        """Count a message, and keep it if asked to."""
        self.first_ns = min(self.first_ns, log_time) if self.count else log_time
        self.last_ns = max(self.last_ns, log_time) if self.count else log_time
        self.count += 1
        if keep:
            self.messages.append(bytes(data))
            self.log_times.append(log_time)

    def decode(self) -> Arrays:
        """Return the fields of the messages that were kept; ValueError if they are of another type."""
        if self.encoding != "cdr":
            raise ValueError(f"message encoding '{self.encoding}', expected cdr")
        if self.definition is None:
            raise ValueError("the definition of its type is missing")
        text = self.definition.data.decode("utf-8", "replace")
        is_idl = self.definition.encoding == "ros2idl"
        types = get_types_from_idl(text) if is_idl else get_types_from_msg(text, self.type_name)
        return decode_topic(types, self.type_name, self.messages)


class Bag:
    """A bag in memory; made by `read_bag`."""

    reads_past_damage = False

    def __init__(self, path: Path, wanted: Collection[str] | None = None) -> None:
        self.path = path  # directory or file
        self.topics: dict[str, TopicInfo] = {}  # by full name
        self.damages: list[Damage] = []  # what cannot be read, in the order of the file
        self.attachments: dict[str, bytes] = {}  # files stored in the bag, by name
        # records by name: ``rosbag2`` is rosbag2's own, ``quadftc`` tells what recorded the bag
        self.metadata: dict[str, dict[str, str]] = {}
        self.left_out = 0  # messages of other topics than these
        self._wanted = wanted

    @property
    def truncated(self) -> bool:
        """The recording was cut short (killed recorder, full disk): everything up to the cut is here."""
        return bool(self.damages)

    @property
    def remedy(self) -> str:
        """What to do about a bag that was cut short, to be said behind what is wrong; else empty."""
        return f"; to make it whole, run quadftc repair {self.path}" if self.truncated else ""

    def resolve(self, topic: str) -> str:
        """Return a topic's full name: as given, or in the only namespace that has it; else BagError."""
        short = topic.strip("/")
        exact = [name for name in self.topics if name.strip("/") == short]
        if exact:
            return topic if topic in exact else exact[0]
        names = [name for name in self.topics if name.endswith("/" + short)]
        if len(names) == 1:
            return names[0]
        there = ", ".join(sorted(names or self.topics)) or "none"
        problem = "is in more than one namespace" if names else "is not in the bag"
        raise BagError(f"{self.path}: topic '{topic}' {problem}; topics there: {there}")

    def series(self, topic: str) -> Series:
        """Return all messages of a topic (see `resolve`) as arrays; BagError if they cannot be decoded."""
        info = self.topics[self.resolve(topic)]
        try:
            fields = info.decode()
        except Exception as error:  # whatever the libraries find wrong with the definition or a message
            words = " ".join(str(error).split()) or type(error).__name__
            raise BagError(f"{self.path}: topic '{info.name}' cannot be decoded: {words}") from error
        log_time = np.array(info.log_times, np.int64)
        if bool(np.any(np.diff(log_time) < 0)):
            order = np.argsort(log_time, kind="stable")
            log_time = log_time[order]
            fields = {key: values[order] for key, values in fields.items()}
        first, stamp = next(iter(fields.items()), ("", log_time))
        stamp_ns = stamp if first.endswith("_ns") and stamp.ndim == 1 else log_time
        return Series(info.name, info.type_name, stamp_ns, log_time, fields)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Yield (full name, log time [ns], serialised message) in the order of log time; default: of all."""
        names = self.topics if topics is None else [self.resolve(topic) for topic in topics]
        rows = [
            (name, time_ns, data)
            for name in names
            for time_ns, data in zip(self.topics[name].log_times, self.topics[name].messages, strict=True)
        ]
        yield from sorted(rows, key=itemgetter(1))

    def load(self, records: Iterable[Record], keep: bool = True) -> Mapping[int, TopicInfo | None]:
        """Add a file up to a damage, without ``keep`` no messages of it; return the topics by channel."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, TopicInfo | None] = {}
        for record in records:
            if isinstance(record, tuple):
                channel, log_time, _publish_time, data = record
                if topic := channels.get(channel):
                    topic.add(log_time, data, keep=keep)
                else:
                    self.left_out += 1
            elif isinstance(record, Schema):
                schemas.setdefault(record.id, record)  # of those that come again, as in the index, the first
            elif isinstance(record, Channel):
                present = channels.get(record.id)
                channels[record.id] = present or self.topic_of(record, schemas.get(record.schema_id))
            elif isinstance(record, Attachment):
                self.attachments[record.name] = record.data
            elif isinstance(record, Metadata):
                self.metadata[record.name] = record.metadata
            elif isinstance(record, Damage):
                self.damages.append(record)
                if not self.reads_past_damage:
                    break
        return channels

    def wants(self, topic: str) -> bool:
        """Return whether a topic, by its full name, is to be read."""
        names = self._wanted
        return names is None or any(f"/{topic.strip('/')}".endswith(f"/{name.strip('/')}") for name in names)

    def topic_of(self, channel: Channel, schema: Schema | None) -> TopicInfo | None:
        """Return the topic of a channel, new or present; None if its messages are to be left out."""
        if not self.wants(channel.topic):
            return None
        type_name, more = schema.name if schema else "unknown", channel.metadata
        topic = TopicInfo(channel.topic, type_name, encoding=channel.message_encoding, definition=schema)
        topic.qos, topic.type_hash = more.get("offered_qos_profiles", ""), more.get("topic_type_hash", "")
        present = self.topics.setdefault(channel.topic, topic)
        if present.type_name != type_name:
            types = f"{present.type_name} and {type_name}"
            raise BagError(f"{self.path}: topic '{channel.topic}' has two types, {types}")
        return present


def file_records(file: Path, is_wanted: IsWanted) -> Iterator[Record]:
    """Yield the records of a file of a bag, at least those of the topics that are wanted."""
    if is_sqlite(file):
        return read_sqlite(file, is_wanted)
    return read_ros1(file, is_wanted) if is_ros1(file) else read_records(file)


def read_bag(path: str | os.PathLike[str], topics: Collection[str] | None = None) -> Bag:
    """Read a bag: a rosbag2 directory, an ``.mcap``, a ``.db3`` or a ROS 1 file; BagError if it is none.

    ``topics`` (full, relative or short names) are those to keep, to save memory; default: all.
    """
    bag = Bag(Path(path), topics)
    for file in storage_files(bag.path):
        bag.load(file_records(file, lambda topic, _kind: bag.wants(topic)))
    return bag


def bag_topics(path: Path) -> dict[str, TopicInfo]:
    """List the topics of a bag, with the number of their messages, without keeping any message."""
    if is_sqlite(path):
        with open_sqlite(path) as reader:
            topics = reader.topics.items()
            return {name: TopicInfo(name, topic.msgtype or "", topic.msgcount) for name, topic in topics}
    bag = Bag(path)
    for file in storage_files(path):
        bag.load(file_records(file, lambda _topic, _kind: True), keep=False)
    return bag.topics
