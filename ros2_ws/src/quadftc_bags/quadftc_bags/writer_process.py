"""Recording by another process: what it costs the one that flies is a list, handed over now and then.

A thread that writes would take the interpreter from the thread that flies, several hundred times a second. So
`BagProcess` has the interface of `BagWriter`, which does the work in the other process (`serve`), behind a
pair of sockets. That process ends when it is told to close the bag, or when the one that flies has ended. It
looks now and then for what has come: to wake another process takes longer than to hand over what there is.
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
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import TYPE_CHECKING

from quadftc_bags.bag_format import describe_topic
from quadftc_bags.writer import BagStatus, BagWriter

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

BATCH = 32  # messages handed over at a time; the socket holds many of these, so that nobody waits
PATIENCE = 60.0  # s, wall time for the other process to take a batch in lock-step, and to end a recording
ENDED = "the process that writes it has ended"
SILENT = "the process that writes it does not answer"
MESSAGES = b"M"  # what a batch begins with; all else is a pickle, which begins with another byte
MESSAGE = struct.Struct("=IIqq")  # before each message: number of the topic, size, log and publish time
REST = 0.005  # s, between two looks at what has come
REPORT_PERIOD = 0.5  # s, wall time between two reports of how the recording stands
NICENESS = 10  # the one that flies comes first

Input = Callable[[bytes, int, int], bool]


class BagProcess(AbstractContextManager["BagProcess"]):
    """Write one rosbag2 bag (MCAP) from one thread, by another process; the caller never waits for a disk.

    ``queue_size`` messages may wait. In real time a full queue drops messages and counts them: with those of
    the graph, of 0.1 to 0.5 kB, it stays below 50 MB. In lock-step it makes the caller wait. ``on_error`` is
    called once, with the text of the error that stopped the recording. All else is as of `BagWriter`; OSError
    if the other process does not start.
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
        if queue_size < 1:
            raise ValueError(f"queue_size: {queue_size} messages, expected at least 1")
        self._lockstep = lockstep
        self._queue_size = queue_size
        self._on_error = on_error
        self._numbers: dict[str, int] = {}  # of the topics
        self._batch: list[bytes] = []
        self._limit = BATCH  # messages; when the batch is so long, it is time to hand it over
        self._accepted = 0  # messages handed over so far
        self._dropped: Counter[str] = Counter()
        self._status = BagStatus({}, {}, 0, None)  # as the other process has said last
        self._closed = self._complete = False  # by us; the bag
        self._ended = False  # the other process, or it was given up
        self._connection, theirs = Pipe()
        with theirs:
            command = [sys.executable, "-m", "quadftc_bags.writer_process", str(theirs.fileno())]
            # in a session of its own: Ctrl-C in the terminal is for the process that flies
            self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()], start_new_session=True)
        self.process_id = self._process.pid
        self._writable = select.poll()
        self._writable.register(self._connection, select.POLLOUT)
        self._readable = select.poll()  # `Connection.poll` takes ten times as long
        self._readable.register(self._connection, select.POLLIN)
        self._send((str(directory), dict(attachments or {}), dict(metadata or {}), compression, lockstep))
        self.path: Path = self._first_answer()

    def add_topic(self, topic: str, type_name: str, qos: QoSProfile) -> None:
        """As of `BagWriter`."""
        if topic in self._numbers:
            raise ValueError(f"topic '{topic}': in the bag already")
        self._send(("topic", describe_topic(topic, type_name, qos)))
        self._numbers[topic] = len(self._numbers) + 1

    def input(self, topic: str) -> Input:
        """Return what queues ``(data, log time, publish time)`` [ns], and returns if it was accepted."""
        batch, number, pack = self._batch, self._numbers[topic], MESSAGE.pack

        def write(data: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
            if len(batch) >= self._limit and not self._make_room():
                self._dropped[topic] += 1
                return False
            batch.append(pack(number, len(data), log_time_ns, publish_time_ns) + data)
            return True

        return write

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> bool:
        """As of `BagWriter`."""
        return self.input(topic)(data, log_time_ns, publish_time_ns)

    def flush(self, timeout: float = 10.0) -> bool:
        """As of `BagWriter`, up to a time [s]."""
        if self._closed or not self._hand_over(timeout):
            return False
        self._send(("flush",))
        return self._wait_for("flushed", timeout) and self._status.error is None

    def close(self) -> BagStatus:
        """As of `BagWriter`. A Ctrl-C meanwhile is raised when the bag is complete."""
        try:
            self._finish()
        finally:
            self._finish()
        return self.status

    @property
    def status(self) -> BagStatus:
        """As of `BagWriter`, not older than a second."""
        self.hand_over()
        lost = self._status.lost
        if self._ended and not self._complete:  # counts are those of its last report
            lost = self._accepted - sum(self._status.counts.values())
        return dataclasses.replace(self._status, dropped=dict(self._dropped), lost=lost)

    def hand_over(self) -> None:
        """Hand over what waits, in real time no more than the other process takes at once: every 0.25 s."""
        if not self._closed and not self._hand_over(PATIENCE if self._lockstep else 0.0) and self._lockstep:
            self._give_up()

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
        while batch and (self._ended or self._writable.poll(1000.0 * patience)):
            with suppress(OSError):  # that it has ended shows in what it says last
                if not self._ended:
                    self._connection.send_bytes(MESSAGES + b"".join(batch[:BATCH]))
            self._accepted += len(batch[:BATCH])
            del batch[:BATCH]
        while self._receive(0.0):
            pass
        return not batch

    def _finish(self) -> None:
        """Close the bag; what was done already is not done again."""
        if not self._closed:
            if not self._hand_over(PATIENCE):
                self._give_up()
            self._closed, self._limit = True, 0
            self._send(("close",))
        if not self._connection.closed:
            if not self._wait_for("closed", PATIENCE) and not self._ended:
                self._give_up()
            self._end()

    def _give_up(self) -> None:
        """Take the other process for one that never answers: what was for it is lost."""
        if not self._ended:
            self._ended = True
            self._process.kill()
            self._note(dataclasses.replace(self._status, error=f"{self.path}: {SILENT}"))
        self._hand_over(0.0)

    def _send(self, item: object) -> None:
        with suppress(OSError):  # that it has ended shows in what it says last
            self._connection.send(item)

    def _receive(self, timeout: float) -> str:
        """Note what the other process says within a time [s]; return its kind, empty if nothing."""
        if self._ended:
            return ""
        try:
            if not self._readable.poll(1000.0 * timeout):
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
        """Keep the state of the recording; report its first error."""
        known, self._status = self._status.error, status
        if status.error is not None and known is None and self._on_error is not None:
            self._on_error(status.error)

    def _wait_for(self, kind: str, timeout: float) -> bool:
        """Wait for an answer, up to a time [s]; return whether it has come."""
        end = time.monotonic() + timeout
        while not self._ended and (rest := end - time.monotonic()) > 0.0:
            if self._receive(rest) == kind:
                return True
        return False

    def _first_answer(self) -> Path:
        """Return the path of the bag."""
        answer = OSError("the process that was to write the bag has ended")
        with suppress(EOFError, OSError):
            answer = self._connection.recv()
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
        *files, lockstep = connection.recv()
        writer = BagWriter(*files, lockstep=lockstep)
    except EOFError:
        return
    except (ValueError, OSError) as error:
        connection.send(error)
        return
    report_due = 0.0
    with writer, suppress(EOFError, OSError):  # of the connection: the bag is closed then, too
        connection.send(writer.path)
        while not writer.closed:
            if connection.poll(0.0):
                _take(connection, writer, connection.recv_bytes())
            else:
                time.sleep(REST)
            writer.tick()
            if (now := time.monotonic()) >= report_due and not writer.closed:
                connection.send(("status", writer.status))
                report_due = now + REPORT_PERIOD


def _take(connection: Connection, writer: BagWriter, data: bytes) -> None:
    """Do what one item from the other process asks for."""
    if data.startswith(MESSAGES):
        position, end = len(MESSAGES), len(data)
        while position < end:
            number, size, log_time_ns, publish_time_ns = MESSAGE.unpack_from(data, position)
            start = position + MESSAGE.size
            position = start + size
            writer.store((number, log_time_ns, publish_time_ns, data[start:position]))
        return
    match pickle.loads(data):
        case ("topic", topic):
            writer.add(topic)
        case ("flush",):
            writer.flush()
            connection.send(("flushed", writer.status))
        case _:
            connection.send(("closed", writer.close()))


def main() -> None:
    """Serve the process that started this one, on the descriptor that it gave."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the bag is closed when the other process says so, or ends
    os.nice(NICENESS)
    with Connection(int(sys.argv[1])) as connection:
        serve(connection)


if __name__ == "__main__":
    main()
