"""What all nodes of the graph share: mode, parameters, topics by the table, connections, diagnostics."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from quadftc_model.parameters import parameter
from quadftc_ros.conversions import leading_stamp_ns, stamp_of
from quadftc_ros.diagnostics import OK, WARN, Diagnostics
from quadftc_ros.interfaces import load_message_class
from quadftc_ros.parameters import NodeParameters
from quadftc_ros.qos import service_profile, topic_profile
from quadftc_ros.topics import TOPICS

MODES = ("lockstep", "realtime")


@dataclasses.dataclass(frozen=True)
class GraphParameters:
    """Parameters that every node of the graph has."""

    mode: str = parameter(
        "realtime",
        choices=MODES,
        doc="realtime: by the wall clock, latest messages; lockstep: every sample waits for its answer",
    )


class GraphNode(Node):
    """Base of the graph's nodes.

    Parameters
    ----------
    name : str
        Name of the node, as in the table of topics.
    **kwargs
        Those of ``rclpy.node.Node`` (``context``, ``namespace``, ``parameter_overrides``...).

    Raises
    ------
    ValueError
        If a parameter is wrong.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.settings = NodeParameters(self)
        self.settings.declare(GraphParameters, read_only=True)
        self.mode: str = self.get_parameter("mode").value
        if self.mode not in MODES:
            raise ValueError(f"mode = {self.mode!r}: expected one of {', '.join(MODES)}")
        self.diagnostics = Diagnostics(self, self.get_namespace().strip("/") or "vehicle", self.report)
        self._flying = False
        self._outputs: dict[str, Publisher] = {}
        self._inputs: dict[str, Subscription] = {}

    @property
    def lockstep(self) -> bool:
        """Whether the graph advances sample by sample."""
        return self.mode == "lockstep"

    def ready(self) -> None:
        """Call at the end of the constructor: warns of unknown parameters and starts the diagnostics."""
        for name in self.settings.unknown():
            if name not in ("use_sim_time",) and not name.startswith("qos_overrides"):
                self.get_logger().warning(f"parameter '{name}' was given but this node has no such parameter")
        self._heartbeat = self.create_timer(1.0 if self.mode == "realtime" else 0.2, self._beat)

    def publishes(self, topic: str) -> Callable[[Any], None]:
        """Create the publisher of a topic of the table; return its ``publish``."""
        row = TOPICS[topic]
        publisher = self.create_publisher(
            load_message_class(row.type_name), topic, topic_profile(row.qos, self.mode)
        )
        self._outputs[topic] = publisher
        return publisher.publish

    def reads(self, topic: str, callback: Callable[[int, Any], None]) -> None:
        """Subscribe to a topic of the table; ``callback(stamp_ns, message)``."""
        self._subscribe(topic, lambda message: callback(stamp_of(message), message), raw=False)

    def reads_raw(self, topic: str, callback: Callable[[int, bytes], None]) -> None:
        """Subscribe to a topic of which most messages only tell the time; ``callback(stamp_ns, serialised)``."""
        self._subscribe(topic, lambda data: callback(leading_stamp_ns(data), data), raw=True)

    def _subscribe(self, topic: str, callback: Callable[[Any], None], raw: bool) -> None:
        row = TOPICS[topic]
        self._inputs[topic] = self.create_subscription(
            load_message_class(row.type_name), topic, callback, topic_profile(row.qos, self.mode), raw=raw
        )

    def offers(self, name: str, service: type, answer: Callable[[Any, Any], Any]) -> None:
        """Create the service ``~/name``; ``answer(request, response)`` returns the response."""
        self.create_service(service, f"~/{name}", answer, qos_profile=service_profile())

    def connections(self) -> dict[str, int]:
        """Return how many publishers (for an input) or readers (for an output) each topic of the node has now."""
        counts = {topic: publisher.get_subscription_count() for topic, publisher in self._outputs.items()}
        counts.update((topic, reader.get_publisher_count()) for topic, reader in self._inputs.items())
        return counts

    def destroy_node(self) -> None:
        """Stop the timer before the rest."""
        if self.context.ok():
            self.destroy_timer(self._heartbeat)
        super().destroy_node()

    def sampled(self, stamp_ns: int) -> None:
        """Call once for each sample, at its end: lets /diagnostics out when it is due or something changed."""
        self._flying = True
        if self.lockstep:
            self.diagnostics.tick(stamp_ns)
        elif self.diagnostics.changed:
            self.diagnostics.tick(time.time_ns())

    def report(self) -> None:
        """Report to the diagnostics; called before each of their messages. Nodes with more to say extend it."""

    def _beat(self) -> None:
        """Report the connections; in lock-step only before the flight (stamp 0), whose messages are all by sample."""
        if self.lockstep and self._flying:
            return
        counts = self.connections()
        missing = missing_connections(self.get_name(), counts)
        message = "; ".join(missing) if missing else "all connected"
        self.diagnostics.report("connections", WARN if missing else OK, message, **counts)
        if self.lockstep:
            self.diagnostics.publish(0)
        else:
            self.diagnostics.tick(time.time_ns())


def missing_connections(node: str, counts: Mapping[str, int], recorders: int = 0) -> list[str]:
    """Say what a node lacks to be part of a whole graph.

    Parameters
    ----------
    node : str
        Name of the node.
    counts : mapping
        As :meth:`GraphNode.connections` gives them.
    recorders : int
        Readers of every output besides those of the table.
    """
    missing: list[str] = []
    for topic, count in counts.items():
        row = TOPICS[topic]
        if node in row.publishers:
            wanted, kind = len(row.readers) + recorders, "readers"
        else:
            wanted, kind = len(row.publishers), "publishers"
        if count < wanted:
            missing.append(f"{topic}: {count} of {wanted} {kind}")
    return missing


def wall_seconds() -> float:
    """Monotonic wall time [s], for measuring how long a step takes."""
    return time.perf_counter()
