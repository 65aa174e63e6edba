"""What all nodes share: mode, lifecycle, parameters, topics by the table, connections, diagnostics."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from rclpy.clock import Clock, ROSClock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from quadftc_bags.cdr.message import leading_stamp_ns, read_message
from quadftc_bags.interfaces import load_message_class
from quadftc_model.parameters import parameter
from quadftc_model.stepper import MAX_GAP
from quadftc_ros.conversions import NANOSECONDS, stamp_of, wall_ns
from quadftc_ros.diagnostics import OK, WARN, Diagnostics, SampleTiming
from quadftc_ros.guard import LOOK, Guard
from quadftc_ros.lifecycle import ManagedNode
from quadftc_ros.limits import Limit
from quadftc_ros.parameters import NodeParameters
from quadftc_ros.qos import service_profile, topic_profile
from quadftc_ros.topics import BASE_FRAME, IMU_FRAME, PLANT_KINDS, TOPICS, PlantKind, missing_connections
from quadftc_ros.transport import MessageTrace, Note, Tap, decoding, receiver, tapped

T = TypeVar("T")

MODES = ("lockstep", "realtime")
HEARTBEAT = {"realtime": 1.0, "lockstep": 0.2}  # s; in lock-step only before the flight
LATE_WORDS = "samples are older than two periods: the machine is too slow, or the clock of the driver differs"
PATIENCE = 5.0  # s, for readers that may have died


@dataclasses.dataclass(frozen=True)
class GraphParameters:
    """Parameters that every node of the graph has."""

    mode: str = parameter(
        "realtime",
        choices=MODES,
        doc="realtime: by the wall clock, latest messages; lockstep: every sample waits for its answer",
    )
    plant_kind: PlantKind = parameter(
        "test_stand",
        choices=PLANT_KINDS,
        doc="test_stand: the vehicle turns about a fixed point; free_flight: it flies",
    )
    engine: str = parameter(
        "c", choices=("c", "numpy"), doc="what runs the laws: C that is generated from them, or NumPy"
    )
    frame_prefix: str = parameter(
        "", doc="in front of base_link and imu_link, such as drone1/ where a graph has two vehicles"
    )
    autostart: bool = parameter(
        True, doc="active at once; else unconfigured, until the lifecycle services configure and activate it"
    )
    trace: str = parameter(
        "", doc="file (.npz) for the times at which messages come and go, written at the end; empty: none"
    )


class GraphNode(ManagedNode):
    """Base of the graph's nodes, named as in the table of topics; ValueError for a wrong parameter.

    ``tap(topic)`` returns what gets a serialised copy of what the node publishes on a topic, for a recorder
    in the same process. Other arguments are those of ``rclpy.node.Node``.
    """

    def __init__(self, name: str, tap: Tap | None = None, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self._tap = tap
        self.settings = NodeParameters(self)
        self.settings.declare(GraphParameters, read_only=True)
        self.mode: str = self.settings.values()["mode"]
        self.plant_kind: PlantKind = self.settings.values()["plant_kind"]
        prefix: str = self.settings.values()["frame_prefix"]
        self.base_frame, self.imu_frame = prefix + BASE_FRAME, prefix + IMU_FRAME
        self.lockstep = self.mode == "lockstep"  # the graph advances sample by sample
        self._trace_file: str = self.settings.values()["trace"]
        self._trace = MessageTrace() if self._trace_file else None
        self.diagnostics = Diagnostics(self, self.get_namespace().strip("/") or "vehicle", self._refresh, tap)
        self.limits: Mapping[str, Limit] = {}  # of what is read; in lock-step others wait for each message
        self.guard = Guard(self, self.diagnostics, self._tell)
        self._timing = SampleTiming(clock=not self.lockstep)
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        # for time-outs: does not jump when the machine's clock is set, stands still with a paused simulation
        self.pace = self.get_clock() if self.get_parameter("use_sim_time").value else self.steady_clock
        self._flying = False
        self._begin_anew: Callable[[], None] = lambda: None
        self._outputs: dict[str, Publisher] = {}
        self._inputs: dict[str, Subscription] = {}

    def ready(self) -> None:
        """Call at the end of the constructor: warns of unknown parameters, starts diagnostics and node."""
        for complaint in self.settings.unknown():
            self.get_logger().warning(complaint)
        # on the steady clock, as the time of a simulation may stand still
        self._always = [
            self.create_timer(HEARTBEAT[self.mode], self._beat, clock=self.steady_clock),
            self.create_timer(LOOK, self.guard.look, clock=self.steady_clock),
        ]
        if self.settings.values()["autostart"]:
            self.begin()

    def publishes(self, topic: str) -> Callable[[object], None]:
        """Create the publisher of a topic of the table; return its ``publish``, of messages or serialised.

        While the node is not active, nothing is published.
        """
        row = TOPICS[topic]
        profile = topic_profile(row.qos, self.mode)
        publisher = self.create_publisher(load_message_class(row.type_name), topic, profile)
        self._outputs[topic] = publisher
        self.guard.watch(topic)
        send = tapped(publisher, self._tap)
        traced = self._trace is not None and topic != "/clock"  # which has no header
        note = self._trace.noting(f"given {topic}") if self._trace is not None and traced else None

        def publish(message: object) -> None:
            if not self.active:
                return
            if note is not None:
                note(leading_stamp_ns(message) if isinstance(message, bytes) else stamp_of(message))
            send(message)

        return publish

    def reads(
        self, topic: str, callback: Callable[[int, T], None], decode: Callable[[bytes], T] | None = None
    ) -> None:
        """Subscribe to a topic of the table; ``callback(stamp_ns, decode(serialised))``.

        ``decode`` is a function of `quadftc_ros.wire`, or ``bytes`` for a topic that mostly tells the time;
        by default the callback gets the message. What cannot be decoded is counted. While the node is not
        active, only what is latched is taken.
        """
        row, count = TOPICS[topic], self.diagnostics.count
        message_class = load_message_class(row.type_name)
        decode = decode or partial(read_message, message_class=message_class)
        note: Note = self._trace.noting(f"taken {topic}") if self._trace else lambda stamp_ns: None
        limit = None if self.lockstep else self.limits.get(topic)
        receive = receiver(topic, decoding(topic, callback, decode, count, limit), count, note)
        once = row.qos == "latched"  # it does not come again

        def take(data: bytes) -> None:
            if self.active or once:
                receive(data)

        profile = topic_profile(row.qos, self.mode)
        timed = not (self.lockstep or once) and (row.qos == "sensor" or bool(row.publishers))
        self._inputs[topic] = self.guard.subscribe(topic, message_class, take, profile, timed)

    def driven_by(
        self,
        topic: str,
        callback: Callable[[int, T], None],
        restart: Callable[[], None],
        decode: Callable[[bytes], T] | None = None,
    ) -> None:
        """Subscribe to the topic whose samples drive the node, as `reads` does.

        ``restart()`` makes the next sample the first. The service ``~/reset`` calls it, and so does a new
        flight: its stamps go back, in lock-step by any amount, in real time by more than `MAX_GAP`.
        """
        tolerance_ns, newest_ns = -1 if self.lockstep else round(MAX_GAP * NANOSECONDS), -1

        def checked(stamp_ns: int, message: T) -> None:
            nonlocal newest_ns
            if newest_ns - stamp_ns > tolerance_ns:
                restart()
                newest_ns = stamp_ns
            newest_ns = max(newest_ns, stamp_ns)
            callback(stamp_ns, message)

        self.reads(topic, checked, decode)
        self.offers_reset(restart, "restarts at the next sample")

    def offers(self, name: str, service: type, answer: Callable[[Any, Any], Any], under: str = "~") -> None:
        """Create the service ``under/name``; ``answer(request, response)`` returns the response."""
        self.create_service(service, f"{under}/{name}", answer, qos_profile=service_profile())

    def offers_reset(self, restart: Callable[[], None], words: str) -> None:
        """Create the service ``~/reset``, which calls ``restart()`` and answers with ``words``.

        The transition ``cleanup`` calls it, too.
        """
        self._begin_anew = restart

        def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            self.forget()
            response.success, response.message = True, words
            return response

        self.offers("reset", Trigger, answer)

    def forget(self) -> None:
        """Forget what came, so that the next sample is the first."""
        self.guard.forget()
        self._begin_anew()

    def must_act(self) -> str:
        """Return why the node must stay active; empty: it may rest."""
        return "in lock-step the other nodes wait for each of its messages" * (self.lockstep and self._flying)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Rest, and say so at once."""
        outcome = super().on_deactivate(state)
        self._beat()
        return outcome

    def connections(self) -> dict[str, int]:
        """Return how many publishers (of an input) or readers (of an output) each topic has now."""
        counts = {topic: publisher.get_subscription_count() for topic, publisher in self._outputs.items()}
        return counts | {topic: reader.get_publisher_count() for topic, reader in self._inputs.items()}

    def destroy_node(self) -> None:
        """Stop the timer before the rest, and save the trace; in lock-step, lose no message."""
        if self.context.ok():
            for timer in self._always:
                self.destroy_timer(timer)
            if self.lockstep:
                self._await_readers()
        if self._trace is not None:
            try:
                self._trace.save(Path(self._trace_file))
            except OSError as error:
                self.get_logger().error(f"trace = '{self._trace_file}': {error.strerror}")
            self._trace = None
        super().destroy_node()

    def _await_readers(self) -> None:
        """Wait until all readers have what was published; a lost message is sent again after seconds."""
        end = time.monotonic() + PATIENCE
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, end - time.monotonic())))

    def sampled(self, stamp_ns: int) -> None:
        """Call once for each sample, at its end: publishes /diagnostics if due or something changed."""
        if self.lockstep:
            if not self._flying:  # when the nodes found each other differs from run to run
                self.diagnostics.forget("connections")
            self._timing.sampled(stamp_ns)
            self.diagnostics.tick(stamp_ns)
        else:
            now_ns = self.now_ns()
            self._timing.sampled(stamp_ns, now_ns)
            if self.diagnostics.changed:
                self.diagnostics.publish(now_ns)
        self._flying = True

    def now_ns(self) -> int:
        """Time [ns]: that of the machine, as in `wall_ns`, or /clock with use_sim_time."""
        clock = self.get_clock()
        if isinstance(clock, ROSClock) and not clock.ros_time_is_active:
            return wall_ns()
        return clock.now().nanoseconds

    def report(self) -> None:
        """Report to the diagnostics before each of their messages, in nodes that have more to say."""

    def _refresh(self) -> None:
        """Report what every node does, and what this one has to say."""
        level, words = (OK, "active") if self.active else (WARN, "not active: publishes nothing")
        self.diagnostics.report("lifecycle", level, words)
        timing = self._timing
        if timing.began:
            values = timing.values(0 if self.lockstep else self.now_ns())
            level, words = OK, "samples come"
            if timing.idle:
                level, words = WARN, "no samples"
            elif timing.late:
                level, words = WARN, LATE_WORDS
            self.diagnostics.report("timing", level, words, **values)
        self.report()

    def _tell(self) -> None:
        """Publish the diagnostics at once; in a flight in lock-step, with the next sample."""
        if not (self.lockstep and self._flying):
            self.diagnostics.publish(0 if self.lockstep else self.now_ns())

    def _beat(self) -> None:
        """Publish the diagnostics; in lock-step only before the flight (stamp 0), then `sampled` does."""
        if self.lockstep and self._flying:
            return
        counts = self.connections()
        missing = missing_connections(self.get_name(), counts, plant=self.plant_kind)
        message = "; ".join(missing) if missing else "all connected"
        self.diagnostics.report("connections", WARN if missing else OK, message, **counts)
        self.diagnostics.publish(0 if self.lockstep else self.now_ns())
