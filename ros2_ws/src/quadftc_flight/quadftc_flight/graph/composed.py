# pyright: basic
"""The graph in one process: all nodes on one executor. The default, and the fast way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.context import Context
from rclpy.parameter import Parameter

from quadftc_control.controller_node import ControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_flight.graph.following import Graph
from quadftc_flight.graph.plan import AFTERMATH, EXECUTABLES, GraphError, GraphPlan, Progress, always
from quadftc_ros.executor import Pace, settled_memory
from quadftc_ros.node import GraphNode
from quadftc_ros.recorder_node import RecorderNode
from quadftc_ros.scheduling import SchedulingError, scheduled
from quadftc_ros.topics import missing_connections
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.plant_node import PlantNode

NODE_CLASSES: dict[str, type[Any]] = {
    "fault_injector": FaultInjectorNode,
    "fault_observer": FaultObserverNode,
    "disturbance_observer": DisturbanceObserverNode,
    "reference": ReferenceNode,
    "controller": ControllerNode,
    "plant": PlantNode,
}


class ComposedVehicle:
    """The nodes of a plan in this process, on the executor of a graph.

    Parameters
    ----------
    plan : GraphPlan
    context, executor
        Of ROS; they stay open when this is closed.
    each_sample : callable
        Called after each emission of the plant.

    Raises
    ------
    ValueError
        If a parameter of a node is wrong, or the bag cannot be made.
    """

    def __init__(
        self, plan: GraphPlan, context: Context, executor: Any, each_sample: Callable[[], None]
    ) -> None:
        self.plan = plan
        self.recorder: RecorderNode | None = None
        self.nodes: dict[str, GraphNode] = {}
        self._context, self._executor = context, executor
        try:
            if plan.bag is not None:
                self.recorder = self._made(RecorderNode, plan.recorder_parameters(), subscribes=False)
            tap = None if self.recorder is None else self.recorder.tap
            for name in EXECUTABLES:
                options = {"each_sample": each_sample, "timed": False} if name == "plant" else {}
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

    def missing(self) -> list[str]:
        """Say which connections between the nodes are missing."""
        return [
            f"{name}: {lack}"
            for name, node in self.nodes.items()
            for lack in missing_connections(name, node.connections())
        ]

    def close(self) -> None:
        """Close the bag, end the nodes."""
        if self.recorder is not None:
            self.recorder.finish()
        for node in [*self.nodes.values(), *([self.recorder] if self.recorder is not None else [])]:
            node.destroy_node()
        self.nodes, self.recorder = {}, None

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


class ComposedGraph(Graph):
    """All nodes of one or more plans in this process; a context manager.

    Parameters
    ----------
    *plans : GraphPlan
        One for each vehicle, each in a namespace of its own.
    executor : str
        ``events`` or ``single``.

    Raises
    ------
    ValueError
        If a parameter of a node is wrong, a bag cannot be made, or two vehicles have one namespace.
    """

    def __init__(self, *plans: GraphPlan, executor: str = "events") -> None:
        names = [plan.namespace.strip("/") for plan in plans]
        if len(set(names)) < len(names) or not names:
            raise ValueError(f"vehicles: {len(names)} in the namespaces {', '.join(sorted(set(names)))}")
        super().__init__(executor)
        self.vehicles: list[ComposedVehicle] = []
        try:
            for plan in plans:
                vehicle = ComposedVehicle(plan, self._context, self._executor, self._slice.look)
                self.vehicles.append(vehicle)
        except BaseException:
            self.close()
            raise

    @property
    def recorder(self) -> RecorderNode | None:
        """The recorder of the first vehicle."""
        return self.vehicles[0].recorder

    @property
    def nodes(self) -> dict[str, GraphNode]:
        """The nodes of the first vehicle."""
        return self.vehicles[0].nodes

    @property
    def plant(self) -> PlantNode:
        """The plant of the first vehicle."""
        return self.vehicles[0].plant

    def run(self, progress: Progress = always) -> float:
        """Fly until the durations of all plants are over; return the wall time of the flight [s].

        Parameters
        ----------
        progress : callable
            Called with the number of samples so far, often; the flight ends early when it returns False.

        Raises
        ------
        GraphError
            If the nodes do not find each other, no sample comes for too long, or the machine does not allow
            the scheduling.
        """
        if not self.wait_until_connected(progress):
            return 0.0
        plan = self.vehicles[0].plan
        pace = Pace(self._executor, self._watchers(), poll=plan.scheduling.wait == "poll")
        spin = self._slice.spin if plan.mode == "lockstep" else pace.spin
        try:
            with settled_memory(), scheduled(plan.scheduling):
                return self._fly(spin, progress)
        except SchedulingError as error:
            raise GraphError(str(error)) from None

    def _fly(self, spin: Callable[[float], None], progress: Progress) -> float:
        for vehicle in self.vehicles:
            vehicle.plant.start()
        wall, to_its_end = self._follow(spin, progress, "no torque/command came for the last")
        if to_its_end:
            spin(AFTERMATH)  # what follows from the last sample is on its way
        return wall

    def _missing(self) -> list[str]:
        return [lack for vehicle in self.vehicles for lack in vehicle.missing()]

    def _watchers(self) -> list[PlantNode]:
        return [vehicle.plant for vehicle in self.vehicles]

    def _state(self) -> tuple[bool, int]:
        plants = self._watchers()
        return all(plant.finished for plant in plants), sum(plant.samples for plant in plants)

    def spin_once(self, timeout: float = 0.2) -> None:
        """Let the nodes work on what has come; return at the latest after ``timeout`` [s]."""
        self._executor.spin_once(timeout_sec=timeout)

    def close(self) -> None:
        """Close the bags, end the nodes."""
        for vehicle in self.vehicles:
            if vehicle.recorder is not None:
                vehicle.recorder.finish()
        self._executor.shutdown()
        for vehicle in self.vehicles:
            vehicle.close()
        self.vehicles = []
        self._context.try_shutdown()
