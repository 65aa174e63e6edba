# pyright: basic
"""The laws that the nodes of a graph run, compiled before the nodes start, and side by side."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable

from quadftc_compile.engine import CEngine
from quadftc_control.attitude_loop import AttitudeLoop
from quadftc_control.controller import controller_from
from quadftc_control.controller_node import ControllerParameters
from quadftc_control.guidance import flight_guidance_from, live_guidance_from, stand_guidance_from
from quadftc_control.position_controller_node import PositionControllerParameters
from quadftc_control.reference import SetpointFilter
from quadftc_control.reference_node import ReferenceParameters
from quadftc_fdi import disturbance_observer_node, fault_observer_node
from quadftc_fdi.disturbance_observer import DisturbanceObservation, disturbance_observer_from
from quadftc_fdi.fault_observer import fault_observer_from
from quadftc_fdi.observation import Observation
from quadftc_flight.graph.plan import GraphPlan
from quadftc_model.assembly import NodeParameters, build_prefixed
from quadftc_model.guarded import Guarded
from quadftc_model.parameters import parameters_of
from quadftc_ros.parameters import VehicleParameters
from quadftc_sim.assembly import InjectorParameters, PlantParameters, injector_from, simulator_from
from quadftc_sim.injector import Join, Split, laws_of

PARAMETERS: dict[str, type] = {  # of nodes, besides those of a vehicle and of laws
    "plant": PlantParameters,
    "fault_injector": InjectorParameters,
    "fault_observer": fault_observer_node.ObserverParameters,
    "disturbance_observer": disturbance_observer_node.ObserverParameters,
    "controller": ControllerParameters,
    "position_controller": PositionControllerParameters,
    "reference": ReferenceParameters,
}


def prepare_laws(plans: Iterable[GraphPlan]) -> None:
    """Compile the laws of graphs that are to fly in C, as far as they are not compiled yet."""
    laws = [law for plan in plans if plan.engine == "c" for law in graph_laws(plan)]
    CEngine().prepare(laws)


def graph_laws(plan: GraphPlan) -> list[object]:
    """Return the laws that the nodes of a graph run; those of a wrong parameter not: the node says it."""
    flies, found = plan.plant == "free_flight", list[object]()
    for node in plan.executables:
        with contextlib.suppress(ValueError):
            found += LAWS[node](values_of(plan, node), flies)
    return found


def values_of(plan: GraphPlan, node: str) -> NodeParameters:
    """Return the parameters of a node, with the defaults of those that are not given; none is started."""
    specs = (*parameters_of(VehicleParameters), *parameters_of(PARAMETERS[node]))
    return {**{spec.name: spec.default for spec in specs}, **plan.node_parameters(node)}


# of each node, by its parameters; whether it flies
LAWS: dict[str, Callable[[NodeParameters, bool], list[object]]] = {
    "plant": lambda values, _: [simulator_from(values).law],
    "fault_injector": lambda values, _: [
        Split(),
        Join(),
        *laws_of(tuple(injector_from(values).injections.values())).values(),
    ],
    "fault_observer": lambda values, flies: [Guarded(Observation(fault_observer_from(values), flies))],
    "disturbance_observer": lambda values, _: [
        Guarded(DisturbanceObservation(disturbance_observer_from(values)))
    ],
    "controller": lambda values, flies: [
        Guarded(AttitudeLoop(controller=controller_from(values), flies=flies))
    ],
    "reference": lambda values, _: [
        build_prefixed(SetpointFilter, values, "setpoint")
        if values["source"] == "topic"
        else stand_guidance_from(values)
    ],
    "position_controller": lambda values, _: [
        (live_guidance_from if values["source"] == "topic" else flight_guidance_from)(values)
    ],
}
