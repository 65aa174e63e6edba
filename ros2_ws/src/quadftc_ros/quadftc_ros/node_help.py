# pyright: basic
"""What an executable of a node says of itself: ``--help``, and a line when it runs."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.node import Node

from quadftc_ros.parameters import NodeParameters
from quadftc_ros.topics import TOPICS

HELP = ("-h", "--help")
COMMON = ("/rosout", "/parameter_events", "/transition_event")  # topics of every node
USAGE = "[--ros-args -p NAME:=VALUE -r TOPIC:=OTHER --params-file FILE]"


def wants_help(arguments: Sequence[str]) -> bool:
    """Whether a command line asks for help."""
    return any(word in HELP for word in arguments)


def help_text(make: Callable[[], Node]) -> str:
    """Return the help of an executable: its module's words, its topics with types, its parameters.

    The node is made for it, and destroyed; ROS must have been started.
    """
    source: Any = make
    while isinstance(source, partial):
        source = source.func
    module = inspect.getmodule(source)
    name, topics = sys.argv[0].rpartition("/")[2], dict[str, tuple[str, str]]()
    try:
        node = make()
        name, topics = node.get_name(), _topics_of(node)
        node.destroy_node()
    except ValueError as error:  # a parameter that has to be given; those before it are known
        missing = [f"Must be given: {error}", ""]
    else:
        missing: list[str] = []
    topics |= {  # of both kinds of plant
        each.name: (each.type_name, "out" if name in each.publishers else "in")
        for each in TOPICS.values()
        if name in (*each.publishers, *each.readers)
    }
    rows = [(topic, *topics[topic]) for topic in sorted(topics)]
    parameters = [
        (parameter, _default(default), words) for parameter, default, words in sorted(NodeParameters.told)
    ]
    words = inspect.getdoc(module) or ""
    parts = [f"Usage: {sys.argv[0].rpartition('/')[2]} {USAGE}", "", words, "", *missing]
    if rows:
        parts += ["Topics:", *_aligned(rows), ""]
    parts += ["Parameters (name, default, meaning):", *_aligned(parameters)]
    return "\n".join(parts) + "\n"


def _topics_of(node: Node) -> dict[str, tuple[str, str]]:
    """Return type and direction of each topic that a node has, without those of every node of ROS."""
    found: dict[str, tuple[str, str]] = {}
    for direction, ends in (("in", node.subscriptions), ("out", node.publishers)):
        for end in ends:
            kind: Any = end.msg_type
            topic = end.topic_name if end.topic_name in TOPICS else end.topic_name.removeprefix("/")
            if not end.topic_name.endswith(COMMON):
                found[topic] = (f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}", direction)
    return found


def running_line(node: Node) -> str:
    """Return a line that says which node runs, on which vehicle, with which law."""
    names = ("vehicle", "plant", "observer", "controller", "position_controller", "source", "directory")
    given = [f"{name} {node.get_parameter(name).value}" for name in names if node.has_parameter(name)]
    return (
        f"runs{': ' if given else ''}{', '.join(given)}; Ctrl-C ends it, --help tells topics and parameters"
    )


def _default(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return ",".join(map(_default, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value) or "none"


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Return rows as lines whose columns stand below each other."""
    widths = [max((len(row[k]) for row in rows), default=0) for k in range(2)]
    return [f"  {row[0]:{widths[0]}}  {row[1]:{widths[1]}}  {row[2]}" for row in rows]
