# pyright: basic
"""The graph as processes: one for each node, as ``ros2 run`` starts it; the recorder is in this one."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from std_srvs.srv import Trigger

from quadftc_flight.graph import plan as plans
from quadftc_flight.graph.following import Graph
from quadftc_flight.graph.laws import prepare_laws
from quadftc_flight.graph.plan import STALL_TIMEOUT, GraphError, GraphPlan, Progress, always
from quadftc_ros.children import Children
from quadftc_ros.conversions import time_message
from quadftc_ros.diagnostics import WARN
from quadftc_ros.leftovers import remove_leftovers
from quadftc_ros.qos import topic_profile
from quadftc_ros.reach import enclave_arguments
from quadftc_ros.recorder_node import RecorderNode
from quadftc_ros.scheduling import Scheduling, SchedulingError, raise_priority, scheduled
from quadftc_ros.topics import missing_connections

# the flight is recorded when within a time [s] no more than so many messages come: in real time a controller
# without samples goes on to say so
RECORDED = {"lockstep": (0.25, 0), "realtime": (plans.AFTERMATH, 10)}
CALM = {"lockstep": 0.0, "realtime": 0.5}  # s; between the last match and the flight
BAD_PARAMETERS = 2  # exit code of a node; started again, it would end again
FIRST_DELAY, LAST_DELAY = 0.1, 3.0  # s; the delay of a restart doubles with every death within `MEMORY`
MOST_DEATHS = 5  # of one node within `MEMORY`; with the next the graph ends
MEMORY = 60.0  # s


def executable_path(package: str, executable: str) -> Path:
    """Return the path of an installed executable, which ``ros2 run`` would start, or raise a GraphError."""
    try:
        path = Path(get_package_prefix(package), "lib", package, executable)
    except PackageNotFoundError:
        raise GraphError(f"package {package} is not installed; run scripts/setup") from None
    if not path.is_file():
        raise GraphError(f"{path} is missing; run scripts/setup")
    return path


class Respawn:
    """When a node that has died is started again, and when it has died too often."""

    def __init__(self) -> None:
        self._deaths: dict[str, list[float]] = {}
        self._due: dict[str, float] = {}
        self.restarts: Counter[str] = Counter()

    def died(self, name: str, now: float) -> float | None:
        """Note a death at a time [s], once until `started`; return the delay left [s], or None: too many."""
        if name not in self._due:
            deaths = [each for each in self._deaths.get(name, ()) if now - each <= MEMORY]
            self._deaths[name] = [*deaths, now]
            self._due[name] = now + min(LAST_DELAY, FIRST_DELAY * 2.0 ** len(deaths))
        return None if len(self._deaths[name]) > MOST_DEATHS else max(0.0, self._due[name] - now)

    def waits(self, name: str) -> bool:
        """Return whether a node is dead and known to be."""
        return name in self._due

    def started(self, name: str) -> int:
        """Note that a node was started again; return how often it was so far."""
        del self._due[name]
        self.restarts[name] += 1
        return self.restarts[name]


class ProcessGraph(Graph):
    """The nodes of a plan as processes; a context manager. It ends only what it started, and all of that.

    First it removes what killed processes left in shared memory. Should this process be killed, the nodes
    stop by themselves. A wrong namespace and a bag that cannot be made are a ValueError; a node that is not
    installed and a scheduling that is not allowed, a GraphError.
    """

    def __init__(self, plan: GraphPlan) -> None:
        prepare_laws([plan])
        remove_leftovers()
        super().__init__()
        self.plan = plan
        self.children = Children()
        self._counts: dict[str, dict[str, int]] = {}
        self._calm: float | None = None  # when the processes have got to rest
        self._flying = self._finished = False
        self._samples = 0
        self._folder = tempfile.TemporaryDirectory(prefix="quadftc_")
        self._node: Any = None
        self._respawn = Respawn()
        # the recorder gives way to the nodes, and to nobody else
        self._scheduling = Scheduling(priority=max(0, plan.scheduling.priority - 1))
        try:
            with scheduled(self._scheduling):
                self._watch_and_record()
            with scheduled(plan.scheduling):  # which the processes inherit
                self._started = self._commands()
                self.children.start(self._started)
        except BaseException as error:
            self.close()
            if isinstance(error, SchedulingError):
                raise GraphError(str(error)) from None
            raise

    def run(self, progress: Progress = always) -> float:
        """Fly until the plant's duration is over, as `ComposedGraph.run`; a node that ends is an error."""
        if self.plan.onboard:
            self._flying = True
            with scheduled(self._scheduling):
                return self._serve(self._slice.spin, progress)
        if not self.wait_until_connected(progress):
            return 0.0
        with scheduled(self._scheduling):
            self._flying = True
            self._begin_flight()
            stalled = f"no new sample of the plant for {STALL_TIMEOUT:g} s"
            wall = self._follow(self._slice.spin, progress, stalled)
            if self.flew_to_its_end and self.recorder is not None:
                self._drain(self.recorder)
        return wall

    def wait_until_connected(self, progress: Progress = always) -> bool:
        """Wait as `Graph` does; in real time, until discovery of services and parameters is over, too."""
        if not super().wait_until_connected(progress):
            return False
        if self._calm is None:
            self._calm = time.monotonic() + CALM[self.plan.mode]
            while time.monotonic() < self._calm:
                self._check_alive()
                if not progress(0):
                    return False
                self._slice.spin(0.1)
        return True

    def _state(self) -> tuple[bool, int]:
        return self._finished, self._samples

    def close(self) -> None:
        """End the processes, close the bag."""
        try:
            self.exit_code = self.children.stop()
        finally:
            super().close()
            self._folder.cleanup()

    def _watch_and_record(self) -> None:
        plan, reliable = self.plan, topic_profile("reliable", self.plan.mode)
        self._node = node = self._add_node(Node, plan.namespace, {}, node_name="launch_graph")
        self._watchers.append((node, plan.plant))
        prefix = node.get_namespace().strip("/")
        self._names = {
            f"{prefix}/{name}".lstrip("/"): name for name in plan.executables
        }  # as in /diagnostics
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, reliable)
        self._report = node.create_publisher(DiagnosticArray, "/diagnostics", reliable)
        self._starter = node.create_client(Trigger, "plant/start")
        if plan.bag is not None:
            self._add_node(RecorderNode, plan.namespace, plan.recorder_parameters(), plan.remap_arguments)

    def _commands(self) -> dict[str, list[str]]:
        file = Path(self._folder.name, "parameters.yaml")
        file.write_text(self.plan.parameter_file(), encoding="utf-8")
        arguments = ["--ros-args", "--params-file", str(file)]
        if self.plan.namespace:
            arguments += ["-r", f"__ns:=/{self.plan.namespace.strip('/')}"]
        arguments += self.plan.remap_arguments
        return {
            name: [str(executable_path(*row)), *arguments, *enclave_arguments(name)]
            for name, row in self.plan.executables.items()
        }

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, _, part = status.name.partition(": ")
            name = self._names.get(node)
            if name is None:
                continue
            if part == "connections":
                if self._flying and name not in self._counts:  # restarted: now as urgent as the others
                    raise_priority(self.children.process_ids()[name], self.plan.scheduling.priority)
                self._counts[name] = {pair.key: int(pair.value) for pair in status.values}
            elif name == "plant" and part == "flight":
                self._finished = status.message == "finished"
                self._samples = int({pair.key: pair.value for pair in status.values}["samples"])

    def _missing(self) -> list[str]:
        recorders = int(self.recorder is not None)
        missing = [f"{name}: no word from it" for name in self.plan.executables if name not in self._counts]
        for name, counts in self._counts.items():
            lacks = missing_connections(name, counts, recorders, self.plan.plant)
            missing += [f"{name}: {lack}" for lack in lacks]
        return missing if missing or self._starter.service_is_ready() else ["no service plant/start"]

    def _begin_flight(self) -> None:
        future = self._starter.call_async(Trigger.Request())
        end = time.monotonic() + plans.CONNECT_TIMEOUT
        while not future.done():
            self._slice.spin(0.05)
            self._check_alive()
            if time.monotonic() > end:
                raise GraphError("plant/start did not answer")
        answer = future.result()
        if answer is None or not answer.success:
            raise GraphError(f"plant/start: {answer.message if answer is not None else 'no answer'}")

    def _drain(self, recorder: RecorderNode) -> None:
        """Spin on after the flight until all messages that were published have been recorded."""
        self._spin_until_quiet(recorder)
        if self.plan.mode == "lockstep":  # a node that ends waits until the recorder has its messages
            self.exit_code = self.children.stop()
            self._spin_until_quiet(recorder)

    def _spin_until_quiet(self, recorder: RecorderNode) -> None:
        duration, few = RECORDED[self.plan.mode]
        end, before = time.monotonic() + STALL_TIMEOUT, recorder.received
        self._slice.spin(duration)
        while recorder.received - before > few:
            if time.monotonic() > end:
                raise GraphError("messages go on after the end of the flight")
            before = recorder.received
            self._slice.spin(duration)

    def _check_alive(self) -> None:
        for name, code in self.children.ended().items():
            if not (self.plan.respawn and self._flying) or name == "plant" or code == BAD_PARAMETERS:
                raise GraphError(f"node {name} ended with exit code {code}")
            known = self._respawn.waits(name)
            delay = self._respawn.died(name, time.monotonic())
            if delay is None:
                raise GraphError(f"node {name} died {MOST_DEATHS + 1} times: exit code {code}")
            if not known:
                self._warn(f"node {name} ended with exit code {code}: starts again in {delay:g} s")
            elif delay == 0.0:
                count = self._respawn.started(name)
                # starting takes a core for seconds, which the nodes that fly must not miss
                low = dataclasses.replace(self.plan.scheduling, priority=self._scheduling.priority)
                self._counts.pop(name, None)
                with scheduled(low):
                    self.children.start({name: self._started[name]})
                self._warn(f"node {name} is started again, for the {count}. time")

    def _warn(self, words: str) -> None:
        """Say what became of a node, in the log and on /diagnostics."""
        self._node.get_logger().warning(words)
        message = DiagnosticArray()
        message.header.stamp = time_message(self._node.get_clock().now().nanoseconds)
        counts = [KeyValue(key=name, value=str(count)) for name, count in self._respawn.restarts.items()]
        name = f"{self._node.get_fully_qualified_name().lstrip('/')}: restarts"
        message.status = [DiagnosticStatus(name=name, level=WARN, message=words, values=counts)]
        self._report.publish(message)
