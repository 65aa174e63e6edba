"""ROS parameters from dataclasses: type, unit, range and meaning of each come from its field's metadata."""

from __future__ import annotations

import array
import dataclasses
import math
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from quadftc_model.hints import nearest
from quadftc_model.parameters import Parameter, convert, parameter, parameters_of
from quadftc_model.registry import Registry

T = TypeVar("T")
STAYS = "in lock-step it stays, so that two flights are alike"
Refusal = Callable[[], str]  # gives the reason why a law must not be changed now; empty: it may

_LARGEST = sys.float_info.max
_LARGEST_INT = 2**63 - 1

_EXPECTED: dict[type, tuple[RosParameter.Type, str]] = {  # type of the default -> type in ROS, and in words
    bool: (RosParameter.Type.BOOL, "true or false"),
    int: (RosParameter.Type.INTEGER, "a whole number"),
    float: (RosParameter.Type.DOUBLE, "a number with a decimal point, as 3.0 (to ROS, 3 is another type)"),
    str: (RosParameter.Type.STRING, "a text"),
    tuple: (RosParameter.Type.DOUBLE_ARRAY, "three numbers with decimal points, as [1.0, 2.0, 3.0]"),
}


def descriptor(spec: Parameter, read_only: bool = False) -> ParameterDescriptor:
    """Describe a parameter to ROS: meaning with unit, range, choices."""
    unit = "" if spec.unit == "1" else f" [{spec.unit}]"
    text = ParameterDescriptor(description=spec.doc + unit, read_only=read_only)
    bounded = math.isfinite(spec.low) or math.isfinite(spec.high)
    if spec.choices:
        text.additional_constraints = "one of " + ", ".join(spec.choices)
    elif spec.is_vector and bounded:
        text.additional_constraints = f"each within [{spec.low:g}, {spec.high:g}]"
    elif bounded and type(spec.default) is float:
        low, high = max(spec.low, -_LARGEST), min(spec.high, _LARGEST)
        text.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    elif bounded and type(spec.default) is int:
        low, high = max(spec.low, -_LARGEST_INT), min(spec.high, _LARGEST_INT)
        text.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return text


@dataclasses.dataclass(frozen=True)
class VehicleParameters:
    """The parameter of every node whose law is of a vehicle."""

    vehicle: str = parameter("qball_x4", doc="name of a vehicle, or path of its TOML file")


class NodeParameters:
    """The parameters of a node, as one flat mapping of dotted names."""

    # of the node that was made last, for its help: name, default and meaning of each parameter
    told: ClassVar[list[tuple[str, object, str]]] = []

    def __init__(self, node: Node) -> None:
        NodeParameters.told.clear()
        self._node = node
        self._names: list[str] = []
        self._laws: list[tuple[str, Registry[Any], Refusal]] = []
        # what file and command line say; rclpy has no public way to ask
        self._given: Mapping[str, RosParameter] = node._parameter_overrides

    def declare(
        self,
        component: type,
        prefix: str = "",
        read_only: bool = False,
        defaults: Mapping[str, object] = MappingProxyType({}),
    ) -> None:
        """Declare every parameter of a dataclass, its name behind ``prefix``.

        ``defaults``, by the names in the dataclass, take the place of its own.
        Raises ValueError that names a parameter given at the start of the wrong type or out of bounds.
        """
        for own in parameters_of(component):
            spec = dataclasses.replace(own, name=prefix + own.name)
            default = defaults.get(own.name, spec.default)
            default = list(default) if isinstance(default, tuple) else default
            if (given := self._given.get(spec.name)) is not None:  # checked as ROS would, but in one line
                value = _plain(given.value)
                wanted, words = _EXPECTED[type(spec.default)]
                if given.type_ != wanted:
                    raise ValueError(f"{spec.name} = {value!r}: expected {words}")
                convert(spec, value)
            described = descriptor(spec, read_only)
            self._node.declare_parameter(spec.name, default, described)
            self._names.append(spec.name)
            bounds = described.additional_constraints or _bounds(spec)
            words = described.description + (f" ({bounds})" if bounds else "")
            self.told.append((spec.name, default, words))

    def declare_law(self, component: type, registry: Registry[Any], refusal: Refusal) -> None:
        """Declare a dataclass with one parameter, which names a law, and that law's own behind its name.

        In flight another law may be named unless ``refusal()`` says why not; its own parameters come with it.
        """
        self.declare(component)
        selector = self._names[-1]
        self._laws.append((selector, registry, refusal))
        self._declare_law(registry, self.values()[selector])

    def _declare_law(self, registry: Registry[Any], name: str) -> None:
        law, prefix = registry.get(name), f"{name}."
        if not any(each.startswith(prefix) for each in self._names):
            self.declare(law, prefix)

    def declare_list(self, name: str, doc: str) -> None:
        """Declare a list of texts that is read once, at the start; ValueError if something else is given."""
        given = self._given.get(name)
        if given is not None and given.type_ != RosParameter.Type.STRING_ARRAY:
            raise ValueError(f"{name} = {given.value!r}: expected a list of texts (none: [''])")
        self._node.declare_parameter(name, [""], ParameterDescriptor(description=doc, read_only=True))
        self._names.append(name)
        self.told.append((name, [], doc))

    def values(self) -> dict[str, Any]:
        """Return name -> value; lists of texts without their empty entries."""
        return {name: _plain(self._node.get_parameter(name).value) for name in self._names}

    def unknown(self) -> list[str]:
        """Say which names were given at the start (file, command line) that are no parameter of the node."""
        return [
            f"parameter '{name}' was given, but this node has none of that name{nearest(name, self._names)}"
            for name in self._given
            if not self._node.has_parameter(name) and not name.startswith("qos_overrides.")
        ]

    def on_change(self, build: Callable[[dict[str, Any]], T], use: Callable[[T], None]) -> None:
        """Follow changes at run time: ``use(build(values))``, of the whole mapping.

        If ``build`` raises ValueError, the change is refused with that message; the old values stay.
        """
        built: list[T] = []

        def check(changes: list[RosParameter]) -> SetParametersResult:
            values = self.values()
            named = {p.name: _plain(p.value) for p in changes if p.name in values}
            if not named:  # others, or those of a law that are being declared
                return SetParametersResult(successful=True)
            try:
                for selector, registry, refusal in self._laws:
                    if named.get(selector, values[selector]) != values[selector]:
                        if reason := refusal():
                            return SetParametersResult(successful=False, reason=f"{selector}: {reason}")
                        self._declare_law(registry, named[selector])
                built[:] = [build({**self.values(), **named})]
            except ValueError as error:
                return SetParametersResult(successful=False, reason=str(error))
            return SetParametersResult(successful=True)

        def put_to_use(changes: list[RosParameter]) -> None:
            if any(p.name in self._names for p in changes) and built:
                use(built.pop())

        self._node.add_on_set_parameters_callback(check)
        self._node.add_post_set_parameters_callback(put_to_use)


def _bounds(spec: Parameter) -> str:
    """Return the bounds of a number in words; empty: there are none."""
    low = f"{spec.low:g} or more" if math.isfinite(spec.low) else ""
    high = f"{spec.high:g} or less" if math.isfinite(spec.high) else ""
    return f"{spec.low:g} to {spec.high:g}" if low and high else low or high


def _plain(value: Any) -> Any:
    """Return a value of rclpy; of any kind of array, a list without empty texts."""
    is_array = isinstance(value, (list, tuple, array.array))
    return [part for part in value if part != ""] if is_array else value
