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
from quadftc_ros.topics import NODES, TOPICS

PACKAGE = Path(__file__).parents[1]
LAUNCH_FILE = PACKAGE / "launch" / "graph.launch.py"
NODE_NAMES = {*NODES["test_stand"], *NODES["free_flight"], "recorder"}


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
    launched = {constants["PLANT"], constants["FAULT_INJECTOR"], constants["RECORDER"], *constants["ONBOARD"]}
    launched |= {*constants["GUIDANCE"].values()}
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


@pytest.mark.parametrize("file", sorted((PACKAGE / "config").glob("*.yaml")), ids=lambda file: file.name)
def test_parameter_file_fits_existing_nodes_in_any_namespace(file):
    content = yaml.safe_load(file.read_text())
    for key, section in content.items():
        assert key == "/**" or key.removeprefix("/**/") in NODE_NAMES
        assert set(section) == {"ros__parameters"}
        assert set(section["ros__parameters"].get("topics", [])) <= set(TOPICS)
