# pyright: basic
"""The graph in one process: all nodes on one executor. The default, and the fast way."""

from __future__ import annotations

from typing import Any

from quadftc_control.controller_node import ControllerNode
from quadftc_control.position_controller_node import PositionControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_flight.graph.following import Graph
from quadftc_flight.graph.laws import prepare_laws
from quadftc_flight.graph.plan import AFTERMATH, GraphError, GraphPlan, Progress, always
from quadftc_ros.executor import Pace, settled_memory
from quadftc_ros.recorder_node import RecorderNode
from quadftc_ros.scheduling import SchedulingError, scheduled
from quadftc_ros.topics import missing_connections
from quadftc_ros.transport import Tap, both
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.plant_node import PlantNode

RECORDER = "recorder"
NODE_CLASSES: dict[str, type[Any]] = {
    "fault_injector": FaultInjectorNode,
    "fault_observer": FaultObserverNode,
    "disturbance_observer": DisturbanceObserverNode,
    "reference": ReferenceNode,
    "position_controller": PositionControllerNode,
    "controller": ControllerNode,
    "plant": PlantNode,
}


class ComposedGraph(Graph):
    """All nodes of plans, each of a vehicle in a namespace of its own, in this process; a context manager.

    ``tap`` gets a copy of what all nodes publish. Wrong parameters of a node, a bag that cannot be made, and
    two vehicles in one namespace are a ValueError.
    """

    def __init__(self, *plans: GraphPlan, tap: Tap | None = None) -> None:
        names = [plan.namespace.strip("/") for plan in plans]
        if len(set(names)) < len(names) or not names:
            raise ValueError(f"vehicles: {len(names)} in the namespaces {', '.join(sorted(set(names)))}")
        prepare_laws(plans)
        super().__init__()
        self._plan, self._tap = plans[0], tap
        self._vehicles: list[dict[str, Any]] = []  # the nodes of each by name, its recorder among them
        try:
            for plan in plans:
                self._vehicles.append({})
                self._add_vehicle(plan, self._vehicles[-1])
        except BaseException:
            self.close()
            raise

    def _add_vehicle(self, plan: GraphPlan, nodes: dict[str, Any]) -> None:
        tap, remaps = self._tap, plan.remap_arguments
        if plan.bag is not None:
            parameters, inside = plan.recorder_parameters(), (*plan.executables, RECORDER)
            nodes[RECORDER] = self._add_node(RecorderNode, plan.namespace, parameters, remaps, inside=inside)
            tap = both(nodes[RECORDER].tap, tap)
        for name in plan.executables:
            options = {"each_sample": self._slice.look, "timed": False} if name == "plant" else {}
            parameters = plan.node_parameters(name)
            nodes[name] = self._add_node(
                NODE_CLASSES[name], plan.namespace, parameters, remaps, tap=tap, **options
            )
        if not plan.onboard:
            self._watchers.append((nodes["plant"], plan.plant))

    @property
    def nodes(self) -> dict[str, Any]:
        """The nodes of the first vehicle, with its recorder."""
        return self._vehicles[0]

    def run(self, progress: Progress = always) -> float:
        """Fly until the durations of all plants are over; return the wall time of the flight [s].

        A GraphError says if nodes do not find each other, samples stop, or the scheduling is not allowed.
        """
        if self._plan.onboard:
            with settled_memory(), scheduled(self._plan.scheduling):
                return self._serve(self._slice.spin, progress)
        if not self.wait_until_connected(progress):
            return 0.0
        scheduling, plants = self._plan.scheduling, [vehicle["plant"] for vehicle in self._vehicles]
        pace = Pace(self._executor, plants, poll=scheduling.wait == "poll")
        spin = self._slice.spin if self._plan.mode == "lockstep" else pace.spin
        try:
            with settled_memory(), scheduled(scheduling):
                for plant in plants:
                    plant.start()
                wall = self._follow(spin, progress, "no torque/command came for the last")
                if self.flew_to_its_end:
                    spin(AFTERMATH)  # what follows from the last sample is on its way
        except SchedulingError as error:
            raise GraphError(str(error)) from None
        return wall

    def _missing(self) -> list[str]:
        nodes = [item for vehicle in self._vehicles for item in vehicle.items() if item[0] != RECORDER]
        lacks = [
            (name, missing_connections(name, node.connections(), plant=node.plant_kind))
            for name, node in nodes
        ]
        return [f"{name}: {lack}" for name, missing in lacks for lack in missing]

    def _state(self) -> tuple[bool, int]:
        flights = [vehicle["plant"].flight for vehicle in self._vehicles]
        return all(flight.finished for flight in flights), sum(flight.emitted for flight in flights)
