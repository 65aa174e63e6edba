"""Building every component that a scenario names, and collecting all that is wrong with them.

The builder takes the plain data of a file whose shape may be wrong: what it cannot make sense of at all it
leaves to the check of the shape.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

from quadftc_flight.scenario.types import Fault, Part
from quadftc_flight.scenario.yaml_document import Keys, Problem
from quadftc_model.hints import nearest
from quadftc_model.parameters import Parameter, build, convert, parameters_of
from quadftc_model.registry import Registry
from quadftc_model.vehicle import Vehicle, load_vehicle
from quadftc_sim.fault import faults
from quadftc_sim.injection import CHANNEL_UNITS, make_injection
from quadftc_sim.plant import Plant
from quadftc_sim.sensors import GRADES, ImuSensor

T = TypeVar("T")

_SCHEDULE = ("channel", "axes", "axis", "start", "stop", "duration")  # keys of a fault that are not its law's
_LEADING_NAME = re.compile(r"(\w+)(?:: | = )(.*)", re.DOTALL)  # how parameter errors begin
# what a component may raise on input that it did not foresee, those from outside this repository included
_REFUSALS = (ValueError, TypeError, ArithmeticError)


class PartBuilder:
    """Builds the components of one scenario.

    Parameters
    ----------
    duration : float, optional
        Of the flight [s]; what starts or stops later is wrong. None: not known.
    """

    def __init__(self, duration: float | None) -> None:
        self.problems: list[Problem] = []
        self._duration = duration

    def vehicle(self, name: Any, directory: Path) -> tuple[str, Vehicle] | None:
        """Load the vehicle, a path being relative to the scenario's directory; return its full name, too."""
        if not isinstance(name, str):
            return None
        full = str(directory.resolve() / name) if name.endswith(".toml") else name
        try:
            return full, load_vehicle(full)
        except _REFUSALS as error:
            self._add(("vehicle",), str(error))
        except OSError as error:
            self._add(("vehicle",), f"{_shown(name)}: {error.strerror}")
        return None

    def plant(self, raw: Any, vehicle: Vehicle | None) -> Plant | None:
        """Build the plant, without its disturbances."""
        given = self._converted(Plant, _mapping(raw), ("plant",))
        return self._built(Plant, given, ("plant",), vehicle=vehicle)

    def sensor(self, raw: Any) -> ImuSensor | None:
        """Build the IMU: a grade, with single parameters changed."""
        values = dict(_mapping(raw))
        grade = values.pop("grade", "ideal")
        if not isinstance(grade, str) or grade not in GRADES:
            self._add(("sensors", "grade"), f"{grade!r}: expected one of {', '.join(GRADES)}")
            grade = "ideal"
        given = self._converted(ImuSensor, values, ("sensors",), also=("grade",))
        return self._built(ImuSensor, {**GRADES[grade], **given}, ("sensors",))

    def parts(self, registry: Registry[Any], raw: Any, path: Keys) -> tuple[Part, ...]:
        """Build a list of references or disturbances."""
        built = [
            self.part(registry, item, (*path, index))
            for index, item in enumerate(_list(raw))
            if isinstance(item, dict)
        ]
        return tuple(part for part in built if part is not None)

    def part(self, registry: Registry[Any], raw: Any, path: Keys, **context: Any) -> Part | None:
        """Build one component, given by a mapping or by its name alone."""
        values = {"kind": raw} if isinstance(raw, str) else dict(_mapping(raw))
        kind = values.pop("kind", None)
        component = self._registered(registry, kind, path)
        if component is None or not isinstance(kind, str):
            return None
        given = self._converted(component, values, path, also=("kind",))
        law = self._built(component, given, path, **context)
        if law is None:
            return None
        self._within_flight(given, path)
        return Part(kind, law, tuple(given))

    def faults(self, raw: Any) -> tuple[Fault, ...]:
        """Build the scheduled faults."""
        built = [
            self._fault(cast("dict[str, Any]", item), ("faults", index))
            for index, item in enumerate(_list(raw))
            if isinstance(item, dict)
        ]
        return tuple(fault for fault in built if fault is not None)

    def _fault(self, raw: Mapping[str, Any], path: Keys) -> Fault | None:
        values = {name: value for name, value in raw.items() if name != "kind"}
        kind = raw.get("kind")
        law = self._registered(faults, kind, path)
        if law is None or not isinstance(kind, str):
            return None
        own = {name: value for name, value in values.items() if name not in _SCHEDULE}
        schedule = {name: value for name, value in values.items() if name in _SCHEDULE}
        channel = schedule.get("channel", law.channels[0])
        if channel in law.channels:  # else there is no telling the units
            own = self._converted(law, own, path, CHANNEL_UNITS[channel], also=("kind", *_SCHEDULE))
        if not self._schedule_is_plain(schedule, path):
            return None
        try:
            injection = make_injection(kind, {**schedule, **own})
        except _REFUSALS as error:
            self._refused(error, path, values)
            return None
        times = {"start": injection.start, "stop" if "stop" in schedule else "duration": injection.stop}
        self._within_flight(times, path)
        return Fault(injection, tuple(own))

    def _schedule_is_plain(self, schedule: Mapping[str, Any], path: Keys) -> bool:
        before = len(self.problems)
        for name, value in schedule.items():
            if name in ("axes", "axis"):
                good = isinstance(value, str) or (
                    isinstance(value, list)
                    and all(isinstance(item, str) for item in cast("list[Any]", value))
                )
                wanted = "an axis or a list of axes: roll, pitch, yaw or x, y, z"
            elif name == "channel":
                good, wanted = isinstance(value, str), f"one of {', '.join(CHANNEL_UNITS)}"
            else:
                good = isinstance(value, (int, float, str)) and not isinstance(value, bool)
                wanted = "a time, such as '20 s'"
            if not good:
                self._add((*path, name), f"{_shown(value)}: expected {wanted}")
        return len(self.problems) == before

    def _registered(self, registry: Registry[Any], kind: Any, path: Keys) -> Any:
        if not isinstance(kind, str):
            return None
        try:
            return registry.get(kind)
        except _REFUSALS as error:
            self._add((*path, "kind"), str(error))
            return None

    def _converted(
        self,
        component: type,
        raw: Mapping[str, Any],
        path: Keys,
        units: Mapping[str, str] | None = None,
        also: Sequence[str] = (),
    ) -> dict[str, Any]:
        """Convert each parameter by itself, so that all that are wrong are found; return the good ones."""
        specs = {spec.name: spec for spec in parameters_of(component)}
        values: dict[str, Any] = {}
        for name, value in raw.items():
            place = (*path, name)
            if name not in specs:
                known = [*also, *specs]
                self._add(place, f"unknown key{nearest(name, known)}; known: {', '.join(known)}")
            elif not _is_plain(value):
                self._add(
                    place, f"{_shown(value)}: expected a number, a text, true or false, or a list of numbers"
                )
            else:
                try:
                    values[name] = _finite(specs[name], convert(specs[name], value, units))
                except _REFUSALS as error:
                    self._refused(error, path, {name: value})
        return values

    def _built(
        self, component: Callable[..., T], values: Mapping[str, Any], path: Keys, **context: Any
    ) -> T | None:
        if None in context.values():  # no vehicle: that is a problem of its own
            return None
        try:
            return cast("T", build(cast("type[Any]", component), values, **context))
        except _REFUSALS as error:
            self._refused(error, path, values)
            return None

    def _within_flight(self, values: Mapping[str, Any], path: Keys) -> None:
        """Refuse times that the flight does not reach."""
        end = math.inf if self._duration is None else self._duration
        start = float(values.get("start", 0.0))
        if start >= end:
            self._add((*path, "start"), f"{start:g} s: must be before the end of the flight, {end:g} s")
            return
        for name in ("stop", "duration"):
            stop = float(values.get(name, math.inf))
            if math.isfinite(stop) and stop > end:
                self._add((*path, name), f"stops at {stop:g} s, beyond the end of the flight, {end:g} s")
            elif stop <= start:
                self._add((*path, name), f"{stop:g} s: must be later than start = {start:g} s")

    def _refused(self, error: Exception, path: Keys, values: Mapping[str, Any]) -> None:
        """Add what a component says; where it begins with a parameter's name, at that key."""
        match = _LEADING_NAME.match(str(error))
        if match and (match[1] in values or match[1] in _SCHEDULE):
            self._add((*path, match[1]), match[2])
        else:
            self._add(path, str(error))

    def _add(self, path: Keys, text: str) -> None:
        self.problems.append(Problem(path, text))


def _is_plain(value: Any) -> bool:
    parts = cast("list[Any]", value) if isinstance(value, list) else [value]
    return all(isinstance(part, (bool, int, float, str)) for part in parts)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _finite(spec: Parameter, value: Any) -> Any:
    """Refuse infinity where the default is finite."""
    if _is_infinite(value) and not _is_infinite(spec.default):
        raise ValueError(f"{spec.name}: {value}: must be finite")
    return value


def _is_infinite(value: Any) -> bool:
    numbers = cast("tuple[Any, ...]", value) if isinstance(value, tuple) else (value,)
    return any(isinstance(number, float) and math.isinf(number) for number in numbers)


def _mapping(raw: Any) -> Mapping[str, Any]:
    return cast("Mapping[str, Any]", raw) if isinstance(raw, dict) else {}


def _list(raw: Any) -> list[Any]:
    return cast("list[Any]", raw) if isinstance(raw, list) else []
