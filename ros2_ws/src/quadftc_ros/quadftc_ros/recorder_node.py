"""The recorder: writes the topics of the graph into one rosbag2 (MCAP) bag.

Subscriptions: the topics of `quadftc_ros.topics.TOPICS`, as serialised bytes; in one process with the other
nodes none, as these hand over what they publish. Publications: /diagnostics.

The stored log time is in real time when the message was received; in lock-step it is the message's own stamp,
so that two runs give the same bag. What is sent in lock-step before the flight has no stamp yet and is not
stored: how much of it there is depends on how fast the processes start.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import os
import platform
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile
from rclpy.utilities import get_rmw_implementation_identifier

from quadftc_bags.bag_format import COMPRESSIONS
from quadftc_bags.cdr.message import leading_stamp_ns
from quadftc_bags.interfaces import load_message_class
from quadftc_bags.writer import BagStatus, BagWriter, Input
from quadftc_bags.writer_process import BagProcess
from quadftc_model.parameters import parameter
from quadftc_ros.conversions import END_NS
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_ros.qos import topic_profile
from quadftc_ros.tap import Take
from quadftc_ros.topics import TOPICS, Topic

RECEIVE_DEPTH = {"lockstep": 10000, "realtime": 1000}  # messages per topic that may wait for this node
CHECK_PERIOD = 1.0  # s, between two looks at how the recording stands
HAND_OVER_PERIOD = 0.25  # s, for which a message may wait for others to go to the other process with it


@dataclasses.dataclass(frozen=True)
class RecorderParameters:
    """Parameters of the recorder, beside the lists ``topics`` and ``attachments``."""

    directory: str = parameter("", doc="directory of the bag to write; must not exist")
    compression: str = parameter("zstd", choices=COMPRESSIONS, doc="compression of the bag's chunks")


class RecorderNode(GraphNode):
    """Record topics from construction until `finish`, or until the node is destroyed.

    Parameters
    ----------
    subscribes : bool
        Else it gets its messages from nodes in the same process, by its `tap`.
    **kwargs
        Those of ``rclpy.node.Node`` (``context``, ``namespace``, ``parameter_overrides``...).

    Raises
    ------
    ValueError
        If a parameter is wrong: the directory exists or cannot be made, a topic is not in the table, an
        attachment cannot be read.
    """

    def __init__(self, *, subscribes: bool = True, **kwargs: Any) -> None:
        super().__init__("recorder", None if subscribes else self._tap_of_its_own, **kwargs)
        self.settings.declare(RecorderParameters, read_only=True)
        self.settings.declare_list(
            "topics", "topics to record, as named in the table of the graph; empty: all"
        )
        self.settings.declare_list("attachments", "paths of files to store inside the bag")
        values = self.settings.values()
        rows = _checked_topics(values["topics"] or list(TOPICS))
        classes = [load_message_class(row.type_name) for row in rows]
        self._newest_ns = 0
        self.received = 0  # messages so far, stored or still waiting to be
        self._writer = self._open(values, BagWriter if subscribes else BagProcess)
        self._takes: dict[str, Take] = {}
        for row, message_class in zip(rows, classes, strict=True):
            self._record(row, message_class, subscribes)
        self.flush()  # it takes time to get ready for the topics, which is not to be that of the flight
        self.create_timer(CHECK_PERIOD, self._check)
        if isinstance(self._writer, BagProcess):
            self.create_timer(HAND_OVER_PERIOD, self._writer.hand_over, clock=self.steady_clock)
        self.ready()

    @property
    def path(self) -> Path:
        """The MCAP file being written."""
        return self._writer.path

    @property
    def status(self) -> BagStatus:
        """Messages stored by topic, messages dropped or lost, and the error that stopped the recording."""
        return self._writer.status

    @property
    def process_id(self) -> int | None:
        """Of the process that writes the bag, if it is another one."""
        return self._writer.process_id if isinstance(self._writer, BagProcess) else None

    def flush(self) -> bool:
        """Wait until all that was received is on the disk; return whether it is."""
        return self._writer.flush()

    def finish(self) -> BagStatus:
        """Close the bag and return how it went; a second call only returns that."""
        return self._writer.close()

    def destroy_node(self) -> None:
        """Close the bag before the rest."""
        status = self.finish()
        missing = sum(status.dropped.values()) + status.lost
        if missing:
            self.get_logger().error(f"{missing} messages are not in {self.path}")
        super().destroy_node()

    def _open(self, values: dict[str, Any], kind: type[BagWriter | BagProcess]) -> BagWriter | BagProcess:
        if not values["directory"]:
            raise ValueError("directory = '': expected the path of a new directory")
        try:
            return kind(
                values["directory"],
                _read_attachments([Path(path) for path in values["attachments"]]),
                {"mode": self.mode, **versions()},
                values["compression"],
                lockstep=self.lockstep,
                on_error=self._stopped,
            )
        except OSError as error:
            raise ValueError(f"directory = '{values['directory']}': {error}") from error

    def tap(self, topic: str) -> Take | None:
        """Return what takes the serialised messages of a topic (its full name); None: it is not recorded."""
        return self._takes.get(topic)

    def _tap_of_its_own(self, topic: str) -> Take:
        def take(data: bytes) -> None:  # known only when the bag has been made
            self._takes.get(topic, _leave)(data)

        return take

    def _record(self, row: Topic, message_class: type, subscribes: bool) -> None:
        """Store what comes on a topic under its full name."""
        offered = topic_profile(row.qos, self.mode)
        wanted = QoSProfile(
            depth=RECEIVE_DEPTH[self.mode], reliability=offered.reliability, durability=offered.durability
        )
        name = self.resolve_topic_name(row.name)
        self._writer.add_topic(name, row.type_name, offered)
        take = partial(
            self._take_by_stamp if self.lockstep else self._take_by_clock, self._writer.input(name)
        )
        self._takes[name] = take
        if subscribes:
            self.create_subscription(message_class, row.name, take, wanted, raw=True)

    def _take_by_stamp(self, write: Input, data: bytes) -> None:
        try:
            stamp_ns = leading_stamp_ns(data)
        except ValueError:
            stamp_ns = END_NS
        if not 0 <= stamp_ns < END_NS:
            self.diagnostics.count("messages without a stamp, not recorded")
        elif stamp_ns:
            self._flying = True
            self._newest_ns = stamp_ns
            self.received += 1
            write(data, stamp_ns, stamp_ns)

    def _take_by_clock(self, write: Input, data: bytes) -> None:
        now_ns = time.time_ns()
        self.received += 1
        write(data, now_ns, now_ns)

    def _stopped(self, error: str) -> None:
        self.get_logger().error(f"recording has stopped: {error}")

    def _check(self) -> None:
        """Report how the recording stands; in lock-step, where all goes by samples, only what is wrong."""
        status = self.status
        dropped = sum(status.dropped.values())
        level, message = OK, "recording"
        if status.error is not None:
            level, message = ERROR, f"recording has stopped: {status.error}"
        elif dropped:
            level, message = WARN, "messages were dropped"
        stored = sum(status.counts.values())
        self.diagnostics.report("bag", level, message, stored=stored, dropped=dropped, lost=status.lost)
        if self.lockstep and level != OK and self.diagnostics.changed:
            self.diagnostics.publish(self._newest_ns)


def _leave(data: bytes) -> None:
    """Take nothing."""


def versions() -> dict[str, str]:
    """Return what recorded this bag: versions of this software and of what it stands on."""
    return {
        "quadftc": importlib.metadata.version("quadftc-ros"),
        "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
        "rmw_implementation": get_rmw_implementation_identifier(),
        "python": platform.python_version(),
        "mcap": importlib.metadata.version("mcap"),
        "numpy": importlib.metadata.version("numpy"),
    }


def _checked_topics(names: list[str]) -> list[Topic]:
    unknown = sorted(set(names) - set(TOPICS))
    if unknown:
        raise ValueError(f"topics: unknown {', '.join(unknown)}; known are {', '.join(TOPICS)}")
    return [TOPICS[name] for name in dict.fromkeys(names)]


def _read_attachments(paths: list[Path]) -> dict[str, bytes]:
    attachments: dict[str, bytes] = {}
    for path in paths:
        if path.name in attachments:
            raise ValueError(f"attachments: two files are named {path.name}")
        try:
            attachments[path.name] = path.read_bytes()
        except OSError as error:
            raise ValueError(f"attachments: {path}: {error.strerror}") from error
    return attachments


def main() -> int:
    """Record until SIGINT or SIGTERM; return 0, 1 if the recording was cut short, or 2 on bad parameters."""
    made: list[RecorderNode] = []

    def make() -> RecorderNode:
        made.append(RecorderNode())
        return made[0]

    try:
        code = run_node(make)
    except KeyboardInterrupt:  # a second Ctrl-C while the bag was being closed: it is closed
        code = 0
    return 1 if made and made[0].status.error is not None else code


if __name__ == "__main__":
    sys.exit(main())
