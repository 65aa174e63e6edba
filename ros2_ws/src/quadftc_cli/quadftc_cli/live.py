# pyright: basic
"""A node of the command's own in a graph that runs: it finds services, calls them, publishes and listens."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from quadftc_bags.interfaces import load_message_class
from quadftc_flight.graph.plan import GraphError
from quadftc_ros.executor import NodeHost
from quadftc_ros.qos import service_profile, topic_profile
from quadftc_ros.topics import TOPICS, absolute

PATIENCE = 5.0  # s; for nodes to be found, and for an answer
OTHERS = 0.5  # s; for other vehicles to be found, after the first
STEP = 0.05  # s; between two looks
CONTROLLER, OBSERVER = (f"{node}/get_parameters" for node in ("controller", "fault_observer"))
AUTOPILOTS = {f"{name.lower()}_backend/get_parameters": name for name in ("ArduPilot", "Betaflight")}


class LiveGraph(NodeHost):
    """A node among those that run; a context manager. A `GraphError` says what is not there.

    Without a ``namespace``, the only vehicle there is stands for it.
    """

    def __init__(self, namespace: str = "") -> None:
        super().__init__("operator")
        self.namespace = namespace.strip("/")
        name = f"quadftc_{os.getpid()}"
        options = {"context": self._context, "use_global_arguments": False, "enable_rosout": False}
        self.node = self._host(Node(name, **options))

    def spin(self, duration: float) -> None:
        """Serve the node for a time [s]."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def until(self, condition: Callable[[], object], patience: float | None = None) -> bool:
        """Serve the node until a condition holds; return whether it does."""
        end = time.monotonic() + (PATIENCE if patience is None else patience)
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=STEP)
        return True

    def call(self, name: str, service: Any, request: Any) -> Any:
        """Call a service, ``node/name``, of the vehicle; return its response."""
        full = self.full_name(name)
        client = self.node.create_client(service, full, qos_profile=service_profile())
        self.until(client.service_is_ready)
        future = client.call_async(request)
        if not self.until(future.done):
            raise GraphError(f"{full}: no answer within {PATIENCE:g} s")
        self.node.destroy_client(client)
        return future.result()

    def publisher(self, topic: str) -> Any:
        """Return a publisher of a topic of the table that somebody reads; None if nobody does."""
        row = TOPICS[topic]
        made = self.node.create_publisher(
            load_message_class(row.type_name),
            absolute(self.namespace, topic),
            topic_profile(row.qos, "realtime"),
        )
        return made if self.until(made.get_subscription_count) else None

    def listen(self, topic: str, callback: Callable[[Any], None]) -> None:
        """Have every message of a topic of the table from now on."""
        row = TOPICS[topic]
        kind, full = load_message_class(row.type_name), absolute(self.namespace, topic)
        self.node.create_subscription(kind, full, callback, topic_profile(row.qos, "realtime"))

    def choose_vehicle(self, *services: str) -> str:
        """Take the namespace of the only vehicle that offers one of some services, if none was asked for.

        Return the first of them that it offers.
        """
        patience = None if self.until(lambda: any(map(self.offers, services))) else 0.0
        service = next(filter(self.offers, services), services[0])
        self.namespace = self.full_name(service, patience)[: -len(service)].strip("/")
        return service

    def offers(self, name: str) -> bool:
        """Return whether the vehicle, or any where none was asked for, offers a service ``node/name``."""
        there = self.namespaces(name)
        return self.namespace in there if self.namespace else bool(there)

    def full_name(self, name: str, patience: float | None = None) -> str:
        """Return the full name of a service of the vehicle, once it is there; a GraphError says what is."""
        full = absolute(self.namespace, name)
        if self.namespace or self.until(lambda: self.namespaces(name), patience):
            self.until(lambda: full in self._services(), patience if self.namespace else OTHERS)
        there = self.namespaces(name)
        if self.namespace in there:
            return full
        if not self.namespace and len(there) == 1:
            return f"/{there[0]}/{name}"
        node = name.rpartition("/")[0]
        if not there:
            words = f"no node {node} in ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0}"
            others = sorted({name for name in self.node.get_node_names() if name != self.node.get_name()})
            hint = f"there are {', '.join(others)}" if others else "start one: scripts/launch_graph.py"
            raise GraphError(f"{words}; {hint}")
        listed = ", ".join(each or "(none)" for each in there)
        raise GraphError(f"no node {node} in namespace '{self.namespace}'; --namespace can be {listed}")

    def _services(self) -> set[str]:
        return {name for name, _ in self.node.get_service_names_and_types()}

    def namespaces(self, name: str) -> list[str]:
        """Return the namespaces in which there is a service ``node/name``."""
        suffix = f"/{name}"
        names = (each for each in self._services() if each.endswith(suffix))
        return sorted(each[: -len(suffix)].strip("/") for each in names)
