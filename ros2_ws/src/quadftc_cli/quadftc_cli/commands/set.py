# pyright: basic
"""``quadftc set``: parameters of nodes that run, and setpoints."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from typer import Argument

from quadftc_cli.commands.inject import NamespaceOption
from quadftc_cli.screen import console, plain_table, say
from quadftc_control.reference import MAX_TILT
from quadftc_flight.graph.plan import GraphError
from quadftc_model.hints import nearest
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.units import quantity

if TYPE_CHECKING:
    from quadftc_cli.live import LiveGraph

SETPOINTS = {  # what is set -> topic, names of the values with their units
    "attitude": ("attitude/setpoint", {"roll": "rad", "pitch": "rad", "yaw": "rad"}),
    "position": ("position/setpoint", {"x": "m", "y": "m", "z": "m", "yaw": "rad"}),
}
TILTS = ("roll", "pitch")
NEEDED = ("x", "y", "z")  # what nobody wants to be 0 unasked
_UNIT = re.compile(r"\[([^][]+)\]$")
LIVE = "is the graph started with --live, or the reference with source:=topic?"


def set_(
    target: Annotated[str, Argument(metavar="NODE|attitude|position", help="What to set.")],
    values: Annotated[
        list[str], Argument(metavar="[NAME=VALUE]...", help="None: show what can be set.")
    ] = [],  # noqa: B006
    namespace: NamespaceOption = "",
) -> None:
    """Set where a vehicle shall be, or parameters of a node that runs.

    \b
    attitude roll=5deg                     follow an attitude, if the reference is live
    position x=1 y=0 z=2 yaw=90deg         in free flight, a place
    fault_observer                         show the parameters of a node
    fault_observer isolating.NAME=VALUE    change one
    fault_observer observer=supervised     change the observer in flight
    fault_observer lifecycle=deactivate    have a node rest
    """  # noqa: D301 (that is how Click keeps lines)
    pairs = read_pairs(values)
    if target in SETPOINTS and not pairs:
        say(f"{target}: {', '.join(f'{name}=... {unit}' for name, unit in SETPOINTS[target][1].items())}")
        say("or with a unit, such as 5deg; an angle that is not given is 0")
    elif target in SETPOINTS:
        _send_setpoint(target, pairs, namespace)
    else:
        _set_parameters(target, pairs, namespace)


def read_pairs(words: Sequence[str]) -> dict[str, str]:
    """Return values by name, from ``name=value`` words."""
    pairs: dict[str, str] = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not (name and equals and value):
            raise ValueError(f"{word!r}: expected NAME=VALUE")
        if name in pairs:
            raise ValueError(f"{name}: given twice")
        pairs[name] = value
    return pairs


def setpoint_values(target: str, pairs: dict[str, str]) -> dict[str, float]:
    """Return the values of a setpoint in SI; angles that are not given are 0."""
    units = SETPOINTS[target][1]
    numbers = dict.fromkeys(units, 0.0)
    for name, text in pairs.items():
        if name not in units:
            raise ValueError(f"{name}: no part of {target}{nearest(name, units)}; it has {', '.join(units)}")
        try:
            numbers[name] = quantity(text, units[name])
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        if units[name] == "rad" and abs(numbers[name]) > 2.0 * np.pi:
            is_bare = text.strip()[-1:] in "0123456789."  # of degrees, somebody thought
            meant = f"that is {np.degrees(numbers[name]):.0f} deg; write {text.strip()}deg"
            raise ValueError(f"{name} = {text}: {meant if is_bare else 'must be within -360 to 360 deg'}")
        if target == "attitude" and name in TILTS and abs(numbers[name]) > MAX_TILT:
            most = np.degrees(MAX_TILT)
            raise ValueError(f"{name} = {text}: must be within {-most:.0f} to {most:.0f} deg")
    if missing := [name for name in units if name in NEEDED and name not in pairs]:
        raise ValueError(f"{target}: {', '.join(missing)} missing; expected x=... y=... z=..., in m")
    return numbers


def setpoint_message(target: str, numbers: dict[str, float]) -> Any:
    """Return the message of a setpoint in SI, but for its stamp."""
    from quadftc_bags.interfaces import load_message_class  # starts ROS
    from quadftc_ros.topics import TOPICS

    topic = SETPOINTS[target][0]
    message: Any = load_message_class(TOPICS[topic].type_name)()
    message.header.frame_id = TOPICS[topic].frame
    if target == "attitude":
        message.vector.x, message.vector.y, message.vector.z = numbers.values()
    else:
        place, turn = message.pose.position, message.pose.orientation
        place.x, place.y, place.z, yaw = numbers.values()
        turn.x, turn.y, turn.z, turn.w = map(float, quaternion_from_euler(np.array([0.0, 0.0, yaw])))
    return message


def _send_setpoint(target: str, pairs: dict[str, str], namespace: str) -> None:
    numbers, topic = setpoint_values(target, pairs), SETPOINTS[target][0]
    message = setpoint_message(target, numbers)
    from quadftc_cli.live import LiveGraph

    with LiveGraph(namespace) as graph:
        graph.choose_vehicle("controller/get_parameters")
        publisher = graph.publisher(topic)
        if publisher is None:
            raise GraphError(f"nobody reads {topic}: {LIVE}")
        if graph.node.count_publishers(publisher.topic_name) > 1:
            raise GraphError(f"{topic}: another node publishes it, and is followed; end that first")
        message.header.stamp = graph.node.get_clock().now().to_msg()
        publisher.publish(message)
        publisher.wait_for_all_acked()
    say(f"{topic}: {', '.join(f'{name}={value:g}' for name, value in numbers.items())} (SI)")


def _set_parameters(node: str, pairs: dict[str, str], namespace: str) -> None:
    """Show the parameters of a node, or change some, and its state."""
    from rcl_interfaces.msg import Parameter
    from rcl_interfaces.srv import SetParameters

    from quadftc_cli.live import LiveGraph

    with LiveGraph(namespace) as graph:
        if transition := pairs.pop("lifecycle", ""):
            _change_state(graph, node, transition)
            if not pairs:
                return
        present = _present_parameters(graph, node)
        if unknown := next((name for name in pairs if name not in present), None):
            hint = nearest(unknown, present)
            raise ValueError(f"{node} has no parameter {unknown}{hint}; it has {', '.join(present)}")
        if not pairs:
            table = plain_table(("parameter", "value"), ())
            table.add_column("what it is")
            for name, (value, about) in present.items():
                fixed = " (read at the start)" if about.read_only else ""
                table.add_row(name, str(value), about.description + fixed)
            console().print(table)
            return
        wanted = [
            Parameter(name=name, value=parameter_value(text, present[name][1]))
            for name, text in pairs.items()
        ]
        request = SetParameters.Request(parameters=wanted)
        results = graph.call(f"{node}/set_parameters", SetParameters, request).results
    pairwise = zip(pairs, results, strict=True)
    if refused := [f"{name}: {each.reason}" for name, each in pairwise if not each.successful]:
        raise ValueError("\n".join(refused))
    say(*(f"{node}: {name} = {text}" for name, text in pairs.items()))


def _change_state(graph: LiveGraph, node: str, transition: str) -> None:
    """Have a node make a transition of its lifecycle."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions

    asked = GetAvailableTransitions.Request()
    ways = graph.call(f"{node}/get_available_transitions", GetAvailableTransitions, asked)
    labels = [each.transition.label for each in ways.available_transitions]
    if transition not in labels:
        raise ValueError(f"lifecycle: {transition!r}: expected one of {', '.join(labels)}")
    request = ChangeState.Request(transition=Transition(label=transition))
    if not graph.call(f"{node}/change_state", ChangeState, request).success:
        raise GraphError(f"{node} refuses to {transition}; its log says why")
    say(f"{node}: {transition}")


def _present_parameters(graph: LiveGraph, node: str) -> dict[str, tuple[object, Any]]:
    """Return value and descriptor of each parameter of a node, by name."""
    from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
    from rclpy.parameter import parameter_value_to_python

    listed = graph.call(f"{node}/list_parameters", ListParameters, ListParameters.Request()).result.names
    names = sorted(name for name in listed if not name.startswith("qos_overrides."))
    values = graph.call(f"{node}/get_parameters", GetParameters, GetParameters.Request(names=names)).values
    request = DescribeParameters.Request(names=names)
    told = graph.call(f"{node}/describe_parameters", DescribeParameters, request).descriptors
    plain = [parameter_value_to_python(value) for value in values]
    return dict(zip(names, zip(plain, told, strict=True), strict=True))


def parameter_value(text: str, about: Any) -> Any:
    """Return a typed value for a parameter; numbers may have the unit that its description ends with."""
    from rcl_interfaces.msg import ParameterType, ParameterValue
    from rclpy.parameter import get_parameter_value

    unit = _UNIT.search(about.description)
    parts = (
        [quantity(part, unit[1] if unit else "1") for part in text.strip("[]").split(",")]
        if about.type in (ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_DOUBLE_ARRAY)
        else []
    )
    if about.type == ParameterType.PARAMETER_DOUBLE_ARRAY:
        return ParameterValue(type=about.type, double_array_value=parts)
    if about.type == ParameterType.PARAMETER_DOUBLE and len(parts) == 1:
        return ParameterValue(type=about.type, double_value=parts[0])
    return get_parameter_value(text)
