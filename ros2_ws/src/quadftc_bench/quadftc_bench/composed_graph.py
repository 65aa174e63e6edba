# pyright: basic
"""The graph in one process: all nodes on one executor. The default, and the fast way."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from rclpy.context import Context
from rclpy.parameter import Parameter

from quadftc_bench.graph_plan import (
    AFTERMATH,
    ALONE,
    CONNECT_TIMEOUT,
    EXECUTABLES,
    STALL_TIMEOUT,
    GraphError,
    GraphPlan,
    Progress,
    always,
)
from quadftc_control.controller_node import ControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_ros.executor import Slice, make_executor, settled_memory
from quadftc_ros.node import GraphNode, crowded_topics, missing_connections
from quadftc_ros.recorder_node import RecorderNode
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.plant_node import PlantNode

SLICE = 0.02  # s, wall time of flight between two looks at it

NODE_CLASSES: dict[str, type[Any]] = {
    "fault_injector": FaultInjectorNode,
    "fault_observer": FaultObserverNode,
    "disturbance_observer": DisturbanceObserverNode,
    "reference": ReferenceNode,
    "controller": ControllerNode,
    "plant": PlantNode,
}


class ComposedGraph:
    """All nodes of a plan in this process; a context manager.

    Parameters
    ----------
    plan : GraphPlan
    executor : str
        ``events`` or ``single``.

    Raises
    ------
    ValueError
        If a parameter of a node is wrong, or the bag cannot be made.
    """

    exit_code = 0  # for those who treat both kinds of graph alike: no process that could end badly

    def __init__(self, plan: GraphPlan, executor: str = "events") -> None:
        self.plan = plan
        self.recorder: RecorderNode | None = None
        self.nodes: dict[str, GraphNode] = {}
        self._context = Context()
        self._context.init()
        self._executor = make_executor(executor, self._context)
        self._slice = Slice(self._executor)
        try:
            if plan.bag is not None:
                self.recorder = self._made(RecorderNode, plan.recorder_parameters(), subscribes=False)
            tap = None if self.recorder is None else self.recorder.tap
            for name in EXECUTABLES:
                options = {"each_sample": self._slice.look} if name == "plant" else {}
                parameters = plan.node_parameters(name)
                self.nodes[name] = self._made(NODE_CLASSES[name], parameters, tap=tap, **options)
        except BaseException:
            self.close()
            raise

    @property
    def plant(self) -> PlantNode:
        """The plant, by which the flight is followed."""
        plant = self.nodes["plant"]
        assert isinstance(plant, PlantNode)
        return plant

    def __enter__(self) -> ComposedGraph:
        """Return the graph."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the graph."""
        self.close()

    def run(self, progress: Progress = always) -> float:
        """Fly until the plant's duration is over; return the wall time of the flight [s].

        Parameters
        ----------
        progress : callable
            Called with the number of samples so far, often; the flight ends early when it returns False.

        Raises
        ------
        GraphError
            If the nodes do not find each other, or no sample comes for too long.
        """
        if not self.wait_until_connected(progress):
            return 0.0
        with settled_memory():
            return self._fly(progress)

    def _fly(self, progress: Progress) -> float:
        begin = time.monotonic()
        self.plant.start()
        samples, moved = 0, begin
        while not self.plant.finished:
            self._slice.spin(SLICE)
            now = time.monotonic()
            if not progress(self.plant.samples):
                return time.monotonic() - begin
            if self.plant.samples != samples:
                samples, moved = self.plant.samples, now
            elif now - moved > STALL_TIMEOUT:
                raise GraphError(
                    f"the flight stalled after {samples} samples: no torque/command came for the last"
                )
        wall = time.monotonic() - begin
        self._slice.spin(AFTERMATH)  # what follows from the last sample is on its way
        return wall

    def wait_until_connected(self, progress: Progress = always) -> bool:
        """Wait until every node is matched with every other; return False if ``progress(0)`` did so before.

        Raises
        ------
        GraphError
            If they do not find each other, or another graph is there, too.
        """
        end = time.monotonic() + CONNECT_TIMEOUT
        while missing := self._missing():
            if time.monotonic() > end:
                raise GraphError(f"not connected after {CONNECT_TIMEOUT:g} s: {'; '.join(missing)}")
            if not progress(0):
                return False
            self.spin_once(0.02)
        if crowd := crowded_topics(self.plant.count_publishers):
            raise GraphError(f"{crowd[0]}: {ALONE}")
        return True

    def spin_once(self, timeout: float = 0.2) -> None:
        """Let the nodes work on what has come; return at the latest after ``timeout`` [s]."""
        self._executor.spin_once(timeout_sec=timeout)

    def close(self) -> None:
        """Close the bag, end the nodes."""
        if self.recorder is not None:
            self.recorder.finish()
        self._executor.shutdown()
        for node in [*self.nodes.values(), *([self.recorder] if self.recorder is not None else [])]:
            node.destroy_node()
        self.nodes, self.recorder = {}, None
        self._context.try_shutdown()

    def _made(self, node_class: type[Any], parameters: Mapping[str, Any], **options: Any) -> Any:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        node = node_class(
            context=self._context,
            namespace=self.plan.namespace or None,
            parameter_overrides=overrides,
            use_global_arguments=False,
            **options,
        )
        self._executor.add_node(node)
        return node

    def _missing(self) -> list[str]:
        return [
            f"{name}: {lack}"
            for name, node in self.nodes.items()
            for lack in missing_connections(name, node.connections())
        ]
