"""What a value of a scenario may be drawn from.

    uniform: [0.5 deg, 5 deg]        sign: random        size: 3
    log_uniform: [0.05 deg/s, 0.5 deg/s]
    normal: [0, 0.1]                 mean and standard deviation
    choice: [bias, drift]            each as likely as another
    grid: [100 Hz, 250 Hz]           all, in turn; several grids are crossed

A value has the unit that the bounds have. ``size`` draws a list of so many, ``sign: random`` turns every
other value round. A choice may be a component whose parameters are drawn in their turn:

    choice: [{kind: bias, value: {uniform: [1 deg, 3 deg]}}, {kind: drift, rate: {uniform: [...]}}]
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

import numpy as np

from quadftc_model.hints import nearest
from quadftc_model.spec import format_spec

T = TypeVar("T")
Value = object  # what may stand in a scenario: a number, a text, a list, a component

GRID = "grid"  # the flights go through its values in turn
DISCRETE = ("choice", GRID)
KINDS = ("uniform", "log_uniform", "normal", *DISCRETE)
KEYS = (*KINDS, "size", "sign")
_NUMBER = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$")
_MAX_SIZE = 16


@dataclasses.dataclass(frozen=True)
class Distribution:
    """How a value is drawn."""

    kind: str
    bounds: tuple[float, float] = (0.0, 0.0)  # low and high, or mean and standard deviation
    values: tuple[Value, ...] = ()  # of ``choice`` and ``grid``, which have no bounds
    unit: str = ""  # as written
    size: int = 0  # of a list; 0: a single value
    signed: bool = False  # whether every other value is turned round

    def draw(self, generator: np.random.Generator) -> Value:
        """Draw a value as it stands in a scenario."""
        if self.values:
            numbers = (int(generator.integers(len(self.values))) for _ in range(self.size or 1))
            chosen = (self.values[number] for number in numbers)
            drawn = [_inside(one, Distribution, lambda each: each.draw(generator)) for one in chosen]
        else:
            drawn = [f"{x!r} {self.unit}" if self.unit else x for x in self._draw_numbers(generator)]
        return drawn if self.size else drawn[0]

    def _draw_numbers(self, generator: np.random.Generator) -> list[float]:
        (low, high), count = self.bounds, self.size or 1
        if self.kind == "log_uniform":
            numbers = np.exp(generator.uniform(math.log(low), math.log(high), count))
        else:
            numbers = (generator.normal if self.kind == "normal" else generator.uniform)(low, high, count)
        if self.signed:
            numbers = numbers * np.where(generator.random(count) < 0.5, -1.0, 1.0)
        return numbers.tolist()


def distribution(raw: object) -> Distribution:
    """Read a distribution from a campaign file; a ValueError says what was expected instead."""
    if not isinstance(raw, Mapping):
        raise ValueError(f"{raw!r}: expected a distribution, such as {{uniform: [0.5 deg, 5 deg]}}")
    given = cast("Mapping[str, Any]", raw)
    for key in given:
        if key not in KEYS:
            raise ValueError(f"unknown key '{key}'{nearest(str(key), KEYS)}")
    kinds = [key for key in given if key in KINDS]
    if len(kinds) != 1:
        raise ValueError(f"expected one of {', '.join(KINDS)}")
    kind, size, sign = kinds[0], given.get("size", 0), given.get("sign")
    if "size" in given and (kind == GRID or type(size) is not int or not 1 <= size <= _MAX_SIZE):
        raise ValueError(f"size: {size!r}: expected a whole number of 1 to {_MAX_SIZE}; a grid has none")
    if kind in DISCRETE:
        if "sign" in given:
            raise ValueError(f"sign: a {kind} has none; list the values with their signs")
        return Distribution(kind, values=_read_values(kind, given[kind]), size=size)
    bounds, unit = _read_bounds(kind, given[kind])
    if sign not in (None, "random"):
        raise ValueError(f"sign: {sign!r}: expected random")
    return Distribution(kind, bounds, (), unit, size, sign is not None)


def plain(value: Value) -> Value:
    """Return a value as it is reported: a number without its unit, or a text."""
    if isinstance(value, str):
        match = _NUMBER.match(value)
        return float(match[1]) if match else value
    if isinstance(value, (bool, int, float)):
        return value
    if isinstance(value, Mapping):
        component = dict(cast("Mapping[str, Value]", value))
        return format_spec(str(component.pop("kind", "")), component)
    return str(value)


def unit_of(value: Value) -> str:
    """Return the unit with which a value is written."""
    match = _NUMBER.match(value) if isinstance(value, str) else None
    return match[2] if match else ""


def _read_values(kind: str, raw: object) -> tuple[Value, ...]:
    """Read the values of a choice or grid; in a component of a choice, mappings are distributions."""
    if not isinstance(raw, list) or not raw:
        raise ValueError(f"{kind}: {raw!r}: expected a list of values, at least one")
    values = cast("list[Value]", raw)
    return tuple(values if kind == GRID else (_inside(each, Mapping, distribution) for each in values))


def _inside(value: Value, kind: type[T], change: Callable[[T], Value]) -> Value:
    """Return a component with what is of a kind in it changed; any other value as it is."""
    if not isinstance(value, Mapping):
        return value
    items = cast("Mapping[str, Value]", value).items()
    return {key: change(each) if isinstance(each, kind) else each for key, each in items}


def _read_bounds(kind: str, raw: object) -> tuple[tuple[float, float], str]:
    names = ("mean", "standard deviation") if kind == "normal" else ("low", "high")
    if not isinstance(raw, list) or len(cast("list[Value]", raw)) != 2:
        raise ValueError(f"{kind}: {raw!r}: expected [{', '.join(names)}]")
    pairs: list[tuple[float, str]] = []
    for name, each in zip(names, cast("list[Value]", raw), strict=True):
        match = _NUMBER.match(str(each)) if isinstance(each, (int, float, str)) else None
        if match is None or isinstance(each, bool):
            raise ValueError(f"{kind}: {name} {each!r}: expected a number, with its unit if it has one")
        pairs.append((float(match[1]), match[2]))
    (low, low_unit), (high, high_unit) = pairs
    units = {unit for number, unit in pairs if unit or number != 0.0}
    both = f"{names[0]} {low:g}, {names[1]} {high:g}"
    refusals = {
        f"{names[0]} in '{low_unit}', {names[1]} in '{high_unit}': expected one unit": len(units) > 1,
        f"standard deviation {high:g}: must be positive": kind == "normal" and not high > 0.0,
        f"{both}: an empty range": kind != "normal" and not low < high,
        f"{both}: too large to draw from": not math.isfinite(high - low),
        f"low {low:g}: must be positive": kind == "log_uniform" and not low > 0.0,
    }
    for refusal, applies in refusals.items():
        if applies:
            raise ValueError(f"{kind}: {refusal}")
    return (low, high), low_unit or high_unit
