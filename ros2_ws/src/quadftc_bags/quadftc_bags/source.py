"""Which topics a bag has, and reading only some of them: MCAP, and SQLite (.db3) as older ROS 2 writes it."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Generator
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema
from rosbags.interfaces import ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from quadftc_bags.bag import Bag, BagError, TopicInfo, read_bag
from quadftc_bags.directory import storage_files
from quadftc_bags.mcap_records import CutShortError, NotMcapError, read_records


def bag_topics(path: Path) -> dict[str, TopicInfo]:
    """List the topics of a bag, with the number of their messages, without keeping any message.

    Raises
    ------
    BagError
        If there is no such bag, or it cannot be read.
    """
    if _is_sqlite(path):
        return _SqliteBag(path).listed()
    found: dict[str, TopicInfo] = {}
    for file in storage_files(path):
        for info in _topics_of_file(file):
            count = info.count + (found[info.name].count if info.name in found else 0)
            found[info.name] = TopicInfo(info.name, info.type_name, count, info.qos)
    return found


def open_bag(path: Path, topics: Collection[str]) -> Bag:
    """Read some topics of a bag into memory.

    Raises
    ------
    BagError
        If there is no such bag, or it cannot be read.
    """
    if not _is_sqlite(path):
        return read_bag(path, topics)
    bag = _SqliteBag(path)
    bag.load(path, topics)
    return bag


def _is_sqlite(path: Path) -> bool:
    if path.is_dir():
        return any(path.glob("*.db3*")) and not any(path.glob("*.mcap"))
    return path.suffix == ".db3"


def _topics_of_file(path: Path) -> list[TopicInfo]:
    types: dict[int, str] = {}
    channels: dict[int, Channel] = {}
    counts: dict[int, int] = {}

    def count(channel: int, log_time: int, publish_time: int, data: memoryview) -> None:
        counts[channel] = counts.get(channel, 0) + 1

    try:
        with path.open("rb") as stream, contextlib.suppress(CutShortError):
            for record in read_records(stream, count):
                if isinstance(record, Schema):
                    types[record.id] = record.name
                elif isinstance(record, Channel):
                    channels[record.id] = record
    except NotMcapError:
        raise BagError(f"{path}: not an MCAP file") from None
    except OSError as error:
        raise BagError(f"{path}: {error.strerror or error}") from error
    return [
        TopicInfo(channel.topic, types.get(channel.schema_id, ""), counts.get(number, 0), "")
        for number, channel in channels.items()
    ]


class _SqliteBag(Bag):
    """A bag in SQLite files, read by the library rosbags."""

    def listed(self) -> dict[str, TopicInfo]:
        """All topics, without their messages."""
        with self._reader() as reader:
            return {
                name: TopicInfo(name, topic.msgtype or "", topic.msgcount, "")
                for name, topic in reader.topics.items()
            }

    def load(self, path: Path, wanted: Collection[str] | None) -> None:
        """Add the messages of the wanted topics, by their full names."""
        with self._reader() as reader:
            chosen = [each for each in reader.connections if wanted is None or each.topic in wanted]
            topics = {
                each.id: self._topic(
                    Channel(each.id, each.topic, "cdr", {}, each.id),
                    {each.id: _definition(each.id, each.msgtype, each.msgdef.format, each.msgdef.data)},
                )
                for each in chosen
                if isinstance(each.ext, ConnectionExtRosbag2)
            }
            for connection, log_time, data in reader.messages(chosen) if chosen else ():
                topics[connection.id].add(log_time, log_time, memoryview(data))

    @contextlib.contextmanager
    def _reader(self) -> Generator[Reader, None, None]:
        """Open the bag; whatever the library finds wrong with it is one line."""
        try:
            with Reader(self.path) as reader:
                names: list[Any] = list(reader.topics)  # as metadata.yaml has them
                if wrong := [name for name in names if not isinstance(name, str)]:
                    raise BagError(f"{self.path}: topic {wrong[0]!r}: expected a name")
                yield reader
        except BagError:
            raise
        except Exception as error:  # of the library, of SQLite, of the file system
            words = " ".join(str(error).split()) or type(error).__name__
            raise BagError(f"{self.path}: not a bag that can be read: {words}") from None


def _definition(number: int, type_name: str, form: MessageDefinitionFormat, text: str) -> Schema:
    """Return the stored definition of a type; where none is stored, the one that ROS 2 Jazzy has."""
    if form is MessageDefinitionFormat.IDL:
        return Schema(number, text.encode(), "ros2idl", type_name)
    if form is MessageDefinitionFormat.NONE:
        text = get_typestore(Stores.ROS2_JAZZY).generate_msgdef(type_name, ros_version=2)[0]
    return Schema(number, text.encode(), "ros2msg", type_name)
