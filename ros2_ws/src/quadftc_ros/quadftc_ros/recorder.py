"""What the recorder node decides without ROS: its topics and files, stamps, and how a recording stands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from quadftc_bags.writer import BagStatus
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.topics import GRAPHS, TOPICS, PlantKind, Topic


def judge(status: BagStatus) -> tuple[bytes, str, Mapping[str, int]]:
    """Return level, message and values of the diagnostics of a recording."""
    dropped = sum(status.dropped.values())
    values = {"stored": sum(status.counts.values()), "dropped": dropped, "lost": status.lost}
    if status.error is not None:
        return ERROR, f"recording has stopped: {status.error}", values
    return (WARN, "messages were dropped", values) if dropped else (OK, "recording", values)


def choose_topics(names: Sequence[str], plant: PlantKind = "test_stand") -> list[Topic]:
    """Return rows of the table by name, for no name those of a graph; ValueError for an unknown name."""
    unknown = sorted(set(names) - set(TOPICS))
    if unknown:
        raise ValueError(f"topics: unknown {', '.join(unknown)}; known are {', '.join(TOPICS)}")
    return [TOPICS[name] for name in dict.fromkeys(names or GRAPHS[plant])]


def read_attachments(paths: Sequence[Path]) -> dict[str, bytes]:
    """Return the contents of files by name; ValueError for a name that comes twice or an unreadable file."""
    attachments: dict[str, bytes] = {}
    for path in paths:
        if path.name in attachments:
            raise ValueError(f"attachments: two files are named {path.name}")
        try:
            attachments[path.name] = path.read_bytes()
        except OSError as error:
            raise ValueError(f"attachments: {path}: {error.strerror}") from error
    return attachments
