"""What an autopilot is to fly: a scenario of free flight, and its key ``autopilot``.

The key is optional; any scenario of free flight can be flown without it:

    autopilot:
      mode: guided              # setpoints (PX4: OFFBOARD); or auto: a mission of waypoints along them
      end: land                 # or rtl
      parameters: {ARMING_CHECK: 1}
      faults:                   # the autopilot's own simulated ones, set and put back
        - {set: {SIM_GYR1_BIAS_X: 0.3}, start: 20 s, stop: 25 s}
        - {inject: gyro 1 stuck, start: 20 s, stop: 25 s}      # by PX4's command
      guard:                    # what is done about what our observer names; else nothing
        {actions: {gyro: land, rotor 1: tell}, after: 0.3 s, ambiguous: false}
      checks:
        - {metric: survived, above: 0.5}
      catalogue:                # flights of `quadftc sitl --catalogue`, each with its faults
        - {name: gyro_x_step, faults: [{kind: bias, channel: gyro, axes: x, value: 0.3, start: 10 s}]}
        - {name: gps_step, own: [{set: {SIM_GPS1_GLTCH_X: {uniform: [0, 0.0005]}}, start: 10 s}], flights: 20}

Times are those of the scenario: 0 is when the vehicle has climbed to where its trajectories begin.
Faults of a catalogue are drawn as campaigns draw: sizes, axes and times may be distributions.
"""

from __future__ import annotations

import dataclasses
import math
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, cast

import numpy as np
import pydantic
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from quadftc_campaign.distributions import KINDS, distribution
from quadftc_flight.scenario import Check, Document, Problem, Scenario, Scheme, build_scenario, problems_of
from quadftc_flight.scenario.document import Keys, ScenarioError, parse_document
from quadftc_model.units import quantity
from quadftc_sitl.autopilot import NAMES, Autopilot, autopilot_named

KEY = "autopilot"
USUAL_SCHEME = {
    "observer": "isolating",
    "disturbance_observer": "none",
    "controller": "ismc",
    "position_controller": "geometric",
}
# parameter of the simulation -> component that it makes fail, as `quadftc diagnose` names it
COMPONENTS = {
    "SIM_GYR": "gyro",
    "SIM_ACC": "accelerometer",
    "SIM_MAG": "magnetometer",
    "SIM_BAR": "barometer",
    "SIM_GPS": "gps",
    "SIM_ENGINE": "rotor",
}
ACTIONS = ("tell", "lane", "alt_hold", "land", "rtl")
FINDING = "^(attitude( (roll|pitch|yaw))?|(gyro|accelerometer)( [xyz])?|rotor( [1-9][0-9]?)?)$"
PARAMETER = re.compile(r"[A-Z][A-Z0-9_]{0,15}")
FAILURE = re.compile(r"(gyro|accelerometer|magnetometer|barometer|gps)(?: ([1-9]))? (off|stuck)")
Seconds = Annotated[float, BeforeValidator(lambda raw: quantity(raw, "s")), Field(ge=0.0, le=3600.0)]
ParameterName = Annotated[str, Field(pattern=f"^{PARAMETER.pattern}$")]
ParameterValue = Annotated[float, Field(allow_inf_nan=False)]


def draw(raw: object, generator: np.random.Generator) -> object:
    """Return plain data with each distribution in it replaced by a value; ValueError for a wrong one."""
    if isinstance(raw, list):
        return [draw(each, generator) for each in cast("list[object]", raw)]
    if not isinstance(raw, Mapping):
        return raw
    given = cast("Mapping[str, object]", raw)
    if any(key in KINDS for key in given):
        return distribution(given).draw(generator)
    return {key: draw(value, generator) for key, value in given.items()}


def _one_of(*names: str) -> AfterValidator:
    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"'{name}': expected one of {', '.join(names)}")
        return name

    return AfterValidator(check)


class _Shape(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class OwnFault(_Shape):
    """A fault of the autopilot's own simulation: parameters, set at a time and put back at another."""

    set: dict[ParameterName, ParameterValue] = {}
    inject: Annotated[str, Field(pattern=f"^({FAILURE.pattern})?$")] = ""  # or one that PX4 has a command for
    start: Seconds = 0.0  # [s]
    stop: Seconds | None = None  # [s]; None: to the end
    rise: Seconds = 0.0  # over which the values grow to what is set [s]; 0: a step
    component: str = ""  # that fails, with its element, such as 'gps x'; empty: by the parameters
    kind: str = ""  # what it looks like

    @pydantic.model_validator(mode="after")
    def _has_one(self) -> OwnFault:
        if bool(self.set) == bool(self.inject):
            raise ValueError("expected 'set', parameters, or 'inject', such as 'gyro 1 stuck'")
        return self

    @property
    def failure(self) -> tuple[str, int, str]:
        """What is injected: unit, its number from 1, 0: all, and what becomes of it."""
        found = FAILURE.fullmatch(self.inject)
        assert found is not None
        return found[1], int(found[2] or 0), found[3]

    @property
    def failing(self) -> str:
        """The component that fails, with its element; empty: not known."""
        names = (word for name in self.set for start, word in COMPONENTS.items() if name.startswith(start))
        return self.component or next(names, self.inject.partition(" ")[0])

    @property
    def end(self) -> float:
        """When it ends [s]."""
        return math.inf if self.stop is None else self.stop


class Guard(_Shape):
    """What a guardian does about a diagnosis: an action for a component, or for one of its elements."""

    actions: dict[Annotated[str, Field(pattern=FINDING)], Annotated[str, _one_of(*ACTIONS)]] = {}
    after: Seconds = 0.3  # for which a fault has to be named without a break [s]
    ambiguous: bool = False  # act although it may be a component with another action, or with none

    def action_of(self, finding: str) -> str:
        """Return the action for a component and element; empty: none."""
        return self.actions.get(finding) or self.actions.get(finding.partition(" ")[0], "")


class Entry(_Shape):
    """Flights of a catalogue: the scenario with other faults; ours, the autopilot's own, or both.

    Any value of a fault may be a distribution, as in a campaign: each flight draws its own.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
    faults: list[dict[str, object]] = []  # as under `faults` of a scenario
    own: list[dict[str, object]] = []  # as `OwnFault`
    flights: int = Field(default=1, ge=1, le=100_000)


class Section(_Shape):
    """The key ``autopilot`` of a scenario."""

    mode: Annotated[str, _one_of("guided", "auto")] = "guided"
    end: Annotated[str, _one_of("land", "rtl")] = "land"
    parameters: dict[ParameterName, ParameterValue] = {}
    faults: tuple[OwnFault, ...] = ()
    guard: Guard = Guard()
    checks: tuple[Check, ...] = ()
    catalogue: tuple[Entry, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SitlPlan:
    """One flight of an autopilot."""

    scenario: Scenario
    scheme: Scheme  # whose observer runs beside it
    section: Section
    autopilot: Autopilot

    @property
    def name(self) -> str:
        """Name of the flight: that of the scenario."""
        return self.scenario.name

    @property
    def raw(self) -> dict[str, object]:
        """The scenario as plain data, with the key ``autopilot``."""
        section = self.section.model_dump(mode="json", exclude_none=True, exclude={"catalogue"})
        return {**self.scenario.raw, KEY: section}

    @property
    def rate(self) -> float:
        """Of the physics and of our IMU [Hz]."""
        return self.autopilot.rate(self)


def plan_of(document: Document, scheme: str = "", autopilot: str = NAMES[0]) -> SitlPlan:
    """Build what is to be flown of a scenario file; a ScenarioError has one line for each problem."""
    plain = {key: value for key, value in document.data.items() if key != KEY}
    plain.setdefault("schemes", {"beside": USUAL_SCHEME})
    scenario = build_scenario(dataclasses.replace(document, data=plain))
    if not scenario.plant.flies:
        wanted = "an autopilot flies free: expected 'plant: {kind: free_flight}'"
        raise document.error([Problem(("plant",), wanted)])
    section = _section_of(document)
    flown = autopilot_named(autopilot)
    if not flown.takes_failures and any(fault.inject for fault in section.faults):
        raise document.error([Problem((KEY, "faults"), f"inject: {flown.title} has no such command")])
    chosen = scenario.scheme(scheme or None)
    return SitlPlan(scenario=scenario, scheme=chosen, section=section, autopilot=flown)


def plan_of_text(text: str, scheme: str, name: str, autopilot: str = NAMES[0]) -> SitlPlan:
    """Build what is to be flown of the text of a scenario."""
    return plan_of(parse_document(text, f"{name}.yaml"), scheme, autopilot)


def plans_of_catalogue(
    document: Document, scheme: str, flights: int | None = None, autopilot: str = NAMES[0]
) -> list[SitlPlan]:
    """Build the flights of the catalogue of a scenario, so many of each entry; None: as many as it says.

    Their seeds begin with that of the scenario. What is drawn depends on name and seed of a flight alone.
    """
    entries = _section_of(document).catalogue
    if not entries:
        raise document.error([Problem((KEY,), "no 'catalogue': expected a list of flights")])
    names = [entry.name for entry in entries]
    if twice := next((name for name in names if names.count(name) > 1), ""):
        raise document.error([Problem((KEY, "catalogue"), f"'{twice}' comes twice")])
    first = int(document.data.get("seed", 0))
    plans: list[SitlPlan] = []
    for number, entry in enumerate(entries):
        for seed in range(first, first + (flights or entry.flights)):
            generator = np.random.default_rng([zlib.crc32(entry.name.encode()), seed])
            try:
                ours, own = draw(entry.faults, generator), draw(entry.own, generator)
            except ValueError as error:
                raise document.error([Problem((KEY, "catalogue", number), str(error))]) from None
            name = f"{entry.name}-{seed}"
            changes: dict[Keys, object] = {("name",): name, ("faults",): ours, ("seed",): seed}
            changes |= {(KEY, "faults"): own, (KEY, "catalogue"): []}
            plans.append(plan_of(document.replaced(changes, f"catalogue, '{entry.name}'"), scheme, autopilot))
    return plans


def _section_of(document: Document) -> Section:
    try:
        return Section.model_validate(document.data.get(KEY) or {})
    except pydantic.ValidationError as error:
        found = problems_of(error, _model_at)
        raise document.error([problem._replace(path=(KEY, *problem.path)) for problem in found]) from None


def _model_at(path: Sequence[str | int]) -> type[BaseModel]:
    inside = {"faults": OwnFault, "guard": Guard, "checks": Check, "catalogue": Entry}
    names = [inside[str(key)] for key in path if key in inside]
    return names[-1] if names else Section


def read_parameters(path: Path) -> dict[str, float]:
    """Read a parameter file, NAME VALUE a line or as QGroundControl saves them; # begins a comment."""
    from quadftc_model.small_files import read_small

    found: dict[str, float] = {}
    for number, line in enumerate(read_small(path).splitlines(), 1):
        words = re.split(r"[\s,=]+", line.partition("#")[0].strip())
        if words == [""]:
            continue
        if len(words) > 3 and words[0].isdecimal():  # system and component come first
            words = words[2:]
        where = f"{path}:{number}"
        if len(words) < 2 or not PARAMETER.fullmatch(words[0]):
            raise ScenarioError(f"{where}: {line.strip()!r}: expected NAME VALUE")
        try:
            value = float(words[1])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ScenarioError(f"{where}: {words[0]} = {words[1]!r}: expected a number")
        found[words[0]] = value
    return found
