"""Write the SROS2 policy of the nodes from the table of topics: who may publish, read, serve and call what.

    python3 -m quadftc_ros.policy [NAMESPACE] > quadftc.policy.xml

Names are relative: ``ns`` of a profile is the namespace of the vehicle, which may follow on the command line.
Each node has an enclave, and so have the launcher with its recorder, and an operator (``quadftc``, ``ros2``),
who may read and call everything.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from xml.etree import ElementTree as ET

from quadftc_ros.reach import ENCLAVE
from quadftc_ros.topics import GRAPHS, NODES, OPTIONAL_NODES, TOPICS

SERVICES = {  # that nodes offer, besides those of every node
    "plant": ("start", "reset"),
    "fault_injector": ("inject", "clear", "reset"),
    "fault_observer": ("reset",),
    "disturbance_observer": ("reset",),
    "controller": ("reset",),
    "reference": ("reset",),
    "position_controller": ("reset",),
    "attitude_estimator": ("reset",),
    "recorder": (),
}
EVERY_NODE = (
    *("describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters"),
    *("set_parameters_atomically", "get_type_description", "change_state", "get_state"),
    *("get_available_states", "get_available_transitions", "get_transition_graph"),
)
TOLD = ("/rosout", "/parameter_events", "/diagnostics")
HEARD = ("/clock", "/parameter_events")
# what no node of a graph waits for
BESIDE = {"plant": ("imu/mag", "imu/static_pressure"), "attitude_estimator": ("imu/data",)}
OWN = "~/loop"  # that `doctor` sends to itself
OPERATORS = tuple(row.name for row in TOPICS.values() if row.name.endswith("setpoint"))


def topics_of(node: str) -> tuple[list[str], list[str]]:
    """Return what a node publishes and reads, in whatever graph, without what every node does."""
    rows = [row for graph in GRAPHS.values() for row in graph.values() if row.name != "/diagnostics"]
    gives = {row.name for row in rows if node in row.publishers} | {*BESIDE.get(node, ())}
    return sorted(gives), sorted({row.name for row in rows if node in row.readers})


def policy(namespace: str = "/") -> str:
    """Return the policy of a vehicle's nodes as XML."""
    root = ET.Element("policy", version="0.2.0")
    enclaves = ET.SubElement(root, "enclaves")
    nodes = [*dict.fromkeys(sum(NODES.values(), OPTIONAL_NODES))]
    everything = sorted(TOPICS)
    calls = [f"{node}/{service}" for node in nodes for service in (*SERVICES[node], *EVERY_NODE)]
    for node in nodes:
        gives, reads = topics_of(node)
        profile = _profile(enclaves, node, node, namespace)
        _allow(profile, "topics", "topic", publish=(*TOLD, "~/transition_event", *gives))
        _allow(profile, "topics", "topic", subscribe=(*HEARD, *reads))
        _allow(profile, "services", "service", reply=[f"~/{each}" for each in (*SERVICES[node], *EVERY_NODE)])
    for enclave, node in (("launcher", "launch_graph"), ("launcher", "recorder"), ("operator", "quadftc_*")):
        profile = _profile(enclaves, enclave, node, namespace)
        hears, tells = ((OWN,), (OWN, *OPERATORS)) if enclave == "operator" else ((), ())
        _allow(profile, "topics", "topic", publish=(*TOLD, "~/transition_event", *tells))
        _allow(profile, "topics", "topic", subscribe=(*HEARD, "/rosout", *hears, *everything))
        _allow(profile, "services", "service", reply=[f"~/{each}" for each in EVERY_NODE])
        _allow(profile, "services", "service", request=calls)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _profile(enclaves: ET.Element, enclave: str, node: str, namespace: str) -> ET.Element:
    """Return a new profile of a node, in an enclave that is made if it is not there."""
    path = f"{ENCLAVE}/{enclave}"
    found = next((each for each in enclaves if each.get("path") == path), None)
    if found is None:
        found = ET.SubElement(enclaves, "enclave", path=path)
        ET.SubElement(found, "profiles")
    return ET.SubElement(found[0], "profile", ns=namespace, node=node)


def _allow(profile: ET.Element, kind: str, item: str, **named: Sequence[str]) -> None:
    for right, names in named.items():
        group = ET.SubElement(profile, kind, {right: "ALLOW"})
        for name in dict.fromkeys(names):
            ET.SubElement(group, item).text = name


if __name__ == "__main__":
    sys.stdout.write(policy(*sys.argv[1:]))
