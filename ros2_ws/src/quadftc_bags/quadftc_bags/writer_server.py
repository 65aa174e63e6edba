"""The process that builds the bag for one that flies; `quadftc_bags.writer_process` is the other side.

It ends when it is told to close the bag, or when the other process has ended, in whatever way: then it closes
the bag, too. It looks now and then for what has come instead of waiting for it: to wake another process takes
the one that flies longer than to hand over what it has.
"""

from __future__ import annotations

import os
import pickle
import signal
import struct
import sys
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from quadftc_bags.writer import BagWriter, Input

MESSAGES = b"M"  # what a batch begins with; all else is a pickle, which begins with another byte
MESSAGE = struct.Struct("=IIqq")  # in it: number of the topic, size, log and publish time; then the bytes
REST = 0.005  # s, between two looks at what has come
REPORT_PERIOD = 0.5  # s, wall time between two reports of how the recording stands
NICENESS = 10  # the one that flies comes first
SWITCH_INTERVAL = 1e-4  # s; here the thread that receives must not wait for the one that writes


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
