"""Executables of nodes: help with topics and parameters, a line when they run."""

import sys
from types import SimpleNamespace

import pytest

from node_bench import NodeBench
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_ros.node_help import help_text, running_line, wants_help
from quadftc_ros.recorder_node import RecorderNode
from quadftc_ros.scene_node import SceneNode


@pytest.fixture
def told(monkeypatch):
    """The help of a node."""
    monkeypatch.setattr(sys, "argv", ["/somewhere/executable", "--help"])
    with NodeBench("realtime") as bench:

        def of(node_class):
            def make():
                return node_class(context=bench.context)

            make.__module__ = node_class.__module__
            return help_text(make)

        yield of


def test_help_is_asked_for_by_either_word():
    assert wants_help(["--help"])
    assert wants_help(["--ros-args", "-h"])
    assert not wants_help(["--ros-args", "-p", "helper:=1"])


def test_help_has_usage_topics_and_parameters(told):
    words = told(FaultObserverNode)
    assert words.startswith("Usage: executable [--ros-args")
    assert "Services: ~/reset" in words
    lines = [line.split() for line in words.splitlines()]
    assert ["imu/data", "sensor_msgs/msg/Imu", "in"] in lines
    assert ["imu/corrected", "sensor_msgs/msg/Imu", "out"] in lines
    assert ["observer", "bank", "name", "of", "the", "fault"] in [line[:6] for line in lines]


def test_help_has_topics_that_are_not_of_the_table_and_bounds(told):
    words = told(SceneNode)
    lines = [line.split() for line in words.splitlines()]
    assert ["scene/markers", "visualization_msgs/msg/MarkerArray", "out"] in lines
    assert ["imu/corrected", "sensor_msgs/msg/Imu", "in"] in lines
    assert "pictures a second [Hz] (1 to 60)" in words


def test_help_of_a_node_with_a_parameter_that_must_be_given_says_which(told):
    words = told(RecorderNode)
    assert "Must be given: directory = ''" in words
    assert "directory of the bag to write" in words


def test_running_node_says_what_it_runs():
    values = {"vehicle": "x500", "observer": "isolating"}
    node = SimpleNamespace(
        has_parameter=values.__contains__, get_parameter=lambda name: SimpleNamespace(value=values[name])
    )
    assert running_line(node).startswith("runs: vehicle x500, observer isolating; Ctrl-C ends it")
