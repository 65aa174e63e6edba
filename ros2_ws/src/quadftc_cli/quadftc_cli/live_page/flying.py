# pyright: basic
"""The flight of ``quadftc live``: a composed graph in real time, whose page is a process of its own.

Or, with ``--attach``, a graph that runs already, in other processes.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy

from quadftc_bags.interfaces import load_message_class
from quadftc_cli.live import AUTOPILOTS, CONTROLLER, OBSERVER, OTHERS, LiveGraph
from quadftc_cli.live_page.feed import DIAGNOSTICS, GUIDANCE, Feed, Flown, shown_topics
from quadftc_cli.screen import say
from quadftc_control.trajectory import combined
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.introduction import farewell, introduction
from quadftc_flight.graph.plan import SLICE, GraphError, GraphPlan
from quadftc_flight.recommended import HOVER, LEVEL
from quadftc_flight.runs import RunOptions
from quadftc_flight.scenario import Scenario, find_scenario, load_scenario, node_parameters, parse_scenario
from quadftc_model.rotations import euler_from_quaternion
from quadftc_report.serve.local import listen, private_files
from quadftc_ros.executor import StopSignals
from quadftc_ros.scheduling import Scheduling
from quadftc_ros.topics import TOPICS, absolute

LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
ALL = QoSProfile(depth=100)
START, END = 30.0, 5.0  # s; for the page to serve, and to end
FEED = 1 << 18  # bytes that may wait for the page: some 60 frames, two seconds


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


@dataclass(frozen=True)
class Wish:
    """What to fly, as the command line says it."""

    scenario: str
    scheme: str
    vehicle: str
    stand: bool
    sliders: bool
    rate: str
    duration: float
    record: Path | None
    namespace: str
    engine: str = "c"


def scenario_of(wish: Wish) -> Scenario:
    """Build the scenario; a ValueError says what is wrong with it."""
    vehicle = str(Path(wish.vehicle).resolve()) if wish.vehicle.endswith(".toml") else wish.vehicle
    changes = {"vehicle": vehicle, "rate": wish.rate}
    overrides = [f"{name}={value}" for name, value in changes.items() if value]
    if not wish.scenario:
        if wish.scheme:
            raise ValueError("--scheme: belongs to --scenario")
        return parse_scenario(LEVEL if wish.stand else HOVER, "live", overrides)
    if wish.stand:
        raise ValueError("--stand: the scenario says where it flies")
    return load_scenario(find_scenario(wish.scenario), overrides)


def plan_of(wish: Wish, scenario: Scenario, scheduling: Scheduling) -> GraphPlan:
    """Plan the graph: it flies on behind the end of the scenario."""
    parameters = {
        node: dict(values) for node, values in node_parameters(scenario, wish.scheme or None).items()
    }
    parameters["plant"]["duration"] = wish.duration
    if wish.sliders or not wish.scenario:
        for node in GUIDANCE.values():
            if node in parameters:
                parameters[node]["source"] = "topic"
    how = {"engine": wish.engine, "scheduling": scheduling}
    return GraphPlan(parameters, "realtime", wish.namespace, wish.record, **how)


def page_of(plan: GraphPlan, scenario: Scenario) -> Flown:
    """Return what the page has to know of a flight."""
    values, vehicle = plan.parameters, scenario.vehicle
    observer, controller = values["fault_observer"]["observer"], values["controller"]["controller"]
    parts = f"{Path(vehicle).stem}, observer {observer}, controller {controller}, {scenario.rate:g} Hz"
    guidance = values[GUIDANCE[plan.plant]]
    home = None
    if guidance.get("source") == "topic":
        home = (*begin_of(scenario), 0.0) if plan.plant == "free_flight" else (0.0, 0.0, 0.0)
    title = scenario.description or scenario.name
    return Flown(title, parts, vehicle, plan.plant, plan.namespace, home)


def begin_of(scenario: Scenario) -> tuple[float, float, float]:
    """Return where the trajectories of a scenario begin [m]."""
    begin = combined([part.law for part in scenario.trajectories], 0.0).position
    x, y, z = begin.tolist()
    return x, y, z


@contextmanager
def serving(
    port: int, flown: Sequence[Flown], opens: bool
) -> Iterator[tuple[socket.socket, str, StopSignals]]:
    """Serve the page in a process of its own, which opens a browser; yields frames' socket, URL and Ctrl-C.

    A GraphError says if it does not start. It has a session of its own: Ctrl-C reaches this process alone.
    """
    with (
        private_files(),
        StopSignals() as stop,
        listen(port) as listener,
        _page_process(listener, flown, opens) as (channel, address),
    ):
        yield channel, address, stop


@contextmanager
def _page_process(
    listener: socket.socket, flown: Sequence[Flown], opens: bool
) -> Iterator[tuple[socket.socket, str]]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, FEED)
    ends = (theirs.fileno(), listener.fileno())
    command = [sys.executable, "-m", "quadftc_cli.live_page.server", *map(str, ends), json.dumps(flown)]
    command += ["open"] if opens else []
    process = subprocess.Popen(command, pass_fds=ends, start_new_session=True, stdin=subprocess.DEVNULL)
    theirs.close()
    try:
        ours.settimeout(START)
        try:
            address = ours.recv(256).decode()
        except TimeoutError:
            address = ""
        if not address:
            raise GraphError("the page did not start; see above")
        yield ours, address
    finally:
        ours.close()  # it ends by that
        try:
            process.wait(END)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def show_running(namespace: str, port: int, opens: bool) -> int:
    """Show a graph that runs already, and return the exit code."""
    with LiveGraph(namespace) as graph:
        flown: list[Flown] = []
        for name in vehicles_of(graph):
            graph.namespace = name
            flown.append(page_of_running(graph))
        with serving(port, flown, opens) as (channel, address, stop):
            said = [f"{each.title}: {each.parts}" for each in flown]
            say(*said, f"page:   {address}", stderr=True)
            follow(graph, channel, flown, lambda: not stop.requested)
    return 0


def fly_live(wish: Wish, port: int, opens: bool, how: tuple[str, int, tuple[int, ...]]) -> int:
    """Fly, show it, and return the exit code."""
    options = RunOptions(mode="realtime", namespace=wish.namespace, scheduling=Scheduling(*how))
    scenario = scenario_of(wish)
    plan = plan_of(wish, scenario, options.scheduling)
    with (
        tempfile.TemporaryDirectory(prefix="quadftc_") as folder,
        serving(port, [page_of(plan, scenario)], opens) as (channel, address, stop),
    ):
        if plan.bag is not None:
            file = Path(folder, "parameters.yaml")
            file.write_text(plan.parameter_file(), encoding="utf-8")
            plan = replace(plan, attachments=(file,))
        feed = Feed(channel, plan.namespace, plan.plant)
        with ComposedGraph(plan, tap=feed.tap) as graph:
            say(*introduction(plan), f"page:   {address}", stderr=True)

            def goes_on(_samples: int) -> bool:
                feed.send()  # also when the controller is silent
                return not stop.requested

            wall = graph.run(goes_on)
            status = graph.recorder.finish() if graph.recorder is not None else None
    if status is not None and status.error is not None:
        raise GraphError(f"{status.error}: the recording stopped")
    say(farewell(plan, wall), stderr=True)
    return 0
