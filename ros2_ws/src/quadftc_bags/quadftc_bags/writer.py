# pyright: basic
"""Writing a bag while it is recorded, so that little is lost by whoever kills the process or cuts the power.

Four times a second `BagWriter` hands everything to the operating system: a killed recorder loses less than a
second, however slow the disk. Twice a second another thread makes the disk take it and updates
``metadata.yaml``, for the case of a power cut.

In real time messages are stored in the order of arrival, in lock-step in the order (log time, topic). Chunks
are cut at multiples of 0.1 s of log time, with zero padding inside the messages. So two runs with the same
messages give the same file, byte by byte. A message is held for up to 0.3 s of log time, but not longer than
0.75 s. So in flights slower than 0.4 of real time only the order within each topic is the same: crash safety
comes first.
"""

from __future__ import annotations

import math
import os
import time
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING

from quadftc_bags.bag_format import TopicRecord, describe_topic
from quadftc_bags.cdr.layout import PaddingCleaner

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

FLUSH_PERIOD = 0.25  # s, wall time: everything older is with the operating system
SYNC_PERIOD = 0.5  # s, wall time between two times at which the disk is to take it
REALTIME_CHUNK = 256 * 1024  # bytes
LOCKSTEP_CHUNK = 4 * 1024 * 1024  # bytes, never reached at usual rates: chunks are cut by log time
CUT_PERIOD_NS = 100_000_000  # ns of log time between two cuts
CUT_DELAY_NS = 200_000_000  # ns of log time that a message may come late without losing its place
HOLD_PERIOD = 0.75  # s, wall time that a message may be held (0.4 of real time) before order gives way

Message = tuple[int, int, int, bytes]  # channel, log time [ns], publish time [ns], data


@dataclass(frozen=True)
class BagStatus:
    """How a recording stands."""

    counts: Mapping[str, int]  # messages stored, by topic
    dropped: Mapping[str, int]  # refused, as the queue was full or the writer closed; topics with any
    lost: int  # messages accepted that could not be stored because of ``error``
    error: str | None  # what stopped the recording (disk full, for instance)


class BagWriter(AbstractContextManager["BagWriter"]):
    """Write one rosbag2 bag (MCAP) from one thread, which may have to wait for the file, not for the disk.

    Call `tick` when no messages come. Parameters and errors are those of `BagFile`; for ``lockstep`` see the
    module's text. Later errors are never raised: see ``status``.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
        compression: str = "zstd",
        *,
        lockstep: bool = False,
    ) -> None:
        from quadftc_bags.bag_file import BagFile  # takes long, and is for the process that writes only

        chunk_size = LOCKSTEP_CHUNK if lockstep else REALTIME_CHUNK
        self._file = BagFile(directory, attachments or {}, metadata or {}, compression, chunk_size)
        self.path = self._file.path
        self.closed = False  # whether `close` was called
        self._held = HeldMessages() if lockstep else None
        self._channels: dict[str, int] = {}
        self._cleaners: list[PaddingCleaner] = []  # by channel number - 1
        self._dropped: Counter[str] = Counter()
        self._accepted = 0
        self._error: str | None = None
        self._threads = ThreadPoolExecutor(1, "bag_sync")
        self._sync: Future[None] | None = None
        self._flush_due = time.monotonic() + FLUSH_PERIOD
        self._sync_due = time.monotonic() + SYNC_PERIOD

    def add_topic(self, topic: str, type_name: str, qos: QoSProfile) -> None:
        """Declare a topic whose publisher offers ``qos``; ValueError if it is there or its type unknown."""
        if topic in self._channels:
            raise ValueError(f"topic '{topic}': in the bag already")
        self.add(describe_topic(topic, type_name, qos))

    def add(self, topic: TopicRecord) -> None:
        """Declare a topic; topics are numbered from 1 in the order of calls."""
        if self._held is not None:
            self._cleaners.append(PaddingCleaner(topic.type_name))
        self._channels[topic.name] = len(self._channels) + 1
        self._attempt(self._file.add_topic, topic)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
        """Store a serialised message, until `close`; return whether it was accepted."""
        channel = self._channels[topic]
        if self.closed:
            self._dropped[topic] += 1
            return False
        self.store((channel, log_time_ns, publish_time_ns, data))
        self.tick()
        return True

    def store(self, message: Message) -> None:
        """Store a message of a topic by its number; in lock-step hold it until its place is certain."""
        self._accepted += 1
        self._attempt(self._store, message)

    def tick(self) -> None:
        """Do what is due; to be called at least every 50 ms or so."""
        if self.closed:
            return
        now = time.monotonic()
        # in lock-step when a message was held for too long
        if now >= self._flush_due if self._held is None else self._held.is_stale(now):
            self._attempt(self._flush)
            self._flush_due = time.monotonic() + FLUSH_PERIOD
        if now >= self._sync_due:
            self._attempt(self._begin_sync)
            self._sync_due = time.monotonic() + SYNC_PERIOD

    def flush(self) -> bool:
        """Wait until everything written before is on the disk; return whether it is."""
        return not self.closed and self._attempt(self._flush_then, self._file.sync)

    def close(self) -> BagStatus:
        """End the file, and return how it went; a second call only returns that."""
        if not self.closed:
            self.closed = True
            self._attempt(self._flush_then, self._file.close)
            self._threads.shutdown()
        return self.status

    @property
    def status(self) -> BagStatus:
        """How the recording stands now."""
        counts = dict(self._file.counts)
        lost = 0 if self._error is None else self._accepted - sum(counts.values())
        return BagStatus(counts, dict(self._dropped), lost, self._error)

    def __exit__(self, *_: object) -> None:
        self.close()

    def _attempt(self, action: Callable[..., None], *arguments: object) -> bool:
        """Do something with the file until the first error; return whether it was done."""
        if self._error is not None:
            return False
        try:
            action(*arguments)
        except Exception as error:  # the vehicle flies on, whatever is wrong with the bag
            self._error = f"{self.path}: {getattr(error, 'strerror', None) or repr(error)}"
            with suppress(Exception):  # the first error counts
                self._wait_for_sync()
            self._file.abandon()
        return self._error is None

    def _store(self, message: Message) -> None:
        if self._held is None:
            self._file.write(*message)
            return
        data = self._cleaners[message[0] - 1].clean(message[3])
        if cut_ns := self._held.add((*message[:3], data)):
            self._flush(cut_ns)

    def _flush(self, before_ns: int | None = None) -> None:
        """Hand all to the operating system; in lock-step what is before a log time [ns], if that is given."""
        for message in self._held.take(before_ns) if self._held else ():
            self._file.write(*message)
        self._file.flush()

    def _flush_then(self, action: Callable[[], None]) -> None:
        """Flush, and act when no sync runs."""
        self._flush()
        self._wait_for_sync()
        action()

    def _begin_sync(self) -> None:
        """Begin a sync unless the last one still runs; raises what went wrong the last time."""
        if self._sync is None or self._sync.done():
            self._wait_for_sync()
            self._sync = self._threads.submit(self._file.sync)

    def _wait_for_sync(self) -> None:
        """Wait for the sync that runs, if any; raises what went wrong."""
        if self._sync is not None:
            sync, self._sync = self._sync, None
            sync.result()


class HeldMessages:
    """Messages of a lock-step recording whose place in the file is not certain yet."""

    def __init__(self) -> None:
        self._messages: list[Message] = []
        self._cut_ns: int | None = None  # log time of the last cut
        self._newest_ns = 0
        self._arrivals: deque[tuple[int, float]] = deque()  # log time not reached before [ns], wall time [s]

    def add(self, message: Message) -> int | None:
        """Add a message; return the log time [ns] of the next cut, if it is certain what is before it."""
        log_time_ns = message[1]
        if not self._arrivals or log_time_ns > self._arrivals[-1][0]:
            self._arrivals.append((log_time_ns, time.monotonic()))
        self._messages.append(message)
        if self._cut_ns is None:
            self._cut_ns = log_time_ns - log_time_ns % CUT_PERIOD_NS
        self._newest_ns = max(self._newest_ns, log_time_ns)
        cut_ns = (self._newest_ns - CUT_DELAY_NS) // CUT_PERIOD_NS * CUT_PERIOD_NS
        if cut_ns <= self._cut_ns:
            return None
        self._cut_ns = cut_ns
        return cut_ns

    def take(self, before_ns: int | None) -> list[Message]:
        """Take the messages before a log time [ns], by default all, in the order (log time, channel)."""
        end_ns = math.inf if before_ns is None else before_ns
        self._messages.sort(key=itemgetter(1, 0))
        split = bisect_left(self._messages, end_ns, key=itemgetter(1))
        taken, self._messages = self._messages[:split], self._messages[split:]
        while self._arrivals and self._arrivals[0][0] < end_ns:
            self._arrivals.popleft()
        return taken

    def is_stale(self, now: float) -> bool:
        """Return whether a message has been held for so long that a killed process would lose too much."""
        return bool(self._arrivals) and now - self._arrivals[0][1] > HOLD_PERIOD
