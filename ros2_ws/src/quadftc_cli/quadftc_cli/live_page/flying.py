# pyright: basic
"""The flight of ``quadftc live``: a composed graph in real time, whose page is a process of its own."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from quadftc_cli.live import LiveGraph
from quadftc_cli.live_page.attached import follow, page_of_running, vehicles_of
from quadftc_cli.live_page.feed import GUIDANCE, Feed, Flown
from quadftc_cli.screen import say
from quadftc_control.trajectory import combined
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.introduction import farewell, introduction
from quadftc_flight.graph.plan import GraphError, GraphPlan
from quadftc_flight.recommended import HOVER, LEVEL
from quadftc_flight.runs import RunOptions
from quadftc_flight.scenario import Scenario, find_scenario, load_scenario, node_parameters, parse_scenario
from quadftc_report.serve.local import listen, private_files
from quadftc_ros.executor import StopSignals
from quadftc_ros.scheduling import Scheduling

START, END = 30.0, 5.0  # s; for the page to serve, and to end
FEED = 1 << 18  # bytes that may wait for the page: some 60 frames, two seconds


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
