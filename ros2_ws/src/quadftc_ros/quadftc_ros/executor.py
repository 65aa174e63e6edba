"""Spinning nodes: the executor with its traps handled, and the ``main`` that every executable shares."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import sys
import threading
import time
import weakref
from collections.abc import Callable, Generator, Sequence
from operator import attrgetter
from types import FrameType
from typing import Protocol, Self, TypeVar, cast

import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from quadftc_ros.conversions import NANOSECONDS
from quadftc_ros.node import GraphNode
from quadftc_ros.node_help import help_text, running_line, wants_help
from quadftc_ros.reach import enclave_arguments
from quadftc_ros.starting import STOPPING

Hosted = TypeVar("Hosted", bound=Node)

LAUNCHER = "QUADFTC_LAUNCHER"  # environment variable: the process whose end ends this one
NEAR = 100_000  # ns; an executor that sleeps may wake so late
MAX_WORDS = 1000  # characters of what is said about a wrong parameter
CLOCK_PERIOD, SET_BACK = 0.02, 5_000_000  # s, ns; how often the machine's clock is looked at, what matters
POLL = 0.25  # s; EventsExecutor.spin() without a timeout busy-loops in Jazzy 7.1, so it is called in slices


def make_executor(context: Context | None = None) -> Executor:
    """Make an executor of events, whose timers go on when the clock of the machine is set back."""
    executor = EventsExecutor(context=context)
    threading.Thread(target=_outlive_clocks, args=(weakref.ref(executor),), daemon=True).start()
    return executor


def _outlive_clocks(found: weakref.ref[Executor]) -> None:
    """Wake an executor and its timers whenever the clock of the machine was set back, until it is gone.

    The rclpy of the wheels is made for a glibc older than 2.30 and turns each time-out into a time of that
    clock. So the waits in progress would last longer by what it was set back.
    """
    ahead_ns = time.time_ns() - time.monotonic_ns()
    while (executor := found()) is not None:
        before_ns, ahead_ns = ahead_ns, time.time_ns() - time.monotonic_ns()
        if before_ns - ahead_ns > SET_BACK:
            executor.create_task(_wind_up, executor)
        del executor
        time.sleep(CLOCK_PERIOD)


def _wind_up(executor: Executor) -> None:
    """Have all timers of an executor await their next time anew."""
    for node in executor.get_nodes():
        for timer in node.timers:
            timer.reset()


class NodeHost:
    """Nodes in a context of their own, with the keys of a name, and what serves them; a context manager."""

    def __init__(self, name: str) -> None:
        self._context = Context()
        # what the process was called with is not meant for the nodes
        self._context.init(args=["--ros-args", *enclave_arguments(name)])
        self._executor = make_executor(self._context)
        self._nodes: list[Node] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _host(self, node: Hosted) -> Hosted:
        """Let the executor serve a node of the context."""
        self._executor.add_node(node)
        self._nodes.append(node)
        return node

    def close(self) -> None:
        """End the nodes."""
        self._executor.shutdown()
        while self._nodes:
            self._nodes.pop(0).destroy_node()
        self._context.try_shutdown()


class Slice:
    """A time in which an executor serves its nodes: many callbacks in one call, unlike ``spin_once``.

    While there is work, EventsExecutor ignores a timeout: a callback that comes often has to call `look`.
    Slices are long, as each leaks 32 bytes with the rclpy of the wheels (7.1.5, made with pybind11 3).
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._over: Future = Future()
        self._end = math.inf
        self.looked: float | None = None  # monotonic time of the last `look` [s]

    def spin(self, duration: float) -> None:
        """Serve the nodes for a time [s]."""
        self._over, self._end = Future(), time.monotonic() + duration
        self._executor.spin_until_future_complete(self._over, timeout_sec=duration)

    def look(self) -> None:
        """End the slice if its time is over."""
        self.looked = time.monotonic()
        if self.looked >= self._end:
            self._end = math.inf
            self._over.set_result(None)


class Paced(Protocol):
    """A node that acts at times of its own."""

    @property
    def due_ns(self) -> int: ...  # noqa: D102  # by the monotonic clock
    @property
    def unanswered(self) -> bool: ...  # noqa: D102  # the other nodes may be busy with its last act
    def tick(self) -> None: ...  # noqa: D102


class Pace:
    """Real time: an executor serves its nodes, and in between some of them act when they are due.

    A timer of rclpy wakes another thread first, and skips periods that it is late for. The executor is called
    for each callback, as slices leak (`Slice`). With ``poll`` it never rests: the processor stays awake.
    """

    def __init__(self, executor: Executor, paced: Sequence[Paced], poll: bool) -> None:
        self._executor, self._paced, self._poll = executor, paced, poll

    def spin(self, duration: float) -> None:
        """Serve and act for a time [s]."""
        serve, now_ns = self._executor.spin_once, time.monotonic_ns
        end_ns = now_ns() + round(duration * NANOSECONDS)
        while (now := now_ns()) < end_ns:
            first = min(self._paced, key=attrgetter("due_ns"))
            if (rest := min(first.due_ns, end_ns) - now) > NEAR:
                serve(timeout_sec=0.0 if self._poll else (rest - NEAR) / NANOSECONDS)
                continue
            while first.due_ns > now_ns() < end_ns:
                pass  # an executor would wake too late
            if first.due_ns <= now_ns():
                if first.unanswered:  # who is late would otherwise act faster than the nodes can follow
                    self._executor.spin_until_future_complete(Future(), timeout_sec=0.0)
                first.tick()


@contextlib.contextmanager
def settled_memory() -> Generator[None, None, None]:
    """Let the garbage collector leave alone what is there already: to walk through it takes milliseconds."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


class StopSignals:
    """Context in which SIGINT and SIGTERM set a flag; a second one interrupts whatever runs, or is ignored.

    A KeyboardInterrupt inside a callback would be reported by the executor as an error of the node.
    """

    def __init__(self, repeated: bool = True) -> None:
        self.requested = False
        self._repeated = repeated  # whether a second one interrupts; else the first has all ignored, for good

    def __enter__(self) -> StopSignals:
        self._previous = {number: signal.signal(number, self._on_signal) for number in STOPPING}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        if not self._repeated:
            ignore_stopping()


def ignore_stopping() -> None:
    """Have SIGINT and SIGTERM ignored until this process has ended.

    With a handler, Python would take the default action while it shuts down.
    """
    for number in STOPPING:
        signal.signal(number, signal.SIG_IGN)


def run_node(make: Callable[[], Node], paced: bool = False) -> int:
    """Run one node until Ctrl-C, SIGTERM, shutdown or the death of its launcher.

    ``paced`` says whether it is `Paced`. Further signals change nothing: under ``ros2 launch``, Ctrl-C comes
    from the terminal and from the launcher. Return the exit code: 0, or 2 for wrong arguments or parameters.
    """
    executor, node = None, None
    stop = StopSignals(repeated=False)
    stop.__enter__()  # never left, as what follows is to be ignored
    try:
        # a launcher blocks the signals until they can be handled
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPPING)
        try:
            try:
                asked = wants_help(sys.argv[1:])
                rclpy.init(args=[] if asked else None, signal_handler_options=SignalHandlerOptions.NO)
            except RuntimeError as error:  # what rclpy makes of a wrong argument
                raise ValueError(f"ROS arguments: {error}") from None
            if asked:
                sys.stdout.write(help_text(make))
                return 0
            node = make()
        except (ValueError, ParameterException) as error:
            words = " ".join(str(error).split())
            sys.stderr.write(f"error: {words[:MAX_WORDS]}{'...' * (len(words) > MAX_WORDS)}\n")
            return 2
        executor = make_executor()
        executor.add_node(node)
        launcher = os.environ.get(LAUNCHER)  # started by hand, a node outlives the shell it came from
        if launcher is None and isinstance(node, GraphNode):
            node.get_logger().info(running_line(node))
        spin = Pace(executor, [cast("Paced", node)], False).spin if paced else Slice(executor).spin
        with settled_memory():
            while rclpy.ok() and not stop.requested and launcher in (None, str(os.getppid())):
                spin(POLL)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        ignore_stopping()
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
