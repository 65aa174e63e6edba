# pyright: basic
"""``quadftc inject`` and ``quadftc clear``: faults of sensors and rotors in a graph that runs."""

from __future__ import annotations

import math
from typing import Annotated, Any

from typer import Argument, Option

from quadftc_cli.screen import say
from quadftc_flight.graph.plan import GraphError
from quadftc_model.parameters import parameters_of
from quadftc_model.spec import parse_spec
from quadftc_sim.injection import CHANNEL_UNITS, RESERVED, ask_for_size, ask_for_units, make_injection

MOST_ROTORS = 64  # as the parameter `rotors` of the fault injector allows
NamespaceOption = Annotated[str, Option(help="Namespace of the vehicle; default: the only one there is.")]


def inject(
    fault: Annotated[
        list[str],
        Argument(metavar="KIND [KEY=VALUE]...", help="Such as: bias axis=roll value=3deg duration=10s"),
    ],
    namespace: NamespaceOption = "",
) -> None:
    """Put a fault on a vehicle that flies: now, or after a start; until cleared, or for a duration.

    'quadftc list faults' shows the kinds of sensors with their parameters, 'quadftc list rotor_faults'
    those of rotors. Times count from now. Prints the number that 'quadftc clear' takes.
    """
    fields = request_fields(" ".join(fault))
    from quadftc_cli.live import LiveGraph  # starts ROS
    from quadftc_msgs.srv import InjectFault

    with LiveGraph(namespace) as graph:
        answer = graph.call("fault_injector/inject", InjectFault, InjectFault.Request(**fields))
    if not answer.success:
        raise ValueError(answer.message)
    until = f"for {fields['duration']:g} s" if fields["duration"] else f"until: quadftc clear {answer.id}"
    say(f"fault {answer.id}: {answer.message}, {until}")


def clear(
    number: Annotated[int, Argument(min=0, help="Number of the fault, as inject says; 0: all.")] = 0,
    namespace: NamespaceOption = "",
) -> None:
    """End injected faults, those of the scenario included."""
    from quadftc_cli.live import LiveGraph
    from quadftc_msgs.srv import ClearFault

    with LiveGraph(namespace) as graph:
        answer = graph.call("fault_injector/clear", ClearFault, ClearFault.Request(id=number))
    if not answer.success:
        raise GraphError(answer.message)
    say(answer.message)


def request_fields(text: str) -> dict[str, Any]:
    """Return the fields of a request for a fault; a ValueError says what is wrong with its specification."""
    kind, values = parse_spec(text)
    ask_for_units(kind, values)
    ask_for_size(kind, values)
    injection = make_injection(kind, values, rotors=MOST_ROTORS)  # the node knows how many there are
    law, names = injection.law, [name for name in values if name not in RESERVED]
    units = CHANNEL_UNITS[injection.channel]
    numbers: list[float] = []
    for name in names:
        value = getattr(law, name)
        parts = value if isinstance(value, tuple) else (value,)
        acting = [part for part, acts in zip(parts, injection.mask, strict=False) if acts] or [parts[0]]
        if len(set(acting)) > 1:
            raise ValueError(f"{name}: one number for all axes; inject a fault for each axis")
        if not isinstance(acting[0], (int, float)):
            unit = next(spec.unit for spec in parameters_of(type(law)) if spec.name == name)
            raise ValueError(f"{name}: cannot be sent, expected a number in {unit.format_map(units)}")
        numbers.append(float(acting[0]))
    axes = values.get("rotors", values.get("axes", values.get("axis", [])))
    endless = math.isinf(injection.stop)
    return {
        "kind": kind,
        "channel": injection.channel,
        "axes": [axes] if isinstance(axes, str) else list(axes),
        "start": injection.start,
        "duration": 0.0 if endless else injection.stop - injection.start,
        "parameter_names": names,
        "parameter_values": numbers,
    }
