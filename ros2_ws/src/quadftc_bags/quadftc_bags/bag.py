"""Reading bags: any rosbag2 bag (MCAP or SQLite), whole topics as NumPy arrays.

>>> bag = read_bag("out/paper_faults-proposed")
>>> imu = bag.series("imu/data")
>>> imu.stamp_ns, imu["angular_velocity"]   # (n,), (n, 3)

`quadftc_bags.cdr.arrays` says how the fields of a message become arrays.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Metadata, Schema
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from quadftc_bags.cdr.arrays import Arrays, decode_topic
from quadftc_bags.storage import (
    BagError,
    CutShortError,
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
    publish_time_ns: NDArray[np.int64]  # (n,) [ns]
    fields: Mapping[str, NDArray[Any]]  # (n, ...) each, units as in the message

    def __len__(self) -> int:
        return len(self.log_time_ns)

    def __getitem__(self, name: str) -> NDArray[Any]:
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
    encoding: str = "cdr"  # of the messages
    definition: Schema | None = None  # of the type
    messages: list[bytes] = field(default_factory=list[bytes])
    log_times: array[int] = field(default_factory=lambda: array("q"))  # [ns]
    publish_times: array[int] = field(default_factory=lambda: array("q"))  # [ns]

    def add(self, log_time: int, publish_time: int, data: memoryview, *, keep: bool) -> None:
        """Count a message, and keep it if asked to."""
        self.first_ns = min(self.first_ns, log_time) if self.count else log_time
        self.last_ns = max(self.last_ns, log_time) if self.count else log_time
        self.count += 1
        if keep:
            self.messages.append(bytes(data))
            self.log_times.append(log_time)
            self.publish_times.append(publish_time)

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
    """A bag in memory; made by `read_bag`.

    Attributes
    ----------
    path : Path
        The bag's directory or file.
    topics : dict of str to TopicInfo
        The topics, by full name.
    truncated : bool
        The recording was cut short (killed recorder, full disk): everything up to the cut is here.
    attachments : dict of str to bytes
        Files stored in the bag, by name.
    metadata : dict of str to dict of str to str
        Metadata records, by name; ``rosbag2`` is rosbag2's own, ``quadftc`` tells what recorded the bag.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, TopicInfo] = {}
        self.truncated = False
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, dict[str, str]] = {}

    @property
    def remedy(self) -> str:
        """What to do about a bag that was cut short, to be said behind what is wrong; else empty."""
        return f"; to make it whole, run quadftc repair {self.path}" if self.truncated else ""

    def resolve(self, topic: str) -> str:
        """Return a topic's full name: as given, with a leading slash, or in the only namespace that has it.

        Raises BagError if no topic or more than one fits.
        """
        short = topic.strip("/")
        if topic in self.topics:
            return topic
        for name in self.topics:
            if name.strip("/") == short:
                return name
        names = [name for name in self.topics if name.endswith("/" + short)]
        if len(names) == 1:
            return names[0]
        there = ", ".join(sorted(names or self.topics)) or "none"
        problem = "is in more than one namespace" if names else "is not in the bag"
        raise BagError(f"{self.path}: topic '{topic}' {problem}; topics there: {there}")

    def series(self, topic: str) -> Series:
        """Return all messages of a topic as arrays; for the name see `resolve`.

        Raises BagError if the topic is not there or its messages cannot be decoded.
        """
        info = self.topics[self.resolve(topic)]
        try:
            fields = info.decode()
        except Exception as error:  # whatever the libraries find wrong with the definition or a message
            words = " ".join(str(error).split()) or type(error).__name__
            raise BagError(f"{self.path}: topic '{info.name}' cannot be decoded: {words}") from error
        log_time = np.array(info.log_times, np.int64)
        publish_time = np.array(info.publish_times, np.int64)
        if bool(np.any(np.diff(log_time) < 0)):
            order = np.argsort(log_time, kind="stable")
            log_time, publish_time = log_time[order], publish_time[order]
            fields = {key: values[order] for key, values in fields.items()}
        first, stamp = next(iter(fields.items()), ("", log_time))
        stamp_ns = stamp if first.endswith("_ns") and stamp.ndim == 1 else log_time
        return Series(info.name, info.type_name, stamp_ns, log_time, publish_time, fields)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Yield (full name, log time [ns], serialised message) in the order of log time; default: all topics.

        Raises BagError if one of the topics is not there.
        """
        names = self.topics if topics is None else [self.resolve(topic) for topic in topics]
        chosen = [self.topics[name] for name in names]
        times = np.concatenate([np.array(info.log_times, np.int64) for info in chosen] or [np.empty(0)])
        counts = [len(info.messages) for info in chosen]
        which, starts = np.repeat(np.arange(len(chosen)), counts), np.cumsum([0, *counts])
        for row in np.argsort(times, kind="stable").tolist():
            info = chosen[int(which[row])]
            yield info.name, int(times[row]), info.messages[row - int(starts[which[row]])]

    def load(self, file: Path, wanted: Collection[str] | None, keep: bool = True) -> None:
        """Add the wanted topics of one file, without ``keep`` only their counts; `read_bag` does it."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, TopicInfo] = {}

        def is_wanted(topic: str) -> bool:
            return wanted is None or any(_ends_with(topic, name) for name in wanted)

        records = read_sqlite(file, is_wanted) if is_sqlite(file) else read_records(file)
        try:
            for record in records:
                if isinstance(record, tuple):
                    if topic := channels.get(record[0]):
                        topic.add(*record[1:], keep=keep)
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    if record.id not in channels and is_wanted(record.topic):
                        channels[record.id] = self._add_topic(record, schemas.get(record.schema_id))
                else:
                    self._keep(record)
        except CutShortError:
            self.truncated = True

    def _keep(self, record: Record) -> None:
        if isinstance(record, Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata

    def _add_topic(self, channel: Channel, schema: Schema | None) -> TopicInfo:
        type_name, qos = (
            schema.name if schema else "unknown",
            channel.metadata.get("offered_qos_profiles", ""),
        )
        encoding = channel.message_encoding
        topic = TopicInfo(channel.topic, type_name, qos=qos, encoding=encoding, definition=schema)
        present = self.topics.setdefault(channel.topic, topic)
        if present.type_name != type_name:
            types = f"{present.type_name} and {type_name}"
            raise BagError(f"{self.path}: topic '{channel.topic}' has two types, {types}")
        return present


def read_bag(path: str | os.PathLike[str], topics: Collection[str] | None = None) -> Bag:
    """Read a bag.

    Parameters
    ----------
    path : path
        A rosbag2 directory, an ``.mcap`` or a ``.db3`` file.
    topics : collection of str, optional
        Keep only these (full, relative or short names), to save memory; default: all.

    Raises BagError if there is no such bag, it is empty or no bag, or its metadata makes no sense.
    """
    bag = Bag(Path(path))
    for file in storage_files(bag.path):
        bag.load(file, topics)
    return bag


def bag_topics(path: Path) -> dict[str, TopicInfo]:
    """List the topics of a bag, with the number of their messages, without keeping any message."""
    if is_sqlite(path):
        with open_sqlite(path) as reader:
            return {
                name: TopicInfo(name, topic.msgtype or "", topic.msgcount)
                for name, topic in reader.topics.items()
            }
    bag = Bag(path)
    for file in storage_files(path):
        bag.load(file, None, keep=False)
    return bag.topics


def _ends_with(topic: str, name: str) -> bool:
    return f"/{topic.strip('/')}".endswith(f"/{name.strip('/')}")
