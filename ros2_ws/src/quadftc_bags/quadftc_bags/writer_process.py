"""Recording by another process: what it costs the one that flies is a list, handed over now and then.

A thread that writes takes the interpreter from the thread that flies, several hundred times a second. So
`BagProcess` has the interface of `BagWriter`, which does the work in the other process. The two talk through
a pair of sockets. The other process (`serve`) ends when it is told to close the bag, or when the one that
flies has ended, in whatever way. It looks now and then for what has come instead of waiting for it: to wake
another process takes longer than to hand over what there is.
"""

from __future__ import annotations

import dataclasses
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from quadftc_bags.interfaces import load_interface
from quadftc_bags.writer import BagStatus, BagWriter, Input

BATCH = 32  # messages handed over at a time; the socket holds many of these, so that nobody waits
PATIENCE = 60.0  # s, wall time for the other process to take a batch in lock-step, and to end a recording
ENDED = "the process that writes it has ended"
SILENT = "the process that writes it does not answer"
MESSAGES = b"M"  # what a batch begins with; all else is a pickle, which begins with another byte
MESSAGE = struct.Struct(
    "=IIqq"
)  # in a batch: number of the topic, size, log and publish time; then the bytes
REST = 0.005  # s, between two looks at what has come
REPORT_PERIOD = 0.5  # s, wall time between two reports of how the recording stands
NICENESS = 10  # the one that flies comes first
SWITCH_INTERVAL = (
    1e-4  # s; in the other process the thread that receives must not wait for the one that writes
)


class BagProcess:
    """Write one rosbag2 bag (MCAP) from one thread, by another process.

    Parameters
    ----------
    directory, attachments, metadata, compression, lockstep, queue_size
        As of `BagWriter`.
    on_error : callable or None
        Called once, from the thread that writes, with the text of the error that stopped the recording.

    Raises FileExistsError, ValueError, OSError: As of `BagWriter`; an OSError, too, if the other process does
    not start.
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
        self._lockstep = lockstep
        self._queue_size = queue_size
        self._on_error = on_error
        self._topics: dict[str, int] = {}  # and their numbers
        self._batch: list[bytes] = []
        self._limit = BATCH  # messages; when the batch is so long, it is time to hand it over
        self._accepted = 0  # messages handed over so far
        self._dropped: dict[str, int] = {}
        self._status = BagStatus({}, {}, 0, None)  # as the other process has said last
        self._closed = self._ended = self._complete = False  # by us; the process; the bag
        self._silent = False  # it was given up
        self._connection, theirs = Pipe()
        with theirs:
            command = [sys.executable, "-m", "quadftc_bags.writer_process", str(theirs.fileno())]
            # in a session of its own: Ctrl-C in the terminal is for the process that flies
            self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()], start_new_session=True)
        self._writable = select.poll()
        self._writable.register(self._connection, select.POLLOUT)
        files = str(directory), dict(attachments or {}), dict(metadata or {})
        self._send((*files, compression, lockstep, queue_size))
        self.path: Path = self._first_answer()

    @property
    def process_id(self) -> int:
        """Of the process that writes."""
        return self._process.pid

    def add_topic(self, topic: str, type_name: str, qos: QoSProfile) -> None:
        """As of `BagWriter`."""
        if topic in self._topics:
            raise ValueError(f"topic '{topic}': in the bag already")
        load_interface(type_name)  # raises what is wrong here, not there
        self._topics[topic] = len(self._topics)
        self._send(("topic", topic, type_name, qos.depth, qos.reliability.value, qos.durability.value))

    def input(self, topic: str) -> Input:
        """As of `BagWriter`."""
        if topic not in self._topics:
            raise KeyError(topic)
        batch, number, pack = self._batch, self._topics[topic], MESSAGE.pack

        def write(data: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
            if len(batch) >= self._limit and not self._make_room():
                self._dropped[topic] = self._dropped.get(topic, 0) + 1
                return False
            batch.append(pack(number, len(data), log_time_ns, publish_time_ns) + data)
            return True

        return write

    def write(self, topic: str, cdr_bytes: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
        """As of `BagWriter`."""
        return self.input(topic)(cdr_bytes, log_time_ns, publish_time_ns)

    def flush(self, timeout: float = 10.0) -> bool:
        """As of `BagWriter`."""
        if self._closed or not self._hand_over(timeout):
            return False
        self._send(("flush", timeout))
        return self._wait_for(("flushed", "not flushed"), timeout) == "flushed"

    def close(self) -> BagStatus:
        """As of `BagWriter`."""
        if not self._closed:
            if not self._hand_over(PATIENCE):
                self._give_up()
            self._closed, self._limit = True, 0
            self._send(("close",))
            if not self._wait_for(("closed",), PATIENCE) and not self._ended:
                self._give_up()
            self._end()
        return self.status

    @property
    def status(self) -> BagStatus:
        """As of `BagWriter`, not older than a second."""
        self.hand_over()
        dropped = {
            topic: self._dropped.get(topic, 0) + self._status.dropped.get(topic, 0)
            for topic in {*self._dropped, *self._status.dropped}
        }
        lost = self._status.lost
        if (self._ended or self._silent) and not self._complete:  # counts are those of its last report
            lost = self._accepted - sum(self._status.counts.values()) - sum(self._status.dropped.values())
        return dataclasses.replace(self._status, dropped=dropped, lost=lost)

    def hand_over(self) -> None:
        """Hand over what waits, in real time no more than the other process can take at once.

        Call it four times a second, so that nothing waits longer.
        """
        if not self._closed and not self._hand_over(PATIENCE if self._lockstep else 0.0) and self._lockstep:
            self._give_up()

    def __enter__(self) -> BagProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _make_room(self) -> bool:
        """Hand the batch over, in lock-step even if that takes time; return whether there is room now."""
        if self._closed:
            return False
        self.hand_over()
        backlog = len(self._batch) >= BATCH
        self._limit = min(len(self._batch) + BATCH, self._queue_size) if backlog else BATCH
        return len(self._batch) < self._limit

    def _hand_over(self, patience: float) -> bool:
        """Hand over what waits; return whether the other process made room within ``patience`` [s]."""
        batch = self._batch
        while batch and not self._silent and self._writable.poll(1000.0 * patience):
            with suppress(OSError):  # that it has ended shows in what it says last
                self._connection.send_bytes(MESSAGES + b"".join(batch[:BATCH]))
            self._accepted += len(batch[:BATCH])
            del batch[:BATCH]
        while self._receive(0.0):
            pass
        return not batch

    def _give_up(self) -> None:
        """Take the other process for one that never answers: what was for it is lost."""
        self._accepted += len(self._batch)
        self._batch.clear()
        if not self._silent:
            self._silent = True
            self._process.kill()
            self._note(dataclasses.replace(self._status, error=f"{self.path}: {SILENT}"))

    def _send(self, item: object) -> None:
        with suppress(OSError):  # that it has ended shows in what it says last
            self._connection.send(item)

    def _receive(self, timeout: float) -> str:
        """Note what the other process says within a time [s]; return its kind, empty if nothing."""
        if self._ended:
            return ""
        try:
            if not self._connection.poll(timeout):
                return ""
            kind, status = self._connection.recv()
        except (EOFError, OSError):
            self._ended = True
            kind, status = "ended", self._status
            if not self._complete:
                status = dataclasses.replace(status, error=status.error or f"{self.path}: {ENDED}")
        self._complete = self._complete or kind == "closed"
        self._note(status)
        return kind

    def _note(self, status: BagStatus) -> None:
        """Keep what is known of the recording; its first error is reported."""
        known, self._status = self._status.error, status
        if status.error is not None and known is None and self._on_error is not None:
            self._on_error(status.error)

    def _wait_for(self, kinds: tuple[str, ...], timeout: float) -> str:
        """Wait for one of some answers, up to a time [s]; return which, empty if none."""
        end = time.monotonic() + timeout
        while not self._ended and (rest := end - time.monotonic()) > 0.0:
            if (kind := self._receive(rest)) in kinds:
                return kind
        return ""

    def _first_answer(self) -> Path:
        """Return the path of the bag."""
        try:
            answer = self._connection.recv()
        except (EOFError, OSError):
            answer = OSError("the process that was to write the bag has ended")
        if isinstance(answer, Exception):
            self._closed = True
            self._end()
            raise answer
        return answer

    def _end(self) -> None:
        self._connection.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def serve(connection: Connection) -> None:
    """Write the bag that the first message describes, until told to close it or the other side has ended."""
    try:
        directory, attachments, metadata, compression, lockstep, queue_size = connection.recv()
        options = {"lockstep": lockstep, "queue_size": queue_size}
        writer = BagWriter(directory, attachments, metadata, compression, **options)
    except EOFError:
        return
    except (ValueError, OSError) as error:
        connection.send(error)
        return
    with writer, suppress(EOFError, OSError):  # of the connection: the bag is closed then, too
        connection.send(writer.path)
        _Server(connection, writer).serve()


class _Server:
    """Takes what the other process sends, and reports how the recording stands."""

    def __init__(self, connection: Connection, writer: BagWriter) -> None:
        self._connection = connection
        self._writer = writer
        self._inputs: list[Input] = []

    def serve(self) -> None:
        due = 0.0
        while not self._writer.closed:
            while not self._writer.closed and self._connection.poll(0.0):
                self._take(self._connection.recv_bytes())
            time.sleep(REST)
            if (now := time.monotonic()) >= due:
                self._connection.send(("status", self._writer.status))
                due = now + REPORT_PERIOD

    def _take(self, data: bytes) -> None:
        if not data.startswith(MESSAGES):
            self._do(pickle.loads(data))
            return
        position, end = len(MESSAGES), len(data)
        while position < end:
            number, size, log_time_ns, publish_time_ns = MESSAGE.unpack_from(data, position)
            position += MESSAGE.size
            self._inputs[number](data[position : position + size], log_time_ns, publish_time_ns)
            position += size

    def _do(self, item: Any) -> None:
        match item:
            case ("topic", topic, type_name, depth, reliability, durability):
                qos = QoSProfile(
                    depth=depth,
                    reliability=ReliabilityPolicy(reliability),
                    durability=DurabilityPolicy(durability),
                )
                self._writer.add_topic(topic, type_name, qos)
                self._inputs.append(self._writer.input(topic))
            case ("flush", timeout):
                flushed = self._writer.flush(timeout)
                self._connection.send(("flushed" if flushed else "not flushed", self._writer.status))
            case _:
                self._connection.send(("closed", self._writer.close()))


def main() -> None:
    """Serve the process that started this one, on the descriptor that it gave."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the bag is closed when the other process says so, or ends
    os.nice(NICENESS)
    sys.setswitchinterval(SWITCH_INTERVAL)
    with Connection(int(sys.argv[1])) as connection:
        serve(connection)


if __name__ == "__main__":
    main()
