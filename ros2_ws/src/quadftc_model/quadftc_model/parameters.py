"""Parameters of components: one frozen dataclass each; metadata gives a field's unit, range and meaning.

The same metadata checks scenario files, declares ROS parameters and prints ``quadftc list``.
A wrong value is a ValueError that names the parameter, the value and what was expected.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from quadftc_model.hints import nearest
from quadftc_model.units import quantity

T = TypeVar("T")

Axes = tuple[float, ...]  # one number for each axis
Value = float | int | bool | str | Axes


@dataclasses.dataclass(frozen=True)
class Parameter:
    """What is known of one parameter: its name, default, SI unit, bounds (inclusive), choices and meaning."""

    name: str
    default: Value
    unit: str
    low: float
    high: float
    choices: tuple[str, ...]
    doc: str
    rows_of: int = 0  # the value is a list of rows of so many numbers; 0: it is as long as the default

    @property
    def is_vector(self) -> bool:
        """Whether the value is a tuple of numbers."""
        return isinstance(self.default, tuple)


def parameter(
    default: Value,
    *,
    unit: str = "1",
    doc: str,
    low: float = -math.inf,
    high: float = math.inf,
    choices: Sequence[str] = (),
    rows_of: int = 0,
) -> Any:
    """Declare a parameter as a dataclass field, of the type of its default.

    The SI ``unit`` is in braces (``"{channel}"``) when it depends on the context, see :func:`build`. ``doc``
    has the paper's symbol where there is one. ``low`` and ``high`` bound each number, inclusive; it must be
    finite, unless the default is infinite. ``choices`` are the values that a text may take; empty: any.
    ``rows_of`` 3 makes a list of points, of any length: [[0, 0, 1], [2, 0, 1]], or its numbers in line.
    """
    details = {
        "unit": unit,
        "doc": doc,
        "low": low,
        "high": high,
        "choices": tuple(choices),
        "rows_of": rows_of,
    }
    return dataclasses.field(default=default, metadata={"quadftc": details})  # type: ignore[arg-type]


@functools.cache
def parameters_of(component: type) -> tuple[Parameter, ...]:
    """Return the parameters of a dataclass, in the order of its fields; other fields are left out."""
    return tuple(
        Parameter(name=field.name, default=field.default, **field.metadata["quadftc"])  # type: ignore[arg-type]
        for field in dataclasses.fields(component)
        if "quadftc" in field.metadata
    )


class Checked:
    """Base of dataclasses that check their parameters against their bounds when they are made."""

    def __post_init__(self) -> None:
        for spec in parameters_of(self.__class__):
            _check_bounds(spec, getattr(self, spec.name))


class Timed(Checked):
    """Base of those that act from ``start`` to ``stop`` [s]."""

    start: float
    stop: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stop <= self.start:
            raise ValueError(f"stop = {self.stop:g} s: must be later than start = {self.start:g} s")


def build(
    component: type[T],
    values: Mapping[str, object],
    *,
    units: Mapping[str, str] | None = None,
    **context: Any,
) -> T:
    """Make a component from raw values: texts with units become SI numbers, one number fills a vector.

    ``units`` says what stands for a unit in braces: ``{"channel": "rad"}``. ``context`` are the fields that
    are no parameters (the vehicle, say).
    """
    specs = {spec.name: spec for spec in parameters_of(component)}
    converted: dict[str, Value] = {}
    for name, raw in values.items():
        if name not in specs:
            known = ", ".join(specs) or "none"
            raise ValueError(f"{name}: unknown parameter{nearest(str(name), specs)}; known: {known}")
        converted[name] = convert(specs[name], raw, units)
    return component(**context, **converted)


def convert(spec: Parameter, raw: object, units: Mapping[str, str] | None = None) -> Value:
    """Convert one raw value to the parameter's type and SI unit, and check it."""
    unit = spec.unit.format_map(units or {}) if "{" in spec.unit and units else spec.unit
    if unit != spec.unit:
        spec = dataclasses.replace(spec, unit=unit)
    try:
        value = _convert(spec, raw)
    except ValueError as error:
        raise ValueError(f"{spec.name}: {error}") from None
    _check_bounds(spec, value)
    return value


def _convert(spec: Parameter, raw: object) -> Value:
    default = spec.default
    if isinstance(default, bool):
        text = str(raw).lower() if isinstance(raw, (bool, str)) else ""
        if text not in ("true", "false"):
            raise ValueError(f"{raw!r}: expected true or false")
        return text == "true"
    if isinstance(default, str):
        if not isinstance(raw, str):
            raise ValueError(f"{raw!r}: expected a text")
        return raw
    if isinstance(default, tuple):
        return _vector(spec, raw)
    if isinstance(raw, (list, tuple)):
        raise ValueError(f"{raw!r}: expected one number in {spec.unit}")
    number = quantity(raw, spec.unit)
    if not isinstance(default, int):
        return number
    if not number.is_integer():
        raise ValueError(f"{raw!r}: expected a whole number")
    return int(number)


def _vector(spec: Parameter, raw: object) -> Axes:
    parts: list[object] = [*raw] if isinstance(raw, (list, tuple)) else [raw]
    if spec.rows_of:
        parts = [each for part in parts for each in (part if isinstance(part, (list, tuple)) else (part,))]  # pyright: ignore
        if len(parts) % spec.rows_of:
            raise ValueError(f"{raw!r}: expected rows of {spec.rows_of} numbers, in {spec.unit}")
        return tuple(quantity(part, spec.unit) for part in parts)
    count = len(spec.default)  # pyright: ignore
    parts = parts if isinstance(raw, (list, tuple)) else parts * count
    if len(parts) != count:
        raise ValueError(f"{raw!r}: expected one number or {count}, in {spec.unit}")
    return tuple(quantity(part, spec.unit) for part in parts)


def _check_bounds(spec: Parameter, value: Any) -> None:
    if isinstance(value, str):
        if spec.choices and value not in spec.choices:
            raise ValueError(f"{spec.name} = {value!r}: expected one of {', '.join(spec.choices)}")
        return
    numbers: Axes = value if spec.is_vector else (value,)  # a bool is within infinite bounds
    unit = "" if spec.unit == "1" else f" {spec.unit}"
    for number in numbers:
        if not spec.low <= number <= spec.high:  # NaN fails this, too
            raise ValueError(f"{spec.name} = {number!r}{unit}: must be within [{spec.low:g}, {spec.high:g}]")
        if math.isinf(number) and number != spec.default:
            raise ValueError(f"{spec.name} = {number!r}{unit}: must be finite")
