"""/diagnostics of a node: its statuses, once a second and whenever a level changes; rate and latency."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from quadftc_bags.cdr.writer import MessageWriter
from quadftc_ros.conversions import NANOSECONDS
from quadftc_ros.qos import topic_profile
from quadftc_ros.transport import Tap, tapped

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
WINDOW_NS = 900_000_000  # ns; shorter ones say little: diagnostics come at once on a change
LATE = 2.0  # periods; one may pass in the sensor itself


class _Status(NamedTuple):
    """What is said of one part."""

    level: bytes
    message: str
    values: Mapping[str, object]


class Diagnostics:
    """What a node reports of itself; statuses are named ``<node>: <part>``, ``hardware_id`` is the vehicle.

    ``refresh`` is called before every message, to report what is too costly to report with every sample.
    """

    def __init__(
        self, node: Node, hardware_id: str, refresh: Callable[[], None], tap: Tap | None = None
    ) -> None:
        self._refresh, self._hardware_id = refresh, hardware_id
        self._name = node.get_fully_qualified_name().lstrip("/")
        profile = topic_profile("reliable", "realtime")
        self._publish = tapped(node.create_publisher(DiagnosticArray, "/diagnostics", profile), tap)
        self._statuses: dict[str, _Status] = {}
        self.counts: Counter[str] = Counter()  # what should not have happened, and how often it did
        self._counted = False  # since the last message
        self._due_ns = 0
        self.changed = False

    def report(self, part: str, level: bytes, message: str, **values: object) -> None:
        """Set the status of one part; a changed level or message is published with the next :meth:`tick`."""
        last = self._statuses.get(part)
        self.changed |= last is None or last[:2] != (level, message)
        self._statuses[part] = _Status(level, message, values)

    def forget(self, *parts: str) -> None:
        """Report parts no longer."""
        for part in parts:
            self._statuses.pop(part, None)

    def count(self, event: str) -> None:
        """Count something that should not happen; the counts are part of every message.

        The status ``samples`` is a warning when something was counted since the last message.
        """
        self.counts[event] += 1
        self._counted = True
        self.changed |= "samples" not in self._statuses or self._statuses["samples"].level == OK

    def tick(self, stamp_ns: int) -> None:
        """Publish if a second has passed since the last time, or something changed [stamp in ns]."""
        if self.changed or not 0 < self._due_ns - stamp_ns <= NANOSECONDS:
            self.publish(stamp_ns)

    def publish(self, stamp_ns: int) -> None:
        """Publish all statuses now [stamp in ns; 0: before the flight]."""
        self._due_ns = stamp_ns + NANOSECONDS if stamp_ns else 0
        self._refresh()
        level, words = (WARN, "some were rejected or doubtful") if self._counted else (OK, "all used")
        self.report("samples", level, words, **self.counts)
        self.changed = self._counted = False
        writer = MessageWriter(stamp_ns)
        writer.number("I", len(self._statuses))
        for part, status in sorted(self._statuses.items()):
            writer.number("B", status.level[0])
            writer.text(f"{self._name}: {part}")
            writer.text(status.message)
            writer.text(self._hardware_id)
            writer.number("I", len(status.values))
            for key, value in status.values.items():
                writer.text(key)
                writer.text(str(value))
        self._publish(writer.data)


class SampleTiming:
    """Rate and latency of the samples of the last second, or since the diagnostics before if that is longer.

    Latency is the age of a sample when the node is done with it. Without a ``clock``, rates count by the
    stamps, and there is no latency.
    """

    def __init__(self, clock: bool) -> None:
        self._clock = clock
        self._stamp_ns = -1  # newest
        self._begin_ns = 0  # of the window
        self._ages_ns: list[int] = []
        self._values: dict[str, object] = {}
        self.began = False  # whether there was a sample at all
        self.idle = False  # whether no sample came in the window before
        self.late = False  # whether samples in the window before were older than `LATE` on average

    def sampled(self, stamp_ns: int, now_ns: int = 0) -> None:
        """Note that the sample of a stamp was served [ns]; one that was noted before does not count."""
        if stamp_ns == self._stamp_ns:
            return
        if not self.began or (not self._clock and stamp_ns < self._stamp_ns):  # the first, or a new flight
            self.began, self._begin_ns = True, now_ns if self._clock else stamp_ns
            self._ages_ns.clear()
        else:
            self._ages_ns.append(now_ns - stamp_ns)
        self._stamp_ns = stamp_ns

    def values(self, now_ns: int = 0) -> dict[str, object]:
        """Return ``rate_hz``, ``latency_ms`` and ``latency_max_ms`` of the last window, as text."""
        end_ns = now_ns if self._clock else self._stamp_ns
        passed_ns = end_ns - self._begin_ns
        if self.began and not 0 <= passed_ns < WINDOW_NS:
            count = len(self._ages_ns)
            self.idle, self.late, self._values = not count, False, {}
            if passed_ns > 0:  # else the clock was set back
                self._values["rate_hz"] = f"{count * NANOSECONDS / passed_ns:.1f}"
                if self._clock and count:
                    mean_ns = sum(self._ages_ns) / count
                    self.late = mean_ns > LATE * passed_ns / count
                    self._values["latency_ms"] = f"{mean_ns * 1e-6:.2f}"
                    self._values["latency_max_ms"] = f"{max(self._ages_ns) * 1e-6:.2f}"
            self._begin_ns = end_ns
            self._ages_ns.clear()
        return self._values
