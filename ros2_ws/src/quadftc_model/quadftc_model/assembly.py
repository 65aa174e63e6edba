"""From the parameters of a node to the components it runs, and back.

A node has a flat set of named parameters. One names a component, whose own carry that name as a prefix:

    observer: exosystem
    exosystem.model: constant
    exosystem.bandwidth: 10.0

quadftc_sim, quadftc_fdi and quadftc_control build their parts from such sets, in the ROS nodes and in the
closed loop alike. What is missing, unknown or wrong is a ValueError that gives the parameter's full name.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar

from quadftc_model.parameters import Checked, build, parameters_of
from quadftc_model.registry import Registry
from quadftc_model.spec import parse_spec
from quadftc_model.stepper import In, Out
from quadftc_model.vehicle import Vehicle, load_vehicle

NodeValue = bool | int | float | str | Sequence[float] | Sequence[str]
NodeParameters = Mapping[str, Any]  # name -> NodeValue; arrays may be of any kind, as rclpy gives them

T = TypeVar("T")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class VehicleLaw(Checked, abc.ABC, Generic[In, Out]):
    """Base of the laws of a vehicle: explicit state, no clock, parameters in its fields."""

    vehicle: Vehicle

    @abc.abstractmethod
    def init(self, inputs: In) -> object:
        """Return the state at the first sample."""

    @abc.abstractmethod
    def step(self, state: Any, inputs: In, dt: float) -> tuple[object, Out]:
        """Advance by ``dt`` [s] to a sample; 0 at the first one."""


def get(parameters: NodeParameters, name: str, kind: type[T]) -> T:
    """Return a parameter of type ``kind``; a whole number serves as a float."""
    if name not in parameters:
        raise ValueError(f"{name}: missing parameter")
    value: Any = parameters[name]
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ValueError(f"{name} = {value!r}: expected {kind.__name__}")
    return value


def texts(parameters: NodeParameters, name: str) -> list[str]:
    """Return a parameter that is a list of texts; empty if it is missing; empty texts are left out."""
    value: list[Any] | str = parameters.get(name) or []
    if isinstance(value, str) or not all(isinstance(item, str) for item in value):
        raise ValueError(f"{name} = {value!r}: expected a list of texts")
    return [item for item in value if item.strip()]


def _plain(value: Any) -> NodeValue:
    """An array as a list, anything else as it is."""
    return value if isinstance(value, (str, bool, int, float)) else list(value)


def build_prefixed(component: type[T], parameters: NodeParameters, prefix: str, **context: Any) -> T:
    """Build a component from the parameters named ``prefix.<name>``; what is missing keeps its default."""
    start = f"{prefix}."
    named = {name[len(start) :]: _plain(parameters[name]) for name in parameters if name.startswith(start)}
    try:
        return build(component, named, **context)
    except ValueError as error:
        raise ValueError(f"{prefix}.{error}") from None


def build_named(component: type[T], parameters: NodeParameters, **context: Any) -> T:
    """Build a component from the parameters named as its own; what is missing keeps its default."""
    names = [spec.name for spec in parameters_of(component) if spec.name in parameters]
    return build(component, {name: _plain(parameters[name]) for name in names}, **context)


def component_from(registry: Registry[T], parameters: NodeParameters, selector: str, **context: Any) -> T:
    """Build the component that the parameter ``selector`` names, from those prefixed with its name."""
    name = get(parameters, selector, str)
    return build_prefixed(registry.get(name), parameters, name, **context)


def components_from(registry: Registry[T], parameters: NodeParameters, name: str) -> list[T]:
    """Build the components that a list of specifications describes, such as ``step angles=5deg,0,0``."""

    def make(kind: str, values: Mapping[str, object]) -> T:
        return build(registry.get(kind), values)

    return [component_of(registry.kind, text, make) for text in texts(parameters, name)]


def component_of(kind: str, text: str, make: Callable[[str, Mapping[str, object]], T]) -> T:
    """Make a component from its specification; ``kind`` says in error messages what it is."""
    try:
        return make(*parse_spec(text))
    except ValueError as error:
        raise ValueError(f"{kind} {text!r}: {error}") from None


def law_from(registry: Registry[T], selector: str) -> Callable[[NodeParameters], T]:
    """Return what builds the law of a node, which the parameter ``selector`` names, for its ``vehicle``."""
    return lambda values: component_from(registry, values, selector, vehicle=vehicle_from(values))


def vehicle_from(parameters: NodeParameters) -> Vehicle:
    """Load the vehicle that the parameter ``vehicle`` names."""
    return load_vehicle(get(parameters, "vehicle", str))


def node_values(component: object, prefix: str) -> dict[str, NodeValue]:
    """Return all parameters of a component as ``prefix.<name>``: the inverse of :func:`build_prefixed`.

    With an empty prefix they have their own names: the inverse of :func:`build_named`.
    """
    start = f"{prefix}." if prefix else ""
    names = [spec.name for spec in parameters_of(component.__class__)]
    return {f"{start}{name}": _plain(getattr(component, name)) for name in names}
