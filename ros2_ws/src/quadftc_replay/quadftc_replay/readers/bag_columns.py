"""Columns of the topics of a bag, decoded while it is read, so that a large bag needs little memory."""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema

from quadftc_bags.bag import Bag, BagError, TopicInfo, file_records
from quadftc_bags.storage import storage_files
from quadftc_model.arrays import AnyArray
from quadftc_replay.thinning import Thinning

SQLITE = b"SQLite format 3\0"
BLOCK = 16384  # messages decoded at a time
Columns = Mapping[str, AnyArray]
Choose = Callable[[Columns], Columns]  # of the fields of a message type, what is kept


@dataclass
class ColumnTopic(TopicInfo):
    """A topic that keeps columns, and only the messages of the present block."""

    choose: Choose = dict
    blocks: list[dict[str, AnyArray]] = field(default_factory=list[dict[str, AnyArray]])
    damaged: int = 0  # messages that could not be decoded
    thinning: Thinning = field(default_factory=Thinning)

    def add(self, log_time: int, data: memoryview, *, keep: bool) -> None:
        """Take a message, and decode the block when it is full."""
        super().add(log_time, data, keep=keep and self.thinning.keeps())
        if len(self.messages) >= BLOCK:
            self.settle()
            if self.thinning.is_full():
                self.blocks = [
                    {name: values[::2].copy() for name, values in block.items()} for block in self.blocks
                ]

    def settle(self) -> None:
        """Decode the messages that wait; what cannot be decoded is counted."""
        if self.messages:
            try:
                self.blocks.append(self._decode_block())
            except Exception:  # whatever the libraries find wrong with the definition or a message
                self.damaged += len(self.messages)
        self.messages.clear()
        del self.log_times[:]

    def _decode_block(self) -> dict[str, AnyArray]:
        with np.errstate(invalid="ignore"):  # damaged bytes may be a signalling NaN
            fields = self.decode()
        log_ns = np.array(self.log_times, np.int64)
        stamp_ns = fields.get("stamp_ns", log_ns)
        return {"stamp_ns": stamp_ns, "log_ns": log_ns, **self.choose(fields)}

    def columns(self) -> dict[str, AnyArray]:
        """All that was decoded, in the order of recording; empty: nothing."""
        self.settle()
        names = list(self.blocks[0]) if self.blocks else []
        whole = {name: np.concatenate([block.pop(name) for block in self.blocks]) for name in names}
        if whole and bool(np.any(np.diff(whole["log_ns"]) < 0)):
            order = np.argsort(whole["log_ns"], kind="stable")
            whole = {name: values[order] for name, values in whole.items()}
        if whole and not np.any(whole["stamp_ns"]):
            whole["stamp_ns"] = whole["log_ns"]
        return whole


class ColumnBag(Bag):
    """A bag of which some topics are read; of a damaged file, what is there."""

    reads_past_damage = True

    def __init__(self, path: Path, find_choice: Callable[[str, str], Choose | None]) -> None:
        super().__init__(path)
        self.find_choice = find_choice  # from name and type of a topic; None: it does not count
        self.problem = ""  # that ended the reading

    def topic_of(self, channel: Channel, schema: Schema | None) -> TopicInfo | None:
        """Return the topic of a channel, if it counts."""
        type_name = schema.name if schema else ""
        if (choose := self.find_choice(channel.topic, type_name)) is None:
            return None
        if channel.topic not in self.topics:
            topic = ColumnTopic(channel.topic, type_name, choose=choose)
            topic.encoding, topic.definition = channel.message_encoding, schema
            self.topics[channel.topic] = topic
        return self.topics[channel.topic]


def read_columns(path: Path, find_choice: Callable[[str, str], Choose | None]) -> ColumnBag:
    """Read topics by name and type; BagError if the bag cannot be opened, or damage left nothing."""
    bag = ColumnBag(path, find_choice)
    with contextlib.ExitStack() as stack:
        for file in storage_files(path):
            named = _named_by_content(file, stack)
            try:
                bag.load(file_records(named, lambda name, kind: find_choice(name, kind) is not None))
            except BagError as error:
                bag.problem = str(error).replace(str(named), str(file))
    if bag.problem and not any(topic.count for topic in bag.topics.values()):
        raise BagError(bag.problem)
    return bag


def _named_by_content(file: Path, stack: contextlib.ExitStack) -> Path:
    """Return a link with the suffix ``.db3`` to a file with SQLite that has another; else the file itself."""
    if file.is_dir() or file.suffix == ".db3":
        return file
    with file.open("rb") as stream:
        if stream.read(len(SQLITE)) != SQLITE:
            return file
    link = Path(stack.enter_context(tempfile.TemporaryDirectory()), "bag.db3")
    link.symlink_to(file.resolve())
    return link


def is_named(name: str, topic: str) -> bool:
    """Whether a full name is that of a relative topic, in whatever namespace."""
    return f"/{name.strip('/')}".endswith(f"/{topic}")


def trailing_number(name: str) -> int | None:
    """Number at the end of a name, such as that of a joint."""
    found = re.search(r"(\d+)\D*$", name)
    return int(found.group(1)) if found else None
