"""The recorder: writes the topics of the graph into one rosbag2 (MCAP) bag.

Subscriptions: the topics of `quadftc_ros.topics.TOPICS`, as serialised bytes; in one process with the other
nodes none, as these hand over what they publish. Publications: /diagnostics.

The stored log time is in real time when the message was received; in lock-step it is the message's own stamp,
so that two runs give the same bag.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any

from quadftc_bags.bag_format import COMPRESSIONS
from quadftc_bags.cdr.message import leading_stamp_ns
from quadftc_bags.interfaces import load_message_class
from quadftc_bags.writer import BagStatus
from quadftc_bags.writer_process import BagProcess, Input
from quadftc_model.parameters import parameter
from quadftc_ros.conversions import END_NS, wall_ns
from quadftc_ros.diagnostics import OK
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_ros.qos import topic_profile
from quadftc_ros.recorder import choose_topics, judge, read_attachments
from quadftc_ros.topics import Topic
from quadftc_ros.transport import Take
from quadftc_ros.versions import versions

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

    It subscribes to what the nodes ``inside`` its process do not publish; those give it their messages by its
    `tap`. A wrong parameter is a ValueError: the directory exists or cannot be made, a topic is unknown, an
    attachment unreadable.
    """

    def __init__(self, *, inside: Collection[str] = (), **kwargs: Any) -> None:
        super().__init__("recorder", self._tap_of_its_own if inside else None, **kwargs)
        self.settings.declare(RecorderParameters, read_only=True)
        self.settings.declare_list(
            "topics", "topics to record, as named in the table; empty: all of the graph"
        )
        self.settings.declare_list("attachments", "paths of files to store inside the bag")
        values = self.settings.values()
        rows = choose_topics(values["topics"], self.plant_kind)
        self._writer = self._open(values)
        self.path = self._writer.path  # the MCAP file being written
        self.process_id = self._writer.process_id  # of the process that writes it
        self.received = 0  # messages so far, stored or still waiting to be
        self._newest_ns = 0
        self._takes: dict[str, Take] = {}
        for row in rows:
            from_outside = not self.lockstep and not {*row.publishers} & {*inside}
            self._record(row, subscribes=from_outside or not inside)
        self.flush()  # it takes time to get ready for the topics, which is not to be that of the flight
        self.create_timer(CHECK_PERIOD, self._check, clock=self.steady_clock)
        self.create_timer(HAND_OVER_PERIOD, self._writer.hand_over, clock=self.steady_clock)
        self.ready()

    @property
    def status(self) -> BagStatus:
        """Messages stored by topic, messages dropped or lost, and the error that stopped the recording."""
        return self._writer.status

    def flush(self) -> bool:
        """Wait until all that was received is on the disk; return whether it is."""
        return self._writer.flush()

    def finish(self) -> BagStatus:
        """Close the bag and return how it went; a second call only returns that."""
        return self._writer.close()

    def destroy_node(self) -> None:
        """Close the bag before the rest."""
        status = self.finish()
        if missing := sum(status.dropped.values()) + status.lost:
            self.get_logger().error(f"{missing} messages are not in {self.path}")
        super().destroy_node()

    def _open(self, values: dict[str, Any]) -> BagProcess:
        if not values["directory"]:
            raise ValueError("directory = '': expected the path of a new directory")
        try:
            return BagProcess(
                values["directory"],
                read_attachments([Path(path) for path in values["attachments"]]),
                {"mode": self.mode, **versions()},
                values["compression"],
                lockstep=self.lockstep,
                on_error=lambda error: self.get_logger().error(f"recording has stopped: {error}"),
            )
        except OSError as error:
            raise ValueError(f"directory = '{values['directory']}': {error}") from error

    def tap(self, topic: str) -> Take | None:
        """Return what takes the serialised messages of a topic (its full name); None: it is not recorded."""
        return self._takes.get(topic)

    def _tap_of_its_own(self, topic: str) -> Take:
        def take(data: bytes) -> None:
            if record := self._takes.get(topic):  # known only when the bag has been made
                record(data)

        return take

    def _record(self, row: Topic, subscribes: bool) -> None:
        """Store what comes on a topic under the name that the table gives it, whatever it is remapped to."""
        offered, name = topic_profile(row.qos, self.mode), self.resolve_topic_name(row.name)
        stored = self.resolve_topic_name(row.name, only_expand=True)
        self._writer.add_topic(stored, row.type_name, offered)
        taking = self._taking_by_stamp if self.lockstep else self._taking_by_clock
        self._takes[name] = take = taking(self._writer.input(stored))
        if subscribes:
            offered.depth = RECEIVE_DEPTH[self.mode]
            self.guard.subscribe(row.name, load_message_class(row.type_name), take, offered)

    def _taking_by_stamp(self, write: Input) -> Take:
        def take(data: bytes) -> None:
            if not self.active:
                return
            try:
                stamp_ns = leading_stamp_ns(data)
            except ValueError:
                stamp_ns = -1
            if 0 < stamp_ns < END_NS:
                self._flying = True
                self._newest_ns = stamp_ns
                self.received += 1
                write(data, stamp_ns, stamp_ns)
            elif stamp_ns:  # 0: how many come before the flight depends on how fast the processes start
                self.diagnostics.count("messages without a stamp, not recorded")

        return take

    def _taking_by_clock(self, write: Input) -> Take:
        def take(data: bytes) -> None:
            if self.active:
                now_ns = wall_ns()
                self.received += 1
                write(data, now_ns, now_ns)

        return take

    def _check(self) -> None:
        """Report how the recording stands; in lock-step, where all goes by samples, only what is wrong."""
        level, message, values = judge(self.status)
        self.diagnostics.report("bag", level, message, **values)
        if self.lockstep and level != OK and self.diagnostics.changed:
            self.diagnostics.publish(self._newest_ns)


def main() -> int:
    """Record until SIGINT or SIGTERM; return 0, 1 if the recording was cut short, or 2 on bad parameters."""
    made: list[RecorderNode] = []

    def make() -> RecorderNode:
        made.append(RecorderNode())
        return made[0]

    code = run_node(make)
    return 1 if made and made[0].status.error is not None else code


if __name__ == "__main__":
    sys.exit(main())
