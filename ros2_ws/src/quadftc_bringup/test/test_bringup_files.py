"""The files of this package name only nodes, topics and message fields that exist."""

import ast
import importlib
import importlib.metadata
import json
import re
from pathlib import Path

import pytest
import yaml

from quadftc_bags.interfaces import load_message_class
from quadftc_control.controller_node import ControllerNode
from quadftc_control.position_controller_node import PositionControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_ros.scene_node import SceneNode
from quadftc_ros.topics import NODES, TOPICS
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.plant_node import PlantNode
from quadftc_sim.sensors import GRADES
from wired_node import Wired

PACKAGE = Path(__file__).parents[1]
LAUNCH_FILE = PACKAGE / "launch" / "graph.launch.py"
NODE_CLASSES = {
    "controller": ControllerNode,
    "disturbance_observer": DisturbanceObserverNode,
    "fault_injector": FaultInjectorNode,
    "fault_observer": FaultObserverNode,
    "plant": PlantNode,
    "position_controller": PositionControllerNode,
    "reference": ReferenceNode,
    "scene": SceneNode,
}
PARAMETER_FILES = sorted((PACKAGE / "config").glob("*.yaml"))
GAINS = sorted(PACKAGE.parents[2].glob("gains/*_mems.yaml"))  # in a clone
NODE_NAMES = {*NODES["test_stand"], *NODES["free_flight"], "recorder", "scene"}


def literals_of(tree):
    """Return the module-level constants of a parsed module."""
    found = {}
    for statement in tree.body:
        if isinstance(statement, ast.Assign):
            found[statement.targets[0].id] = ast.literal_eval(statement.value)
    return found


def values_in(panel):
    """Return the message paths that a panel shows."""
    return [path["value"] for path in panel.get("paths", [])]


def message_paths():
    layout = json.loads((PACKAGE / "foxglove" / "quadftc.json").read_text())
    return [value for panel in layout["configById"].values() for value in values_in(panel)]


def test_launch_file_starts_the_installed_executables_of_every_node():
    constants = literals_of(ast.parse(LAUNCH_FILE.read_text()))
    alone = ("PLANT", "FAULT_INJECTOR", "RECORDER", "SCENE")
    launched = {*map(constants.get, alone), *constants["ONBOARD"], *constants["GUIDANCE"].values()}
    installed = {
        (entry.module.split(".")[0], entry.name)
        for entry in importlib.metadata.entry_points(group="console_scripts")
        if entry.module.startswith("quadftc_")
    }
    assert {name for _, name in launched} == NODE_NAMES
    assert launched <= installed


def test_launch_file_describes_the_graph_where_launch_is_installed():
    pytest.importorskip("launch_ros")
    namespace = {"__name__": "graph_launch"}
    exec(compile(LAUNCH_FILE.read_text(), str(LAUNCH_FILE), "exec"), namespace)
    assert len(namespace["generate_launch_description"]().entities) > len(NODE_NAMES)


@pytest.mark.parametrize("path", message_paths())
def test_layout_shows_an_existing_field(path):
    topic, *fields = path.removeprefix("/").split(".")
    message_class = load_message_class(TOPICS[topic].type_name)
    for field in fields:
        name, index = re.fullmatch(r"(\w+)(\[\d\])?", field).groups()
        field_type = message_class.get_fields_and_field_types()[name]
        assert index is None or int(index[1]) < int(re.search(r"\[(\d+)\]", field_type)[1])
        if "/" in field_type:
            package, message = field_type.split("/")
            message_class = load_message_class(f"{package}/msg/{message}")


def test_layout_shows_whole_messages_of_existing_topics():
    layout = json.loads((PACKAGE / "foxglove" / "quadftc.json").read_text())
    shown = [
        panel["topicPath"].removeprefix("/")
        for panel in layout["configById"].values()
        if "topicPath" in panel
    ]
    assert shown == ["diagnosis"]
    assert set(shown) <= set(TOPICS)


def test_viewers_show_what_the_scene_publishes():
    layout = json.loads((PACKAGE / "foxglove" / "quadftc.json").read_text())
    rviz = yaml.safe_load((PACKAGE / "rviz" / "quadftc.rviz").read_text())["Visualization Manager"]
    told = importlib.import_module("quadftc_ros.scene_node").__doc__
    shown = {topic for panel in layout["configById"].values() for topic in panel.get("topics", {})}
    for display in rviz["Displays"]:
        shown |= {display[key]["Value"] for key in ("Topic", "Description Topic") if key in display}
    assert {topic for topic in shown if topic.removeprefix("/") not in told} == set()
    assert "/scene/markers" in shown


def test_layout_places_every_panel_once():
    layout = json.loads((PACKAGE / "foxglove" / "quadftc.json").read_text())
    placed = re.findall(r"\w+!\w+", json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])


@pytest.mark.parametrize("file", PARAMETER_FILES, ids=lambda file: file.name)
def test_parameter_file_fits_existing_nodes_in_any_namespace(file):
    content = yaml.safe_load(file.read_text())
    for key, section in content.items():
        assert key == "/**" or key.removeprefix("/**/") in NODE_NAMES
        assert set(section) == {"ros__parameters"}
        assert set(section["ros__parameters"].get("topics", [])) <= set(TOPICS)


def parameters_in(file, node):
    """Return what a parameter file says to a node."""
    content = yaml.safe_load(file.read_text())
    sections = [content[key]["ros__parameters"] for key in ("/**", f"/**/{node}") if key in content]
    return {name: value for section in sections for name, value in section.items()}


@pytest.mark.parametrize("file", PARAMETER_FILES, ids=lambda file: file.name)
def test_nodes_take_every_value_of_a_parameter_file(file):
    kind = "free_flight" if file.stem == "free_flight" else "test_stand"
    for node in (*NODES[kind], "scene"):
        given = {"plant_kind": kind, **parameters_in(file, node)}
        with Wired(NODE_CLASSES[node], given.pop("mode", "realtime"), **given) as wired:
            assert wired.node.settings.unknown() == []


@pytest.mark.parametrize("name", ["graph", "crazyflie_2x", "hummingbird", "qball_x4", "x500"])
def test_imu_in_a_parameter_file_is_a_mems_one(name):
    given = parameters_in(PACKAGE / "config" / f"{name}.yaml", "plant")
    imu = {key.removeprefix("imu."): value for key, value in given.items() if key.startswith("imu.")}
    assert imu == GRADES["mems"]


@pytest.mark.parametrize("gains", GAINS, ids=lambda file: file.name)
def test_gains_in_the_parameter_file_of_a_vehicle_are_the_tuned_ones(gains):
    tuned = yaml.safe_load(gains.read_text())
    file = PACKAGE / "config" / f"{tuned['vehicle']}.yaml"
    for role in ("controller", "disturbance_observer"):
        kind = tuned[role].pop("kind")
        given = parameters_in(file, role)
        assert {name: given[f"{kind}.{name}"] for name in tuned[role]} == tuned[role]


def reported_parts():
    """Names of all parts that nodes report to /diagnostics, as "node: part"."""
    for source in sorted(PACKAGE.parent.glob("quadftc_*/quadftc_*/*_node.py")):
        node = source.stem.removesuffix("_node")
        for part in re.findall(r'(?:\.report|_report_fault)\(\s*f?"([^"]+)"', source.read_text()):
            for component in ("gyro", "accelerometer", "rotor") if "{component}" in part else ("",):
                yield f"{node}: {part.format(component=component, axis='roll')}"
    yield from (f"plant: {part}" for part in ("connections", "lifecycle", "publishers", "samples", "timing"))


def test_monitor_shows_every_part_of_the_diagnostics_in_one_group():
    groups = yaml.safe_load((PACKAGE / "diagnostics" / "analyzers.yaml").read_text())
    groups = groups["analyzers"]["ros__parameters"]
    words = [group["contains"] for group in groups.values() if isinstance(group, dict)]
    parts = sorted({*reported_parts()})
    assert len(parts) > 15
    for part in parts:
        assert sum(any(word in part for word in group) for group in words) == 1, part
    for group in words:
        assert all(any(word in part for part in parts) for word in group), group
