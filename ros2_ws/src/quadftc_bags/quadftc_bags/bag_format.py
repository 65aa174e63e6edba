"""What rosbag2 (Jazzy) writes about a bag: quality of service and ``metadata.yaml``, version 9, as text."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rclpy.duration import Duration
from rclpy.qos import QoSProfile

VERSION = 9
COMPRESSIONS = ("zstd", "lz4", "none")  # of the chunks of a bag
_NO_HASH = "''"  # of bags that older versions recorded
NEVER_NS = 2**63 - 1  # rosbag2: start of an empty bag, and "infinite" as a duration


class TopicRecord(NamedTuple):
    """A topic of a bag: name, type, type hash, and the offered quality of service as a YAML list."""

    name: str
    type_name: str
    type_hash: str
    qos: str


class BagSummary(NamedTuple):
    """What ``metadata.yaml`` says of a bag of one file."""

    file_name: str
    topics: Sequence[tuple[TopicRecord, int]]  # each with its number of messages
    start_ns: int  # first and last log time [ns]; ignored while there are no messages
    end_ns: int
    custom: Mapping[str, str]  # the user's own entries
    ros_distro: str


def offered_qos(profile: QoSProfile) -> str:
    """Return a profile as rosbag2 records it: a YAML list of one entry."""
    return (
        f"- history: {profile.history.name.lower()}\n"
        f"  depth: {profile.depth}\n"
        f"  reliability: {profile.reliability.name.lower()}\n"
        f"  durability: {profile.durability.name.lower()}\n"
        f"  deadline:\n{_duration(profile.deadline)}"
        f"  lifespan:\n{_duration(profile.lifespan)}"
        f"  liveliness: {profile.liveliness.name.lower().replace('system_default', 'automatic')}\n"
        f"  liveliness_lease_duration:\n{_duration(profile.liveliness_lease_duration)}"
        f"  avoid_ros_namespace_conventions: {str(profile.avoid_ros_namespace_conventions).lower()}\n"
    )


def bag_information(bag: BagSummary) -> str:
    """Return the YAML text of the bag's metadata, without the outer key: what the MCAP record holds."""
    count = sum(number for _, number in bag.topics)
    start, duration = (bag.start_ns, bag.end_ns - bag.start_ns) if count else (NEVER_NS, 0)
    custom = "".join(f"\n  {_quoted(key)}: {_quoted(value)}" for key, value in bag.custom.items())
    return (
        f"version: {VERSION}\n"
        "storage_identifier: mcap\n"
        f"duration:\n  nanoseconds: {duration}\n"
        f"starting_time:\n  nanoseconds_since_epoch: {start}\n"
        f"message_count: {count}\n"
        f"topics_with_message_count:{_topics(bag.topics)}\n"
        "compression_format: ''\n"
        "compression_mode: ''\n"
        f"relative_file_paths:\n- {_quoted(bag.file_name)}\n"
        "files:\n"
        f"- path: {_quoted(bag.file_name)}\n"
        f"  starting_time:\n    nanoseconds_since_epoch: {start}\n"
        f"  duration:\n    nanoseconds: {duration}\n"
        f"  message_count: {count}\n"
        f"custom_data:{custom or ' {}'}\n"
        f"ros_distro: {bag.ros_distro}\n"
    )


def metadata_file(bag: BagSummary) -> str:
    """Return the text of ``metadata.yaml``."""
    return "rosbag2_bagfile_information:\n" + _indented(bag_information(bag), "  ")


def _topics(topics: Sequence[tuple[TopicRecord, int]]) -> str:
    entries = [
        "\n- topic_metadata:\n"
        f"    name: {topic.name}\n"
        f"    type: {topic.type_name}\n"
        "    serialization_format: cdr\n"
        f"    offered_qos_profiles:{_offered(topic.qos)}"
        f"    type_description_hash: {topic.type_hash or _NO_HASH}\n"
        f"  message_count: {count}"
        for topic, count in topics
    ]
    return "".join(entries) or " []"


def _offered(qos: str) -> str:
    return "\n" + _indented(qos.rstrip() + "\n", "    ") if qos.strip() else " []\n"


def _duration(duration: Duration) -> str:
    """Return sec and nsec; an unset (zero) duration means infinite."""
    seconds, nanoseconds = divmod(duration.nanoseconds or NEVER_NS, 10**9)
    return f"    sec: {seconds}\n    nsec: {nanoseconds}\n"


def _indented(text: str, by: str) -> str:
    return "".join(by + line for line in text.splitlines(keepends=True))


def _quoted(text: str) -> str:
    """Return a YAML double-quoted scalar of plain ASCII; a usual file name stays as it is."""
    if re.fullmatch(r"\w[\w.-]*\.mcap", text, re.ASCII):
        return text
    escaped = json.dumps(text, ensure_ascii=False)
    return re.sub(r"[^\x20-\x7e]", lambda match: f"\\U{ord(match[0]):08X}", escaped)
