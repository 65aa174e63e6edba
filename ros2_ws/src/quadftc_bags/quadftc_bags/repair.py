"""Repairing a bag: what can be read of it, written to a new, whole one, with the metadata that rosbag2 wants.

A killed recorder or a full disk leaves a file without index whose last chunk may be cut, and old metadata. A
chunk that is cut or whose sum is wrong is left out: no message is guessed.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from mcap.reader import make_reader
from mcap.records import Channel, Schema
from ruamel.yaml import YAML, YAMLError

from quadftc_bags.bag import Bag, TopicInfo
from quadftc_bags.bag_file import BagFile, is_being_written
from quadftc_bags.bag_format import TopicRecord
from quadftc_bags.storage import BagError, bag_errors, bag_information, check_size, read_records

CHUNK = 1024 * 1024  # bytes
DEFINITIONS = ("ros2msg", "ros2idl")  # encodings of a type's definition that a bag may have
OWN_RECORDS = ("rosbag2", "quadftc")  # metadata records that the new file gets anyway
_WORDS = {  # of rmw, as recorded before ROS 2 Jazzy: numbers
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": ("system_default", "automatic", "unknown", "manual_by_topic", "unknown", "best_available"),
}


class Survey(Bag):
    """What a file holds, and what of it cannot be read; BagError if there is no topic to keep."""

    reads_past_damage = True

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.size = check_size(path)  # bytes
        self.refused: dict[str, str] = {}  # topics unfit for ROS 2: the reason
        self.channels = self.load(read_records(path), keep=False)
        if not self.topics:
            raise BagError(f"{path}: nothing to repair: {_nothing(self)}")
        self.message_count = sum(topic.count for topic in self.topics.values())  # that can be read
        self.is_indexed = False  # whether the file ends as it should, with an index
        with suppress(Exception), path.open("rb") as stream:  # whatever the library makes of a cut index
            summary: Any = make_reader(stream).get_summary()
            self.is_indexed = summary.statistics.message_count == self.message_count

    @property
    def is_whole(self) -> bool:
        """Whether nothing is wrong with the file."""
        return self.is_indexed and not (self.damages or self.refused or self.left_out)

    def topic_of(self, channel: Channel, schema: Schema | None) -> TopicInfo | None:
        """Return the topic of a channel that a ROS 2 bag can have; of others, note why it cannot."""
        present = self.topics.get(channel.topic)
        if channel.message_encoding != "cdr":
            reason = f"its messages are '{channel.message_encoding}', not cdr"
        elif schema is None:
            reason = "the definition of its type is missing"
        elif schema.encoding not in DEFINITIONS:
            reason = f"its type is defined in '{schema.encoding}', not {' or '.join(DEFINITIONS)}"
        elif present is not None and present.type_name != schema.name:
            reason = f"a part of it has another type, {schema.name}"
        else:
            return super().topic_of(channel, schema)
        self.refused[channel.topic] = reason
        return None


@dataclass(frozen=True)
class Repair:
    """What became of a bag."""

    found: Survey  # what was read, and what could not be
    out: Path | None  # the bag that was written; None if nothing was wrong
    complaint: str  # what was wrong with ``metadata.yaml``; empty if nothing was
    recorded: bool = False  # the bag was still being recorded: it goes on after what was read


def repair(path: Path, out: Path | None = None, force: bool = False) -> Repair:
    """Write a new bag that can be read whole, of a bag of one MCAP file (directory or file).

    Without ``out``, the new directory, a bag that is whole is left as it is; of others the new one is
    ``<bag>-repaired`` beside it, or with ``force`` takes its place. With ``out``, ``force`` replaces what is
    there. BagError if nothing can be read, or the new bag cannot be written or would replace one that is
    being recorded.
    """
    file = _storage_file(path)
    recorded = file.is_file() and is_being_written(file)
    found = Survey(file)
    complaint = _complaint(path, found) if path.is_dir() else ""
    if out is None and found.is_whole and not complaint:
        return Repair(found, None, complaint)
    target = _target(path, out, force)
    if recorded and target in (path.resolve(), file.resolve().parent):
        raise BagError(f"{path}: is still being recorded; end that before the bag is replaced")
    with bag_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".repair_", dir=target.parent) as folder:
            made = Path(folder, target.name)
            _write(found, made)
            if path.is_dir():  # the texts that lie beside a bag: scenario, parameters, summary
                for text in (*path.glob("*.yaml"), *path.glob("*.json")):
                    if text.name != "metadata.yaml":
                        shutil.copyfile(text, made / text.name)
            _put(made, target)
    return Repair(found, target, complaint, recorded)


def _nothing(found: Survey) -> str:
    """Say why there is nothing to keep."""
    if found.refused:
        topic, reason = next(iter(found.refused.items()))
        more = f" (and {len(found.refused) - 1} more topics)" if len(found.refused) > 1 else ""
        return f"topic '{topic}': {reason}{more}"
    if found.damages:
        return f"it ends or breaks at byte {found.damages[0].offset} of {found.size}, before any topic"
    return "it has no topic"


def _storage_file(path: Path) -> Path:
    """Return the one MCAP file of a bag."""
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    if not path.is_dir():
        return path
    files = sorted(path.glob("*.mcap"))
    if not files:
        raise BagError(f"{path}: no .mcap file in this directory; nothing to repair")
    if len(files) > 1:
        names = ", ".join(file.name for file in files)
        raise BagError(f"{path}: {len(files)} .mcap files ({names}); repair one at a time, by its path")
    return files[0]


def _target(path: Path, out: Path | None, force: bool) -> Path:
    """Return where the new bag goes."""
    if out is None and force:
        if path.is_dir():
            return path.resolve()
        raise BagError(f"{path}: --force without --out replaces a bag; give its directory, not its file")
    if out is None:
        bag = path.resolve() if path.is_dir() or not (path.parent / "metadata.yaml").exists() else path.parent
        out = bag.parent / f"{path.stem if path.is_file() else bag.name}-repaired"
    if not out.exists():
        return out.resolve()
    if not force:
        raise BagError(f"{out}: exists; choose another --out, or --force to replace it")
    if not (out / "metadata.yaml").is_file() or len(list(out.glob("*.mcap"))) > 1:
        raise BagError(f"{out}: is no bag of one file; not replaced")
    return out.resolve()


def _put(made: Path, target: Path) -> None:
    """Move the new bag to its place; of a bag that was there, what is not replaced or storage stays."""
    if not target.exists():
        made.rename(target)
        return
    old = set(target.glob("*.mcap"))
    # the metadata, which tell of the rest, come last
    for file in sorted(made.iterdir(), key=lambda file: file.name == "metadata.yaml"):
        file.replace(target / file.name)
        old.discard(target / file.name)
    for file in old:
        file.unlink()


def _write(found: Survey, directory: Path) -> None:
    """Write what a survey found."""
    custom = found.metadata.get("quadftc") or _custom_data(found.metadata.get("rosbag2", {}))
    bag = BagFile(directory, found.attachments, custom, "zstd", CHUNK)
    try:
        for name, entries in found.metadata.items():
            if name not in OWN_RECORDS:
                bag.add_record(name, entries)
        channels: dict[int, int] = {}  # there -> here
        for record in read_records(found.path):  # the survey has the damages
            if isinstance(record, tuple) and record[0] in channels:
                bag.write(channels[record[0]], record[1], record[2], bytes(record[3]))
            elif isinstance(record, Channel) and (topic := found.channels.get(record.id)):
                if topic.name not in bag.counts:
                    bag.add_topic(_describe(topic))
                channels[record.id] = list(bag.counts).index(topic.name) + 1
        bag.close()
    except BaseException:
        bag.abandon()
        raise


def _describe(topic: TopicInfo) -> TopicRecord:
    schema = topic.definition
    assert schema is not None  # else the survey had refused the topic
    text = schema.data.decode("utf-8", "replace")
    return TopicRecord(
        topic.name, topic.type_name, topic.type_hash, _in_words(topic.qos), text, schema.encoding
    )


def _custom_data(record: Mapping[str, str]) -> dict[str, str]:
    """Return the user's own entries in rosbag2's metadata record."""
    try:
        data: Any = YAML(typ="safe").load(record.get("serialized_metadata", ""))  # pyright: ignore
        custom: Any = data.get("custom_data") or {}
        return {str(key): str(value) for key, value in cast("dict[object, object]", custom).items()}
    except (YAMLError, AttributeError, TypeError, ValueError, RecursionError):
        return {}


def _in_words(qos: str) -> str:
    """Return a quality of service with words where older versions of ROS 2 have numbers."""

    def word(match: re.Match[str]) -> str:
        words = _WORDS[match[2]]
        number = int(match[3])
        return f"{match[1]}{match[2]}: {words[number] if number < len(words) else 'unknown'}"

    return re.sub(r"(?m)^([ -]*)(history|reliability|durability|liveliness): *(\d+) *$", word, qos)


def _complaint(directory: Path, found: Survey) -> str:
    """Say what ``metadata.yaml`` has wrong about the file; empty if nothing."""
    file = directory / "metadata.yaml"
    if not file.exists():
        return "metadata.yaml is missing"
    try:
        told = bag_information(file)
        counts = {
            str(topic["topic_metadata"]["name"]): int(topic["message_count"])
            for topic in told["topics_with_message_count"]
        }
        total, names = int(told["message_count"]), [Path(str(n)).name for n in told["relative_file_paths"]]
    except (BagError, KeyError, TypeError, ValueError, AttributeError):
        return "metadata.yaml cannot be read"
    if names != [found.path.name]:
        return f"metadata.yaml tells of other files: {', '.join(names) or 'none'}"
    if total != found.message_count:
        return f"metadata.yaml tells of {total} messages, {found.message_count} are there"
    if counts != {name: topic.count for name, topic in found.topics.items()}:
        return "metadata.yaml tells of other topics, or of other numbers of messages"
    return ""
