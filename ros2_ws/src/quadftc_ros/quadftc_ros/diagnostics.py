"""/diagnostics of a node: its statuses, once a second and whenever a level changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from quadftc_ros.conversions import NANOSECONDS, time_message
from quadftc_ros.qos import topic_profile
from quadftc_ros.tap import Tap, tapped

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


class Diagnostics:
    """What a node reports of itself.

    Parameters
    ----------
    node : Node
        Statuses are named ``<node>: <part>``.
    hardware_id : str
        The vehicle.
    refresh : callable
        Called before every message, to report what is too costly to report with every sample.
    tap : callable, optional
        As of `GraphNode`.
    """

    def __init__(
        self, node: Node, hardware_id: str, refresh: Callable[[], None], tap: Tap | None = None
    ) -> None:
        self._refresh = refresh
        self._name = node.get_fully_qualified_name().lstrip("/")
        self._hardware_id = hardware_id
        profile = topic_profile("reliable", "realtime")
        self._publish = tapped(node.create_publisher(DiagnosticArray, "/diagnostics", profile), tap)
        self._statuses: dict[str, DiagnosticStatus] = {}
        self._counts: Counter[str] = Counter()
        self._counted = False  # since the last message
        self._due_ns = 0
        self.changed = False

    def report(self, part: str, level: bytes, message: str, **values: object) -> None:
        """Set the status of one part; a changed level or message is published with the next :meth:`tick`."""
        status = self._statuses.get(part)
        if status is None:
            status = DiagnosticStatus(name=f"{self._name}: {part}", hardware_id=self._hardware_id)
            self._statuses[part] = status
            self.changed = True
        if (status.level, status.message) != (level, message):
            status.level, status.message = level, message
            self.changed = True
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]

    def forget(self, part: str) -> None:
        """Report a part no longer."""
        self._statuses.pop(part, None)

    def count(self, event: str) -> None:
        """Count something that should not happen; the counts are part of every message.

        The status ``samples`` is a warning when something was counted since the last message.
        """
        self._counts[event] += 1
        self._counted = True
        samples = self._statuses.get("samples")
        if samples is None or samples.level == OK:
            self.changed = True

    @property
    def counts(self) -> Counter[str]:
        """What was counted so far, and how often."""
        return self._counts

    def tick(self, stamp_ns: int) -> None:
        """Publish if a second has passed since the last time, or something changed [stamp in ns]."""
        if stamp_ns < self._due_ns and not self.changed and self._due_ns - stamp_ns <= NANOSECONDS:
            return
        self.publish(stamp_ns)

    def publish(self, stamp_ns: int) -> None:
        """Publish all statuses now [stamp in ns; 0: before the flight]."""
        self._due_ns = stamp_ns + NANOSECONDS if stamp_ns else 0
        self._refresh()
        level, words = (WARN, "some were rejected or doubtful") if self._counted else (OK, "all used")
        self.report("samples", level, words, **self._counts)
        self.changed = self._counted = False
        message = DiagnosticArray(status=[self._statuses[part] for part in sorted(self._statuses)])
        message.header.stamp = time_message(stamp_ns)
        self._publish(message)
