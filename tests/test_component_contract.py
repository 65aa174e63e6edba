"""What every component of every registry keeps: documented parameters, which a node hands on as they are."""

import pytest

from quadftc_control.controller import controllers
from quadftc_control.position_controller import position_controllers
from quadftc_control.reference import references
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.assembly import build_prefixed, node_values
from quadftc_model.parameters import parameters_of
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.disturbance import disturbances
from quadftc_sim.fault import faults
from quadftc_sim.rotor_fault import rotor_faults
from quadftc_sim.wind import winds

FLYING = (controllers, position_controllers, fault_observers, disturbance_observers)  # built for a vehicle
OTHERS = (references, disturbances, winds, faults, rotor_faults)
EVERY_COMPONENT = pytest.mark.parametrize(
    ("component", "given"),
    [
        pytest.param(registry.get(name), given, id=f"{registry.kind} {name}")
        for registries, given in ((FLYING, {"vehicle": load_vehicle("qball_x4")}), (OTHERS, {}))
        for registry in registries
        for name in registry.names()
    ],
)


@EVERY_COMPONENT
def test_parameters_are_documented_with_a_unit_and_defaults_are_valid(component, given):
    assert all(spec.doc and spec.unit for spec in parameters_of(component))
    component(**given)


@EVERY_COMPONENT
def test_parameters_survive_the_way_through_a_node(component, given):
    vectors = [spec for spec in parameters_of(component) if spec.is_vector]
    amounts = {spec.name: tuple(max(each, spec.low) for each in (0.2, -0.3, 0.4)) for spec in vectors}
    times = {spec.name: 1.0 for spec in parameters_of(component) if spec.name == "start"}
    law = component(**given, **amounts, **times)
    again = build_prefixed(type(law), node_values(law, "c"), "c", **given)
    assert node_values(again, "c") == node_values(law, "c")
    assert not amounts or node_values(law, "c") != node_values(component(**given), "c")
