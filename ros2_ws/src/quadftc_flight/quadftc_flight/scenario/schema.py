"""The shape of a scenario file: its keys, their types and ranges; components check their own parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    model_validator,
)

from quadftc_flight.scenario.yaml_document import Keys, Problem
from quadftc_model.hints import nearest
from quadftc_model.units import quantity

MIN_RATE, MAX_RATE = 10.0, 4000.0  # Hz
MIN_DURATION, MAX_DURATION = 0.1, 3600.0  # s
MAX_SEED = 2**31 - 1


def _within(unit: str, low: float, high: float) -> BeforeValidator:
    def check(raw: Any) -> float:
        if not isinstance(raw, (int, float, str)):
            raise ValueError(f"{raw!r}: expected a number in {unit}")
        value = quantity(raw, unit)
        if not low <= value <= high:
            raise ValueError(f"{value:g} {unit}: must be within [{low:g}, {high:g}] {unit}")
        return value

    return BeforeValidator(check)


def _named(raw: Any) -> Any:
    """Let a component be given by its name alone."""
    return {"kind": raw} if isinstance(raw, str) else raw


Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Duration = Annotated[float, _within("s", MIN_DURATION, MAX_DURATION)]
Rate = Annotated[float, _within("Hz", MIN_RATE, MAX_RATE)]
Bound = Annotated[float, Field(allow_inf_nan=False)]


class _Shape(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class PartShape(BaseModel):
    """A component: its kind and its own parameters, which the component checks."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)

    kind: str


Named = Annotated[PartShape, BeforeValidator(_named)]


class CheckShape(_Shape):
    """A bound on a metric."""

    metric: str
    axis: Literal["roll", "pitch", "yaw"] | None = None
    above: Bound | None = None
    below: Bound | None = None

    @model_validator(mode="after")
    def _bounded(self) -> CheckShape:
        if self.above is None and self.below is None:
            raise ValueError("expected 'above' or 'below', or both")
        if self.above is not None and self.below is not None and self.above >= self.below:
            raise ValueError(f"above = {self.above:g}: must be less than below = {self.below:g}")
        return self


class SchemeShape(_Shape):
    """What is compared: two observers and a controller."""

    observer: Named = PartShape(kind="none")
    disturbance_observer: Named = PartShape(kind="none")
    controller: Named
    checks: list[CheckShape] = []


class ScenarioShape(_Shape):
    """A scenario file."""

    name: Name | None = None
    description: str = ""
    duration: Duration
    rate: Rate
    seed: int = Field(default=0, ge=0, le=MAX_SEED)
    vehicle: str
    plant: dict[str, Any] = {}
    sensors: dict[str, Any] = {}
    references: list[PartShape] = []
    disturbances: list[PartShape] = []
    faults: list[PartShape] = []
    schemes: dict[Name, SchemeShape] = Field(min_length=1)


def shape_of(data: dict[str, Any]) -> tuple[ScenarioShape | None, list[Problem]]:
    """Check the shape of a scenario; return it, or None and what is wrong."""
    try:
        return ScenarioShape.model_validate(data), []
    except ValidationError as error:
        return None, problems_of(error, _model_at)


def problems_of(error: ValidationError, model_at: Callable[[Keys], type[BaseModel]]) -> list[Problem]:
    """Return what a model found wrong with a document; ``model_at`` gives the model that is at some keys."""
    return [_problem(dict(details), model_at) for details in error.errors()]


_EXPECTED = {
    "string_type": "a text",
    "int_type": "a whole number",
    "float_type": "a number",
    "list_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping with 'kind'",
    "finite_number": "a finite number",
    "string_pattern_mismatch": "letters, digits, '_' and '-', at most 64",
    "too_short": "at least one scheme",
    "literal_error": "one of roll, pitch, yaw",
}


def _problem(details: dict[str, Any], model_at: Callable[[Keys], type[BaseModel]]) -> Problem:
    path: Keys = tuple(key for key in details["loc"] if key != "[key]")
    kind, shown = str(details["type"]), _shown(details["input"])
    if kind == "extra_forbidden":
        known = list(model_at(path[:-1]).model_fields)
        hint = nearest(str(path[-1]), known)
        return Problem(path, f"unknown key{hint}; known: {', '.join(known)}")
    if kind == "missing":
        return Problem(path, "missing key")
    if kind == "value_error":
        return Problem(path, str(details["ctx"]["error"]))
    if kind in _EXPECTED:
        return Problem(path, f"{shown}: expected {_EXPECTED[kind]}")
    return Problem(path, f"{shown}: {details['msg'].replace('Input should be', 'must be')}")


def _model_at(path: Keys) -> type[BaseModel]:
    match path:
        case ("schemes", _):
            return SchemeShape
        case ("schemes", _, "checks", _):
            return CheckShape
        case _:
            return ScenarioShape


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
