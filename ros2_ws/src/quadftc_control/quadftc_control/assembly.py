"""The controller and the reference from the parameters of their nodes.

Parameters of the node ``controller``: vehicle, controller (its name), and ``<controller>.<parameter>`` for
each parameter of that controller. Of the node ``reference``: references (list of specifications). Other
parameters are ignored.
"""

from __future__ import annotations

from quadftc_control.controller import Controller, controllers
from quadftc_control.reference import Reference, ReferenceGenerator, references
from quadftc_model.assembly import NodeParameters, component_from, texts, vehicle_from
from quadftc_model.parameters import build
from quadftc_model.spec import parse_spec


def controller_from(parameters: NodeParameters) -> Controller:
    """Build the controller; run it with :class:`quadftc_model.stepper.Stepper`.

    Raises
    ------
    ValueError
        Naming the parameter that is wrong.
    """
    return component_from(controllers, parameters, "controller", vehicle=vehicle_from(parameters))


def reference_from(parameters: NodeParameters) -> ReferenceGenerator:
    """Build the reference: the sum of its parts; level without any.

    Raises
    ------
    ValueError
        Naming the part that is wrong.
    """
    return ReferenceGenerator([_reference(text) for text in texts(parameters, "references")])


def _reference(text: str) -> Reference:
    try:
        spec = parse_spec(text)
        return build(references.get(spec.kind), spec.values)
    except ValueError as error:
        raise ValueError(f"reference {text!r}: {error}") from None
