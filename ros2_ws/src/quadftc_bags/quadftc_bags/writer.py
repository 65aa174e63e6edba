# pyright: basic
"""Recording that never makes the caller wait for a disk: a bounded queue before a thread that writes the bag.

`BagWriter.write` appends to the queue and returns; the thread builds and compresses chunks, and four times a
second hands everything to the operating system. A killed recorder therefore loses less than a second, however
slow the disk, and what is there can be read. Twice a second another thread makes the disk take it and updates
``metadata.yaml``, for the case of a power cut.

Two ways of working:

real time
    Messages are stored in the order of arrival. A full queue drops the message and counts it: with the
    messages of the graph, of 0.1 to 0.5 kB, the queue does not grow beyond 50 MB.
lock-step
    A full queue makes the caller wait. Messages are stored in the order (log time, topic) and chunks are cut
    at multiples of 0.1 s of log time, so that two runs with the same messages give the same file, byte by
    byte, whatever the threads did; padding inside the messages is set to zero for that. A message is held for
    up to 0.3 s of log time, but not longer than 0.75 s: in flights slower than 0.4 of real time crash safety
    comes first, and only the order within each topic is the same.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile

from quadftc_bags.bag_format import TopicRecord, offered_qos
from quadftc_bags.bag_order import HeldMessages, Message
from quadftc_bags.cdr.padding import PaddingCleaner
from quadftc_bags.interfaces import load_interface

if TYPE_CHECKING:
    from quadftc_bags.bag_file import BagFile

FLUSH_PERIOD = 0.25  # s, wall time: everything older is with the operating system
SYNC_PERIOD = 0.5  # s, wall time between two times at which the disk is to take it
POLL_PERIOD = 0.005  # s, wall time between two looks at the queue
SLICE = 16  # messages built in one go (about 60 us) before other threads get their turn
SLICE_PAUSE = 1e-4  # s
REALTIME_CHUNK = 256 * 1024  # bytes; closing one holds the interpreter for about 0.3 ms
LOCKSTEP_CHUNK = 4 * 1024 * 1024  # bytes, never reached at usual rates: chunks are cut by log time

Command = Callable[[], None]
Input = Callable[[bytes, int, int], bool]


@dataclass(frozen=True)
class BagStatus:
    """How a recording stands."""

    counts: Mapping[str, int]  # messages stored, by topic
    dropped: Mapping[str, int]  # refused, as the queue was full or the writer closed; topics with any
    lost: int  # messages accepted that could not be stored because of ``error``
    error: str | None  # what stopped the recording (disk full, for instance)


class BagWriter:
    """Write one rosbag2 bag (MCAP) from any thread.

    Parameters
    ----------
    directory, attachments, metadata, compression
        As of `BagFile`.
    lockstep : bool
        See the module's text.
    queue_size : int
        Messages that may wait.
    on_error : callable or None
        Called once, from the writing thread, with the text of the error that stopped the recording.

    Raises FileExistsError if the directory exists; ValueError if the compression is unknown or the queue
    holds no message; OSError if the directory cannot be written. Later errors are never raised: see
    ``status``.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
        compression: str = "zstd",
        *,
        lockstep: bool = False,
        queue_size: int = 65536,
        on_error: Callable[[str], object] | None = None,
    ) -> None:
        from quadftc_bags.bag_file import BagFile

        if queue_size < 1:
            raise ValueError(f"queue_size: {queue_size} messages, expected at least 1")
        chunk_size = LOCKSTEP_CHUNK if lockstep else REALTIME_CHUNK
        self._file = BagFile(directory, attachments or {}, metadata or {}, compression, chunk_size)
        self.path = self._file.path
        self._lockstep = lockstep
        self._queue_size = queue_size
        self._on_error = on_error
        self._channels: dict[str, int] = {}
        self._queue: deque[Message | Command | _Flush] = deque()
        self._held = HeldMessages() if lockstep else None
        self._disk = _DiskSync(self._file)
        self._cleaners: list[PaddingCleaner] = []  # by channel number - 1
        self._dropped: dict[str, int] = {}
        self._taken = 0  # messages that have left the queue
        self._error: str | None = None
        self._closed = False
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bag_writer", daemon=True)
        self._thread.start()

    def add_topic(self, topic: str, type_name: str, qos: QoSProfile) -> None:
        """Declare a topic; ``qos`` is what its publisher offers.

        Raises ValueError if the topic is there already or the type is not installed.
        """
        if topic in self._channels:
            raise ValueError(f"topic '{topic}': in the bag already")
        interface = load_interface(type_name)
        record = TopicRecord(topic, type_name, interface.type_hash, offered_qos(qos))
        if self._lockstep:
            self._cleaners.append(PaddingCleaner(type_name))
        self._channels[topic] = len(self._channels) + 1
        self._queue.append(lambda: self._file.add_topic(record, interface.text))

    def input(self, topic: str) -> Input:
        """Return what queues a serialised message of a topic: ``(data, log time, publish time)``, in ns.

        It returns whether the message was accepted, and never raises for the disk's sake.

        Raises KeyError if the topic has not been added.
        """
        channel, queue = self._channels[topic], self._queue

        def write(data: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
            if (len(queue) >= self._queue_size or self._closed) and not self._wait_for_room():
                self._dropped[topic] = self._dropped.get(topic, 0) + 1
                return False
            queue.append((channel, log_time_ns, publish_time_ns, data))
            return True

        return write

    def write(self, topic: str, cdr_bytes: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
        """Queue a serialised message, as :meth:`input` does."""
        return self.input(topic)(cdr_bytes, log_time_ns, publish_time_ns)

    def flush(self, timeout: float = 10.0) -> bool:
        """Wait up to ``timeout`` [s] until everything written before is on the disk; return whether it is."""
        request = _Flush()
        if not self._closed:
            self._queue.append(request)
            self._wake.set()
            request.wait(timeout)
        return request.stored

    def close(self) -> BagStatus:
        """Store what is queued, end the file, and return how it went; a second call only returns that.

        A Ctrl-C meanwhile is raised when the file is complete.
        """
        self._closed = True
        self._wake.set()
        try:
            self._thread.join()
        finally:
            self._thread.join()
        return self.status

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    @property
    def status(self) -> BagStatus:
        """How the recording stands now."""
        counts = dict(self._file.counts)
        lost = 0 if self._error is None else self._taken - sum(counts.values())
        return BagStatus(counts, dict(self._dropped), lost, self._error)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wait_for_room(self) -> bool:
        """In lock-step wait for room in the queue; return whether there is any."""
        while self._lockstep and not self._closed:
            if len(self._queue) < self._queue_size:
                return True
            self._wake.set()
            time.sleep(SLICE_PAUSE)
        return False

    def _run(self) -> None:
        """Write until closed and the queue is empty (the writing thread)."""
        begin = time.monotonic()
        next_flush, next_sync = begin + FLUSH_PERIOD, begin + SYNC_PERIOD
        while True:
            last_round = self._closed
            self._attempt(self._drain)
            if self._is_due(next_flush):
                self._attempt(self._flush)
                next_flush = time.monotonic() + FLUSH_PERIOD
            if time.monotonic() >= next_sync:
                self._attempt(self._disk.begin)
                next_sync = time.monotonic() + SYNC_PERIOD
            if last_round and not self._queue:
                break
            self._wake.wait(POLL_PERIOD)
            self._wake.clear()
        self._attempt(self._finish)

    def _attempt(self, action: Command) -> None:
        """Do something with the file; after the first error only count what is lost."""
        try:
            if self._error is None:
                action()
        except Exception as error:  # the caller flies on, whatever is wrong with the bag
            self._fail(error)
        if self._error is not None:
            self._discard()

    def _drain(self) -> None:
        """Write what is queued by now."""
        for number in range(1, len(self._queue) + 1):
            item = self._queue.popleft()
            if isinstance(item, tuple):
                self._taken += 1
                self._store(item)
            elif isinstance(item, _Flush):
                self._flush_for(item)
            else:
                item()
            if number % SLICE == 0 and not self._lockstep:
                time.sleep(SLICE_PAUSE)

    def _store(self, message: Message) -> None:
        """Write a message; in lock-step hold it until its place is certain, and cut chunks by log time."""
        if self._held is None:
            self._file.write(*message)
            return
        channel, log_time_ns, publish_time_ns, data = message
        data = self._cleaners[channel - 1].clean(data)
        if self._held.add((channel, log_time_ns, publish_time_ns, data)):
            for ready in self._held.take():
                self._file.write(*ready)
            self._file.flush()

    def _flush_for(self, request: _Flush) -> None:
        try:
            self._flush()
            self._disk.wait()
            self._file.sync()
            request.stored = True
        finally:
            request.set()

    def _release_all(self) -> None:
        if self._held is not None:
            for message in self._held.take_all():
                self._file.write(*message)

    def _is_due(self, next_flush: float) -> bool:
        """Whether it is time to flush: by the clock, in lock-step when a message was held for too long."""
        return time.monotonic() >= next_flush if self._held is None else self._held.is_stale()

    def _flush(self) -> None:
        self._release_all()
        self._file.flush()

    def _finish(self) -> None:
        self._release_all()
        self._disk.wait()
        self._file.close()

    def _fail(self, error: Exception) -> None:
        """Give up the file at its last complete chunk."""
        self._error = f"{self.path}: {getattr(error, 'strerror', None) or repr(error)}"
        with suppress(Exception):  # the first error counts
            self._disk.wait()
        self._file.abandon()
        if self._on_error is not None:
            with suppress(Exception):  # a failing callback must not end the thread that others wait for
                self._on_error(self._error)

    def _discard(self) -> None:
        """Empty the queue, count what is lost with it, and let go whoever waits for a flush."""
        while self._queue:
            item = self._queue.popleft()
            if isinstance(item, tuple):
                self._taken += 1
            elif isinstance(item, _Flush):
                item.set()


class _Flush(threading.Event):
    """A request to bring everything to the disk; set when it was dealt with."""

    stored = False


class _DiskSync:
    """Runs `BagFile.sync` in a thread, one at a time, so that a slow disk does not hold up the writing."""

    def __init__(self, file: BagFile) -> None:
        self._file = file
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None

    def begin(self) -> None:
        """Begin a sync unless the last one still runs; raises what went wrong the last time."""
        if self._thread is None or not self._thread.is_alive():
            self.wait()
            self._thread = threading.Thread(target=self._run, name="bag_sync", daemon=True)
            self._thread.start()

    def wait(self) -> None:
        """Wait for the sync that runs, if any; raises as `begin`."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def _run(self) -> None:
        try:
            self._file.sync()
        except Exception as error:  # for whoever asks next
            self._error = error
