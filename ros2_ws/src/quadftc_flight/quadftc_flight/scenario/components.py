"""The components that a scenario names: built from what the file says, each mistake reported at its key."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import ValidationError, ValidationInfo
from pydantic_core import InitErrorDetails, PydanticCustomError

from quadftc_control.position_controller import position_controllers
from quadftc_flight.scenario.document import Document
from quadftc_model.hints import nearest
from quadftc_model.parameters import Axes, build, convert, parameters_of
from quadftc_model.registry import Registry
from quadftc_model.samples import AXES
from quadftc_model.spec import format_spec
from quadftc_model.vehicle import Vehicle, load_vehicle
from quadftc_sim.barometer import BAROMETER_GRADES, Barometer
from quadftc_sim.injection import CHANNEL_UNITS, RESERVED, Injection, make_injection, registry_of
from quadftc_sim.magnetometer import MAGNETOMETER_GRADES, Magnetometer
from quadftc_sim.plant import Plant, plants
from quadftc_sim.position_sensor import POSITION_GRADES, PositionSensor
from quadftc_sim.rotor_fault import ROTOR
from quadftc_sim.sensors import GRADES, ImuSensor

T = TypeVar("T")

_LEADING_NAME = re.compile(r"(\w+)(?:: | = )(.*)", re.DOTALL)  # how parameter errors begin
# what a component may raise on input that it did not foresee, those from outside this repository included
_REFUSALS = (ValueError, TypeError, ArithmeticError)


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """A component: its name, the component itself, and which of its parameters the file gives."""

    kind: str
    law: Any = dataclasses.field(repr=False)
    given: tuple[str, ...]

    @property
    def spec(self) -> str:
        """The specification, in SI, from which the same component can be built."""
        return format_spec(self.kind, _given_values(self.law, self.given))


@dataclasses.dataclass(frozen=True, eq=False)
class Fault:
    """A scheduled fault, and which parameters of its law the file gives."""

    injection: Injection
    given: tuple[str, ...]

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes it is on, named as roll, pitch, yaw on every sensor; none of a fault on rotors."""
        return () if self.injection.channel == ROTOR else self.injection.elements

    @property
    def rotors(self) -> tuple[str, ...]:
        """The rotors it is on, numbered from 1 on; none of a fault on a sensor."""
        return self.injection.elements if self.injection.channel == ROTOR else ()

    @property
    def spec(self) -> str:
        """The specification, in SI, from which the same injection can be made."""
        injection = self.injection
        axes = {"axes": self.axes} if 0 < len(self.axes) < len(AXES) else {}
        axes |= {"rotors": self.rotors} if self.rotors else {}
        stop = {"stop": injection.stop} if math.isfinite(injection.stop) else {}
        schedule = {"channel": injection.channel, **axes, "start": injection.start, **stop}
        return format_spec(injection.kind, {**schedule, **_given_values(injection.law, self.given)})


def _given_values(law: object, given: Sequence[str]) -> dict[str, object]:
    """Values of the parameters given; one number stands for a vector of equal numbers."""
    values: dict[str, object] = {name: getattr(law, name) for name in given}
    return {
        name: value[0] if isinstance(value, tuple) and len({*cast("Axes", value)}) == 1 else value
        for name, value in values.items()
    }


@dataclasses.dataclass
class Setting:
    """What is known of a flight before its components are built: the context of the validation."""

    document: Document | None = None  # the scenario file; a path of a vehicle is relative to its directory
    duration: float = math.inf  # [s]; what starts or stops later is wrong
    vehicle: Vehicle | None = None  # None: it could not be loaded; then nothing is built that depends on it
    flies: bool = False  # in free flight, not on the test stand
    place: PositionSensor | None = None


class _Mistakes:
    """Collects all that is wrong with one component."""

    def __init__(self) -> None:
        self._found: list[InitErrorDetails] = []

    def add(self, text: str, *keys: str) -> None:
        error = PydanticCustomError("component", "{text}", {"text": text})
        self._found.append(InitErrorDetails(type=error, loc=keys, input=None))

    def stop_if_any(self) -> None:
        if self._found:
            raise ValidationError.from_exception_data("component", self._found)

    def attempt(self, make: Callable[[], T], names: Sequence[str] = ()) -> T | None:
        """Call what may refuse; where the refusal begins with a parameter's name, it is noted at that key."""
        try:
            return make()
        except _REFUSALS as error:
            match = _LEADING_NAME.match(str(error))
            if match and match[1] in (*names, *RESERVED):
                self.add(match[2], match[1])
            else:
                self.add(str(error))
            return None

    def build(self, make: Callable[[], T], names: Iterable[str]) -> T:
        """Call ``make`` if all is well so far; its refusal is the last mistake."""
        self.stop_if_any()
        made = self.attempt(make, tuple(names))
        self.stop_if_any()
        return cast("T", made)

    def kind_in(self, registry: Registry[Any], values: dict[str, object]) -> tuple[str, Any]:
        """Take the kind out of the values; return it and the class that has this name."""
        component: Any = None
        kind = values.pop("kind", None)
        try:
            component = None if kind is None else registry.get(str(kind))
        except _REFUSALS as error:
            self.add(str(error), "kind")
        if kind is None:
            self.add("missing key", "kind")
        self.stop_if_any()
        return str(kind), component

    def convert(
        self,
        component: type,
        raw: Mapping[str, object],
        also: Sequence[str] = (),
        units: Mapping[str, str] | None = None,
    ) -> dict[str, object]:
        """Convert each parameter by itself, so that all that are wrong are found; return the good ones."""
        specs = {spec.name: spec for spec in parameters_of(component)}
        known = [*also, *specs]
        values: dict[str, object] = {}
        for name, value in raw.items():
            if name in specs:
                values[name] = self.attempt(lambda: convert(specs[name], value, units), (name,))  # noqa: B023
            else:
                self.add(f"unknown key{nearest(name, known)}; known: {', '.join(known)}", name)
        return values

    def check_times(self, values: Mapping[str, Any], end: float) -> None:
        """Refuse times that the flight does not reach."""
        start = float(values.get("start", 0.0))
        if start >= end:
            self.add(f"{start:g} s: must be before the end of the flight, {end:g} s", "start")
        for name in ("stop", "duration") if start < end else ():
            stop = float(values.get(name, math.inf))
            if end < stop < math.inf:
                self.add(f"stops at {stop:g} s, beyond the end of the flight, {end:g} s", name)
            elif stop <= start:
                self.add(f"{stop:g} s: must be later than start = {start:g} s", name)
        self.stop_if_any()


def load_vehicle_of(name: str, info: ValidationInfo) -> str:
    """Load the vehicle into the context; return its name, or the absolute path of its file.

    A path is relative to the scenario's file; one on the command line, to the present directory.
    """
    setting = cast("Setting", info.context)
    given_here = setting.document is None or setting.document.is_overridden(("vehicle",))
    folder = Path() if given_here or setting.document is None else Path(setting.document.source).parent
    full = str(folder.resolve() / name) if name.endswith(".toml") else name
    try:
        setting.vehicle = load_vehicle(full)
    except OSError as error:
        raise ValueError(f"{shown(name)}: {error.strerror}") from None
    except _REFUSALS as error:
        raise ValueError(str(error)) from None
    return full


def build_plant(raw: object, info: ValidationInfo) -> Plant | None:
    """Build the plant, without its disturbances and winds; None without a vehicle."""
    setting, mistakes = cast("Setting", info.context), _Mistakes()
    vehicle, values = setting.vehicle, {"kind": "test_stand", **_mapping(raw, "a mapping")}
    _, law = mistakes.kind_in(plants, values)
    setting.flies = law.flies
    given = mistakes.convert(law, values, ("kind",))
    return mistakes.build(lambda: vehicle and build(law, given, vehicle=vehicle), given)


def build_sensor(raw: object) -> ImuSensor:
    """Build the IMU: a grade, with single parameters changed."""
    return _build_graded(ImuSensor, GRADES, raw)


def build_position_sensor(raw: object, info: ValidationInfo) -> PositionSensor | None:
    """Build the position sensor of a free flight: a grade, with single parameters changed."""
    setting = cast("Setting", info.context)
    if not setting.flies:
        return in_flight_only(raw)
    setting.place = _build_graded(PositionSensor, POSITION_GRADES, raw or {"grade": "mocap"})
    return setting.place


def flight_sensor_builder(
    kind: type[T], grades: Mapping[str, Mapping[str, object]]
) -> Callable[[object, ValidationInfo], T]:
    """Return what builds a sensor of a free flight: a grade, with single parameters changed, or its defaults.

    The defaults say that there is no such sensor.
    """

    def build_sensor_of_flight(raw: object, info: ValidationInfo) -> T:
        if not cast("Setting", info.context).flies:
            in_flight_only(raw)
        return kind() if raw is None else _build_graded(kind, grades, raw)

    return build_sensor_of_flight


build_magnetometer = flight_sensor_builder(Magnetometer, MAGNETOMETER_GRADES)
build_barometer = flight_sensor_builder(Barometer, BAROMETER_GRADES)


def build_position_controller(raw: object, info: ValidationInfo) -> Part | None:
    """Build the position controller of a free flight; there, `geometric` is the default."""
    if not cast("Setting", info.context).flies:
        return in_flight_only(raw)
    return part_builder(position_controllers, of_vehicle=True)(raw or "geometric", info)


def in_flight_only(raw: object) -> None:
    """Refuse what a test stand has no use for."""
    if raw is not None:
        raise ValueError("only in free flight: expected 'plant: {kind: free_flight}'")


def _build_graded(kind: type[T], grades: Mapping[str, Mapping[str, object]], raw: object) -> T:
    mistakes, values = _Mistakes(), _mapping(raw, "a mapping")
    grade = values.pop("grade", "ideal")
    if not isinstance(grade, str) or grade not in grades:
        mistakes.add(f"{grade!r}: expected one of {', '.join(grades)}", "grade")
    given = mistakes.convert(kind, values, ("grade",))
    mistakes.stop_if_any()
    given = {**grades[str(grade)], **given}
    return mistakes.build(lambda: build(kind, given), given)


def part_builder(
    registry: Registry[Any], *, of_vehicle: bool
) -> Callable[[object, ValidationInfo], Part | None]:
    """Return what builds a component of a registry; one ``of_vehicle`` may be given by its name alone."""

    def build_part(raw: object, info: ValidationInfo) -> Part | None:
        setting, mistakes = cast("Setting", info.context), _Mistakes()
        values = _mapping({"kind": raw} if of_vehicle and isinstance(raw, str) else raw)
        kind, component = mistakes.kind_in(registry, values)
        given = mistakes.convert(component, values, ("kind",))
        mistakes.stop_if_any()
        if of_vehicle and setting.vehicle is None:
            return None
        context: dict[str, Any] = {"vehicle": setting.vehicle} if of_vehicle else {}
        told = _told_of(setting.place, component) if of_vehicle else {}
        law = mistakes.build(lambda: build(component, {**told, **given}, **context), given)
        mistakes.check_times(given, setting.duration)
        return Part(kind, law, tuple(given))

    return build_part


def _told_of(place: PositionSensor | None, component: type) -> dict[str, object]:
    """Values of those parameters of a law by which it knows the position sensor."""
    if place is None:
        return {}
    specs = {spec.name: spec for spec in parameters_of(component)}
    known = {
        "position_delay": place.delay,
        "position_noise": max(place.noise),
        "gives_velocity": place.gives_velocity,
        "velocity_noise": max(place.velocity_noise),
    }
    return {
        name: value if isinstance(value, bool) else max(value, specs[name].low)
        for name, value in known.items()
        if name in specs
    }


def build_fault(raw: object, info: ValidationInfo) -> Fault | None:
    """Build a scheduled fault; None for one on rotors without a vehicle."""
    setting, mistakes, given = cast("Setting", info.context), _Mistakes(), _mapping(raw)
    kind, law = mistakes.kind_in(registry_of(given.get("kind"), given), given)
    schedule = {name: given.pop(name) for name in RESERVED if name in given}
    channel = schedule.get("channel", law.channels[0])
    if isinstance(channel, str) and channel in law.channels:  # else there is no telling the units
        given = mistakes.convert(law, given, ("kind", *RESERVED), CHANNEL_UNITS[channel])
    if channel == ROTOR and setting.flies and setting.vehicle is None:
        return None  # the number of its rotors is not known
    rotors = len(setting.vehicle.rotors.positions) if setting.flies and setting.vehicle is not None else 0
    injection = mistakes.build(lambda: make_injection(kind, {**schedule, **given}, rotors=rotors), given)
    times = {"start": injection.start, "stop" if "stop" in schedule else "duration": injection.stop}
    mistakes.check_times(times, setting.duration)
    return Fault(injection, tuple(given))


def _mapping(raw: object, expected: str = "a mapping with 'kind'") -> dict[str, object]:
    if not isinstance(raw, dict):
        raise ValueError(f"{shown(raw)}: expected {expected}")
    return dict(cast("dict[str, object]", raw))


def shown(value: object) -> str:
    """Write a value for a message, at most 60 characters."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
