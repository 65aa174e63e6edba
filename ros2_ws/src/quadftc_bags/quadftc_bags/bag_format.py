"""What rosbag2 (Jazzy) writes about a bag: quality of service and ``metadata.yaml``, version 9, as text."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from textwrap import indent
from typing import TYPE_CHECKING, NamedTuple

from quadftc_bags.interfaces import load_interface

if TYPE_CHECKING:
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile

VERSION = 9
COMPRESSIONS = ("zstd", "lz4", "none")  # of the chunks of a bag
_NO_HASH = "''"  # of bags that older versions recorded
NEVER_NS = 2**63 - 1  # rosbag2: start of an empty bag, and "infinite" as a duration


class TopicRecord(NamedTuple):
    """A topic as a bag describes it."""

    name: str
    type_name: str  # ``package/msg/Name``
    type_hash: str
    qos: str  # offered quality of service, a YAML list
    definition: str  # text of the type and of all types it uses
    encoding: str = "ros2msg"  # of the definition


def describe_topic(name: str, type_name: str, qos: QoSProfile) -> TopicRecord:
    """Return the record of a topic whose publisher offers ``qos``; ValueError for an unknown type."""
    interface = load_interface(type_name)
    return TopicRecord(name, type_name, interface.type_hash, offered_qos(qos), interface.text)


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


def metadata_text(
    file_name: str,
    topics: Sequence[tuple[TopicRecord, int]],
    span_ns: tuple[int, int] | None,
    custom: Mapping[str, str],
) -> str:
    """Return the metadata of a bag of one file, as YAML; ``custom`` are the user's own entries.

    ``topics`` come with their numbers of messages; ``span_ns`` is the first and last log time [ns].
    """
    start, end = span_ns or (NEVER_NS, NEVER_NS)
    count = sum(number for _, number in topics)
    entries = "".join(f"\n  {_quoted(key)}: {_quoted(value)}" for key, value in custom.items())
    return (
        f"version: {VERSION}\n"
        "storage_identifier: mcap\n"
        f"duration:\n  nanoseconds: {end - start}\n"
        f"starting_time:\n  nanoseconds_since_epoch: {start}\n"
        f"message_count: {count}\n"
        f"topics_with_message_count:{''.join(map(_topic, topics)) or ' []'}\n"
        "compression_format: ''\n"
        "compression_mode: ''\n"
        f"relative_file_paths:\n- {_quoted(file_name)}\n"
        "files:\n"
        f"- path: {_quoted(file_name)}\n"
        f"  starting_time:\n    nanoseconds_since_epoch: {start}\n"
        f"  duration:\n    nanoseconds: {end - start}\n"
        f"  message_count: {count}\n"
        f"custom_data:{entries or ' {}'}\n"
        f"ros_distro: {os.environ.get('ROS_DISTRO', 'jazzy')}\n"
    )


def _topic(counted: tuple[TopicRecord, int]) -> str:
    topic, count = counted
    qos = "\n" + indent(topic.qos.rstrip() + "\n", "    ") if topic.qos.strip() else " []\n"
    return (
        "\n- topic_metadata:\n"
        f"    name: {topic.name}\n"
        f"    type: {topic.type_name}\n"
        "    serialization_format: cdr\n"
        f"    offered_qos_profiles:{qos}"
        f"    type_description_hash: {topic.type_hash or _NO_HASH}\n"
        f"  message_count: {count}"
    )


def _duration(duration: Duration) -> str:
    """Return sec and nsec; an unset (zero) duration means infinite."""
    seconds, nanoseconds = divmod(duration.nanoseconds or NEVER_NS, 10**9)
    return f"    sec: {seconds}\n    nsec: {nanoseconds}\n"


def _quoted(text: str) -> str:
    """Return a YAML double-quoted scalar of plain ASCII; a usual file name stays as it is."""
    if re.fullmatch(r"\w[\w.-]*\.mcap", text, re.ASCII):
        return text
    escaped = json.dumps(text, ensure_ascii=False)
    return re.sub(r"[^\x20-\x7e]", lambda match: f"\\U{ord(match[0]):08X}", escaped)
