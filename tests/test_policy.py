"""The SROS2 policy lets each node do what it does."""

from xml.etree import ElementTree as ET

import pytest

from quadftc_control.controller_node import ControllerNode
from quadftc_control.position_controller_node import PositionControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.attitude_estimator_node import AttitudeEstimatorNode
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_ros.policy import policy
from quadftc_ros.topics import NODES
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.plant_node import PlantNode
from wired_node import Wired

CLASSES = {
    "plant": PlantNode,
    "fault_injector": FaultInjectorNode,
    "fault_observer": FaultObserverNode,
    "disturbance_observer": DisturbanceObserverNode,
    "controller": ControllerNode,
    "reference": ReferenceNode,
    "position_controller": PositionControllerNode,
    "attitude_estimator": AttitudeEstimatorNode,
}
FLYING = {"plant": {"plant": "free_flight", "mag.rate": 50.0, "baro.rate": 50.0}}
CASES = [("test_stand", name) for name in (*NODES["test_stand"], "attitude_estimator")]
CASES += [("free_flight", name) for name in NODES["free_flight"]]


def allowed(node):
    """What the policy lets a node do: (right, full name)."""
    profile = ET.fromstring(policy().encode()).find(f".//profile[@node='{node}']")
    assert profile.get("ns") == "/"
    return {
        (right, f"/{item.text.replace('~', node)}" if item.text[0] != "/" else item.text)
        for group in profile
        for right in group.attrib
        for item in group
    }


def test_profiles_are_in_the_namespace_that_is_asked_for():
    profiles = ET.fromstring(policy("/drone1").encode()).findall(".//profile")
    assert {profile.get("ns") for profile in profiles} == {"/drone1"}


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_node_does_no_more_than_its_policy_allows(kind, name):
    given = {"plant_kind": kind, "engine": "numpy"} | (FLYING.get(name, {}) if kind == "free_flight" else {})
    if name in ("reference", "position_controller"):
        given["source"] = "topic"
    for mode in ("realtime", "lockstep"):
        with Wired(CLASSES[name], mode, **given) as wired:
            node = wired.node
            does = {("publish", publisher.topic_name) for publisher in node.publishers}
            does |= {("subscribe", reader.topic_name) for reader in node.subscriptions}
            does |= {("reply", service.service_name) for service in node.services}
        assert does - allowed(name) == set()


def test_only_the_controller_may_command_a_torque():
    assert {node for node in CLASSES if ("publish", "/torque/command") in allowed(node)} == {"controller"}
