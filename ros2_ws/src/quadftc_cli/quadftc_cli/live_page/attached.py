# pyright: basic
"""``quadftc live --attach``: the page of a graph that runs already, in other processes."""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy

from quadftc_bags.interfaces import load_message_class
from quadftc_cli.live import AUTOPILOTS, CONTROLLER, OBSERVER, OTHERS, LiveGraph
from quadftc_cli.live_page.feed import DIAGNOSTICS, GUIDANCE, Feed, Flown, shown_topics
from quadftc_flight.graph.plan import SLICE, GraphError
from quadftc_model.rotations import euler_from_quaternion
from quadftc_ros.topics import TOPICS, absolute

LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
ALL = QoSProfile(depth=100)


def vehicles_of(graph: LiveGraph) -> list[str]:
    """Return the namespaces in which something flies: the one that was asked for, else all there are."""
    if graph.namespace:
        return [graph.namespace]
    services = (CONTROLLER, *AUTOPILOTS)
    if not graph.until(lambda: any(map(graph.offers, services))):
        graph.full_name(CONTROLLER)  # which says so
    graph.spin(OTHERS)
    return sorted({name for each in services for name in graph.namespaces(each)})


def page_of_running(graph: LiveGraph) -> Flown:
    """Ask the nodes what flies. A GraphError says who does not answer."""
    if (pilot := graph.choose_vehicle(CONTROLLER, *AUTOPILOTS)) in AUTOPILOTS:
        return _page_of_autopilot(graph, AUTOPILOTS[pilot])
    vehicle, plant, controller = _values(graph, "controller", "vehicle", "plant_kind", "controller")
    (observer,) = _values(graph, "fault_observer", "observer")
    (source,) = _values(graph, GUIDANCE[plant], "source")
    parts = f"{Path(vehicle).stem}, observer {observer}, controller {controller}"
    home = _home(graph, plant) if source == "topic" else None
    simulated = bool(graph.namespaces("fault_injector/inject"))
    return Flown(_title(graph), parts, vehicle, plant, graph.namespace, home, simulated)


def _page_of_autopilot(graph: LiveGraph, name: str) -> Flown:
    """Say what flies where an autopilot does: it takes no setpoints from us."""
    (vehicle,) = _values(graph, f"{name.lower()}_backend", "vehicle")
    (observer,) = _values(graph, "fault_observer", "observer") if graph.offers(OBSERVER) else ("none",)
    parts = f"{Path(vehicle).stem}, observer {observer}, flown by {name}"
    return Flown(_title(graph), parts, vehicle, "free_flight", graph.namespace)


def _title(graph: LiveGraph) -> str:
    return f"Attached to {graph.namespace or 'what flies'}"


def follow(
    graph: LiveGraph, channel: socket.socket, vehicles: Sequence[Flown], goes_on: Callable[[], bool]
) -> None:
    """Hand what the graph says of vehicles to the page until it is over."""
    feeds: list[Feed] = []
    for number, flown in enumerate(vehicles):
        feed = Feed(channel, flown.namespace, flown.plant, number)
        for topic in (*shown_topics(flown.plant), DIAGNOSTICS):
            full = absolute(flown.namespace, topic)
            kind = load_message_class(TOPICS[topic].type_name)
            profile = ALL if topic == DIAGNOSTICS else LATEST
            take: Any = feed.tap(full)  # each of these topics is shown
            graph.node.create_subscription(kind, full, take, profile, raw=True)
        feeds.append(feed)
    while goes_on():
        graph.spin(SLICE)
        for feed in feeds:
            feed.send()


def _home(graph: LiveGraph, plant: str) -> tuple[float, ...]:
    """Return the setpoint that the sliders begin with, in SI: level, or where the vehicle shall be now."""
    if plant == "test_stand":
        return (0.0, 0.0, 0.0)
    poses: list[Any] = []
    graph.listen("position/reference", poses.append)
    if not graph.until(lambda: poses):
        raise GraphError("position/reference does not come: does the vehicle fly?")
    place, turn = poses[-1].pose.position, poses[-1].pose.orientation
    yaw = euler_from_quaternion(np.array([turn.x, turn.y, turn.z, turn.w]))[2]
    return (place.x, place.y, place.z, float(yaw))


def _values(graph: LiveGraph, node: str, *names: str) -> list[Any]:
    """Return parameters of a node; a GraphError names one that it does not have."""
    request = GetParameters.Request(names=list(names))
    values = graph.call(f"{node}/get_parameters", GetParameters, request).values
    found = [parameter_value_to_python(value) for value in values] or [None] * len(names)  # one is unknown
    if None in found:
        raise GraphError(f"{node} has no parameter {names[found.index(None)]}")
    return found
