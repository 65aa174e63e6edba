"""A scenario: the keys of its file, their types and ranges; and the experiment that is built of them.

Pydantic checks the shape and calls `quadftc_flight.scenario.components` for what stands there.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import pydantic
from pydantic import AfterValidator, BaseModel, Field, PlainValidator, PrivateAttr, ValidationError

from quadftc_control.controller import controllers
from quadftc_control.reference import references
from quadftc_control.trajectory import trajectories
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow, fault_events, fault_windows, rotor_events
from quadftc_flight.scenario import components
from quadftc_flight.scenario.components import Fault, Part, Setting, part_builder, shown
from quadftc_flight.scenario.document import Document, Keys, Problem, ScenarioError
from quadftc_model.assembly import NodeValue, node_values
from quadftc_model.hints import nearest
from quadftc_model.position_estimator import PositionEstimator
from quadftc_model.stepper import seconds
from quadftc_model.units import quantity
from quadftc_sim.assembly import period_ns
from quadftc_sim.barometer import Barometer
from quadftc_sim.disturbance import disturbances
from quadftc_sim.magnetometer import Magnetometer
from quadftc_sim.plant import Plant, plants
from quadftc_sim.position_sensor import PositionSensor
from quadftc_sim.sensors import ImuSensor
from quadftc_sim.wind import winds

MAX_SEED = 2**31 - 1
LAG_A_STEP = 2.0  # 1; motor bandwidth times integration step; from 2.78 on Runge-Kutta of order 4 is unstable


def _within(unit: str, low: float, high: float) -> pydantic.BeforeValidator:
    def check(raw: object) -> float:
        if not isinstance(raw, (int, float, str)):
            raise ValueError(f"{raw!r}: expected a number in {unit}")
        value = quantity(raw, unit)
        if not low <= value <= high:
            raise ValueError(f"{value:g} {unit}: must be within [{low:g}, {high:g}] {unit}")
        return value

    return pydantic.BeforeValidator(check)


def _remember_duration(duration: float, info: pydantic.ValidationInfo) -> float:
    cast("Setting", info.context).duration = duration
    return duration


def _name_or_stem(
    raw: object, check: pydantic.ValidatorFunctionWrapHandler, info: pydantic.ValidationInfo
) -> str:
    """Without a name the scenario has that of its file."""
    document = cast("Setting", info.context).document
    if raw is not None or document is None:
        return check(raw)
    return re.sub(r"\W", "_", Path(document.source).stem)


Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Duration = Annotated[float, _within("s", 0.1, 3600.0), AfterValidator(_remember_duration)]
Rate = Annotated[float, _within("Hz", 10.0, 4000.0)]
Bound = Annotated[float, Field(allow_inf_nan=False)]
Observer = Annotated[Part, PlainValidator(part_builder(fault_observers, of_vehicle=True))]
DisturbanceObserver = Annotated[Part, PlainValidator(part_builder(disturbance_observers, of_vehicle=True))]
Controller = Annotated[Part, PlainValidator(part_builder(controllers, of_vehicle=True))]
Reference = Annotated[Part, PlainValidator(part_builder(references, of_vehicle=False))]
Disturbance = Annotated[Part, PlainValidator(part_builder(disturbances, of_vehicle=False))]
Wind = Annotated[Part, PlainValidator(part_builder(winds, of_vehicle=False))]
Trajectory = Annotated[Part, PlainValidator(part_builder(trajectories, of_vehicle=False))]
PositionController = Annotated[Part | None, PlainValidator(components.build_position_controller)]
ScheduledFault = Annotated[Fault, PlainValidator(components.build_fault)]


class _Shape(BaseModel):
    model_config = pydantic.ConfigDict(
        extra="forbid", frozen=True, strict=True, validate_default=True, arbitrary_types_allowed=True
    )


class Check(_Shape):
    """A bound on a metric of ``summary["metrics"]``; without an axis it holds for each."""

    metric: str  # dotted path
    axis: Literal["roll", "pitch", "yaw"] | None = None
    above: Bound | None = None  # exclusive, as the next; at least one is given
    below: Bound | None = None

    @pydantic.model_validator(mode="after")
    def _bounded(self) -> Check:
        if self.above is None and self.below is None:
            raise ValueError("expected 'above' or 'below', or both")
        if self.above is not None and self.below is not None and self.above >= self.below:
            raise ValueError(f"above = {self.above:g}: must be less than below = {self.below:g}")
        return self


class Scheme(_Shape):
    """Two observers and a controller, and what is required of them."""

    observer: Observer = cast("Part", "none")
    disturbance_observer: DisturbanceObserver = cast("Part", "none")
    controller: Controller
    position_controller: PositionController = None  # in free flight
    checks: tuple[Check, ...] = Field(default=(), strict=False)
    _name: str = PrivateAttr("")

    @property
    def name(self) -> str:
        """The key in the file."""
        return self._name


class Scenario(_Shape):
    """One experiment: a vehicle, its sensors, what happens to it, and the schemes that shall cope with it."""

    name: Annotated[Name, pydantic.WrapValidator(_name_or_stem)] = cast("str", None)
    description: str = ""
    duration: Duration  # [s]
    rate: Rate  # [Hz]
    seed: int = Field(default=0, ge=0, le=MAX_SEED)
    # name, or absolute path of a TOML file
    vehicle: Annotated[str, AfterValidator(components.load_vehicle_of)]
    # without disturbances and winds
    plant: Annotated[Plant, PlainValidator(components.build_plant)] = cast("Plant", {})
    sensor: Annotated[ImuSensor, PlainValidator(components.build_sensor)] = Field(
        default=cast("ImuSensor", {}), alias="sensors"
    )
    # in free flight
    position_sensor: Annotated[PositionSensor | None, PlainValidator(components.build_position_sensor)] = None
    magnetometer: Annotated[Magnetometer, PlainValidator(components.build_magnetometer)] = cast(
        "Magnetometer", None
    )
    barometer: Annotated[Barometer, PlainValidator(components.build_barometer)] = cast("Barometer", None)
    winds: tuple[Wind, ...] = Field(default=(), strict=False, alias="wind")
    trajectories: tuple[Trajectory, ...] = Field(default=(), strict=False)
    references: tuple[Reference, ...] = Field(default=(), strict=False)
    disturbances: tuple[Disturbance, ...] = Field(default=(), strict=False)
    faults: tuple[ScheduledFault, ...] = Field(default=(), strict=False)
    schemes: dict[Name, Scheme] = Field(min_length=1)  # the first is the default
    _document: Document = PrivateAttr()

    def model_post_init(self, context: Any, /) -> None:
        """Keep the document, and tell the schemes their names."""
        self._document = context.document
        for name, scheme in self.schemes.items():
            scheme._name = name  # pyright: ignore[reportPrivateUsage]

    @property
    def document(self) -> Document:
        """The file, with overrides applied."""
        return self._document

    @property
    def raw(self) -> dict[str, Any]:
        """The scenario as plain data, overrides applied; a vehicle's file by its absolute path."""
        return {**copy.deepcopy(self.document.data), "vehicle": self.vehicle}

    def scheme(self, name: str | None = None) -> Scheme:
        """Return a scheme by name, the first by default; a name that is not there is a ScenarioError."""
        if name is None:
            return next(iter(self.schemes.values()))
        if name not in self.schemes:
            hint, there = nearest(name, self.schemes), ", ".join(self.schemes)
            raise ScenarioError(f"{self.document.source}: no scheme '{name}'{hint}; there are: {there}")
        return self.schemes[name]

    @property
    def fault_windows(self) -> tuple[FaultWindow, ...]:
        """When the attitude is faulty by schedule: every distinct pair of start and stop [s], in order."""
        return fault_windows(self.faults, self.duration)

    @property
    def fault_events(self) -> tuple[FaultEvent, ...]:
        """The scheduled faults of each sensor, axis by axis, with their kind."""
        return fault_events(self.faults, self.duration)

    @property
    def rotor_events(self) -> tuple[FaultEvent, ...]:
        """The scheduled faults of each rotor, with their kind; the axis of each is its number."""
        return rotor_events(self.faults, self.duration)

    @property
    def rotors(self) -> int:
        """How many rotors the vehicle has in free flight; 0 on the test stand."""
        return self.plant.command_size if self.plant.flies else 0


def build_scenario(document: Document) -> Scenario:
    """Check a document and build everything in it; a ScenarioError has one line for each problem."""
    try:
        scenario = Scenario.model_validate(document.data, context=Setting(document))
    except ValidationError as error:
        models = {2: Scheme, 4: Check}  # of a scheme, and of a check in it
        problems = problems_of(error, lambda path: models.get(len(path), Scenario))
        raise document.error(problems) from None
    if problems := [*_unstable_lag(scenario), *_misplaced(scenario)]:
        raise document.error(problems)
    return scenario


def _unstable_lag(scenario: Scenario) -> Iterator[Problem]:
    """Refuse a motor lag that is too fast to be integrated at the rate."""
    plant, rate = scenario.plant, scenario.rate
    steps = 1.0 / (rate * plant.motor_time_constant)
    needed = math.ceil(steps / LAG_A_STEP)
    if plant.motor_lag and plant.substeps < needed:
        lag = f"{steps * rate:.4g} rad/s of motor lag at {rate:g} Hz"
        yield Problem(("plant", "substeps"), f"{plant.substeps}: {lag} need {needed} at least")


def _misplaced(scenario: Scenario) -> Iterator[Problem]:
    """Refuse what only the other kind of plant has."""
    if scenario.plant.flies:
        wrong, text = (
            {"references": scenario.references},
            "in free flight the attitude follows 'trajectories'",
        )
    else:
        wrong = {"wind": scenario.winds, "trajectories": scenario.trajectories}
        text = "only in free flight: expected 'plant: {kind: free_flight}'"
    yield from (Problem((name,), text) for name, parts in wrong.items() if parts)


def keys_of(model: type[BaseModel]) -> list[str]:
    """Return the keys that a mapping of a file may have."""
    return [field.alias or name for name, field in model.model_fields.items()]


_EXPECTED = {
    "string_type": "expected a text",
    "int_type": "expected a whole number",
    "float_type": "expected a number",
    "list_type": "expected a list",
    "tuple_type": "expected a list",
    "dict_type": "expected a mapping",
    "model_type": "expected a mapping with 'kind'",
    "finite_number": "expected a finite number",
    "string_pattern_mismatch": "expected letters, digits, '_' and '-', at most 64",
    "too_short": "expected at least one scheme",
    "literal_error": "expected one of roll, pitch, yaw",
}


def problems_of(error: ValidationError, model_at: Callable[[Keys], type[BaseModel]]) -> list[Problem]:
    """Return what a model found wrong with a document; ``model_at`` gives the model that is at some keys."""
    return [_problem(dict(details), model_at) for details in error.errors()]


def _problem(details: dict[str, Any], model_at: Callable[[Keys], type[BaseModel]]) -> Problem:
    path: Keys = tuple(key for key in details["loc"] if key != "[key]")
    kind, context = str(details["type"]), details.get("ctx", {})
    wrong = details["msg"].replace("Input should be", "must be")
    text = f"{shown(details['input'])}: {_EXPECTED.get(kind, wrong)}"
    if kind == "extra_forbidden":
        known = keys_of(model_at(path[:-1]))
        text = f"unknown key{nearest(str(path[-1]), known)}; known: {', '.join(known)}"
    elif kind in ("component", "value_error"):
        text = str(context.get("text") or context.get("error"))
    return Problem(path, "missing key" if kind == "missing" else text)


def node_parameters(
    scenario: Scenario, scheme: Scheme | str | None = None
) -> dict[str, dict[str, NodeValue]]:
    """Return the parameters of each node of the graph, for a scheme of a scenario (the first by default).

    | node | parameters |
    |---|---|
    | plant | plant, vehicle, rate [Hz], duration [s], seed, <parameter>, disturbances, imu.<parameter> |
    | fault_injector | seed, rotors, faults |
    | fault_observer, disturbance_observer | vehicle, observer, <observer>.<parameter> |
    | controller | vehicle, controller, <controller>.<parameter> |
    | reference | references |

    In free flight the plant has winds and position.<parameter>, too, and the node position_controller takes
    the place of reference: vehicle, position_controller, <position_controller>.<parameter>, trajectories.
    Whoever reads the position sensor knows its period and delay.

    Lists of components are lists of specifications (`quadftc_model.spec`) in SI, as ROS parameters have no
    other form. Of plant, observers and controllers every parameter is there, defaults included.
    """
    chosen = scheme if isinstance(scheme, Scheme) else scenario.scheme(scheme)

    def with_vehicle(selector: str, part: Part) -> dict[str, NodeValue]:
        return {"vehicle": scenario.vehicle, selector: part.kind, **node_values(part.law, part.kind)}

    # on the test stand; in free flight `_flying` adds what only it has
    nodes = {
        "plant": {
            "plant": plants.name_of(type(scenario.plant)),
            **{name: getattr(scenario, name) for name in ("vehicle", "rate", "duration", "seed")},
            **node_values(scenario.plant, ""),
            "disturbances": [part.spec for part in scenario.disturbances],
            **node_values(scenario.sensor, "imu"),
        },
        "fault_injector": {
            "seed": scenario.seed,
            "rotors": scenario.rotors,
            "faults": [fault.spec for fault in scenario.faults],
        },
        "fault_observer": with_vehicle("observer", chosen.observer),
        "disturbance_observer": with_vehicle("observer", chosen.disturbance_observer),
        "controller": with_vehicle("controller", chosen.controller),
    }
    if not scenario.plant.flies:
        return {**nodes, "reference": {"references": [part.spec for part in scenario.references]}}
    return {**nodes, **_flying(scenario, chosen, nodes)}


def estimator_for(scenario: Scenario) -> PositionEstimator:
    """Return the position estimator of a free flight, which knows its position sensor."""
    place = cast("PositionSensor", scenario.position_sensor)
    return PositionEstimator(
        delay=seconds(place.lag(scenario.rate) * period_ns(scenario.rate)),
        noise=max(*place.noise, PositionEstimator.noise),
        gives_velocity=place.gives_velocity,
        velocity_noise=max(*place.velocity_noise, PositionEstimator.velocity_noise),
    )


def _flying(
    scenario: Scenario, scheme: Scheme, nodes: Mapping[str, dict[str, NodeValue]]
) -> dict[str, dict[str, NodeValue]]:
    """Return the parameters of those nodes that have others in free flight."""
    place, outer = cast("PositionSensor", scenario.position_sensor), cast("Part", scheme.position_controller)
    period = period_ns(scenario.rate)
    known: dict[str, NodeValue] = {
        "position.period": seconds(place.every(scenario.rate) * period),
        "position.delay": seconds(place.lag(scenario.rate) * period),
    }
    return {
        "plant": {
            **nodes["plant"],
            "winds": [part.spec for part in scenario.winds],
            "position_sensor": True,
            **node_values(place, "position"),
            **node_values(scenario.magnetometer, "mag"),
            **node_values(scenario.barometer, "baro"),
        },
        "fault_observer": {**nodes["fault_observer"], **known},
        "position_controller": {
            "vehicle": scenario.vehicle,
            "position_controller": outer.kind,
            **node_values(outer.law, outer.kind),
            **node_values(estimator_for(scenario), "estimator"),
            "trajectories": [part.spec for part in scenario.trajectories],
            **known,
        },
    }
