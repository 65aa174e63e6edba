"""A campaign file: what is flown, how often, and what is drawn.

name: mems_robustness
scenario: mems_faults              # by name, or a path relative to this file
gains: qball_x4_mems               # tuned gains, if any: see quadftc_flight.scenario.files
set: [duration=60 s]               # values of the scenario that are the same in all flights
source: {kind: loop}               # loop: the closed loop. Or the fault observer alone, on IMU samples
                                   # with the faults of the scenario (quadftc_campaign.open_loop):
                                   #   motion: simulated along the references of the scenario
                                   #   recordings: of the rosbag2 bags in `directory`; flights are of each
                                   # delay: {uniform: [0 s, 10 s]}   by which all faults come later
flights: 1000
seed: 1
schemes: [supervised]              # of the scenario, or all; or observers and controllers to cross:
observers: [sliding_mode, supervised]    # or all: every registered fault observer; or others: not crossed,
                                         # but the first scheme also with every one that no scheme has
parameters: {supervised: {wander: 0 deg}}            # of observers named there, beside the scenario's
levels: {supervised: {threshold: [3, 8]}}            # more variants: supervised@3, supervised@8
controllers: [ismc, pid]
vary:
  faults.0.value: {uniform: [0.5 deg, 5 deg], sign: random}
  faults.*.start: {uniform: [10 s, 20 s]}            # of each fault
  rate: {grid: [125 Hz, 250 Hz]}
report: {map: [faults.0.value, rate], metric: fault.estimate_rmse_deg}
tune:                                    # for quadftc tune
  gains: [controller.k_c1, controller.phi, disturbance_observer.bandwidth]
  cost: {tracking_rmse_deg: 1, torque_total_variation: 0.1}  # weights, of metrics over their first values
  flights: 32                            # of each step, in turn out of those of the campaign
  steps: 30
  rate: 0.05                             # of Adam, in the logarithm of a gain
  held_out: 256                          # flights beyond those of the campaign, to judge by
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from quadftc_campaign.distributions import Distribution, distribution
from quadftc_campaign.tune.cost import TERMS
from quadftc_control.controller import controllers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_flight.run_directory import NO_OBSERVER
from quadftc_flight.scenario import (
    MAX_SEED,
    Document,
    Keys,
    Name,
    Problem,
    Scenario,
    ScenarioError,
    build_scenario,
    changed_document,
    find_scenario,
    problems_of,
    read_document,
)

MAX_FLIGHTS = 10_000_000
MAX_CELLS = 10_000
RESERVED = ("seed", "schemes")  # each flight draws its seed; the schemes are compared, not drawn
ALL = "all"
OTHERS = "others"


class _Shape(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class SourceShape(_Shape):
    """Where the flights come from."""

    kind: Literal["loop", "motion", "recordings"] = "loop"
    directory: str = ""
    delay: Any = None


class ReportShape(_Shape):
    """What the report shows besides what it always shows."""

    map: list[str] = Field(default=[], max_length=2)
    metric: str = "fault.estimate_rmse_deg"


class TuneShape(_Shape):
    """What ``quadftc tune`` does with the campaign."""

    gains: list[str] = Field(min_length=1)
    cost: dict[str, float] = Field(min_length=1)
    flights: int = Field(default=32, ge=1, le=MAX_FLIGHTS)
    steps: int = Field(default=30, ge=1, le=10_000)
    rate: float = Field(default=0.05, gt=0.0, le=1.0)
    held_out: int = Field(default=256, ge=1, le=MAX_FLIGHTS)

    @field_validator("cost")
    @classmethod
    def _known(cls, cost: dict[str, float]) -> dict[str, float]:
        for name, weight in cost.items():
            if name not in TERMS:
                raise ValueError(f"no '{name}'; there are: {', '.join(TERMS)}")
            if not 0.0 < weight < math.inf:
                raise ValueError(f"{name} = {weight}: must be positive and finite")
        return cost


class CampaignShape(_Shape):
    """The keys of a campaign file."""

    name: Name | None = None
    description: str = ""
    scenario: str
    gains: str = ""
    set: list[str] = []
    source: SourceShape = SourceShape()
    flights: int = Field(ge=1, le=MAX_FLIGHTS)
    seed: int = Field(default=1, ge=0, le=MAX_SEED)
    schemes: list[str] | Literal["all"] = []
    observers: list[str] | Literal["all", "others"] = []
    parameters: dict[str, dict[str, Any]] = {}
    levels: dict[str, dict[str, list[float]]] = {}
    controllers: list[str] = []
    vary: dict[str, Any] = {}
    precision: Literal["float64", "float32"] = "float64"
    report: ReportShape = ReportShape()
    tune: TuneShape | None = None


@dataclasses.dataclass(frozen=True)
class Variant:
    """What a flight is flown with: a scheme of the scenario, some of its parts replaced."""

    name: str
    scheme: str
    observer: str | None  # None: the scheme's
    controller: str | None
    parameters: tuple[tuple[str, Any], ...] = ()  # of the observer


@dataclasses.dataclass(frozen=True)
class Source:
    """Where the flights come from: the closed loop, samples along a motion, or recordings."""

    kind: str = "loop"
    recordings: tuple[Path, ...] = ()  # flight k is on recording k modulo their number
    delay: Distribution | None = None  # [s]; of all faults of a flight

    @property
    def is_loop(self) -> bool:
        """Whether the flights are those of the closed loop."""
        return self.kind == "loop"


@dataclasses.dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign, checked.

    Parameters
    ----------
    base : Document
        The scenario, with the values that all flights share.
    vary : dict of str to Distribution
        By the path of the value, such as ``faults.0.value``.
    """

    name: str
    description: str
    base: Document
    source: Source
    flights: int
    seed: int
    variants: tuple[Variant, ...]
    vary: dict[str, Distribution]
    float32: bool
    map: tuple[str, ...]
    metric: str
    tune: TuneShape | None
    document: Document

    @property
    def cells(self) -> int:
        """How many combinations the grids have."""
        return math.prod(len(each.values) for each in self.vary.values() if each.is_grid)

    def with_steps(self, steps: int) -> Campaign:
        """Return the campaign with another number of steps of tuning."""
        tune = self.tune and self.tune.model_copy(update={"steps": steps})
        return dataclasses.replace(self, tune=tune)


def load_campaign(path: Path, flights: int | None = None, recordings: Path | None = None) -> Campaign:
    """Load a campaign file.

    Parameters
    ----------
    path : Path
    flights : int, optional
        In place of the file's number.
    recordings : Path, optional
        In place of the directory of the file's source.

    Raises
    ------
    ScenarioError
        If anything is wrong with it: one line for each problem.
    """
    document = read_document(path)
    if flights is not None:
        document = document.replaced(("flights",), flights, f"flights {flights}")
    try:
        shape = CampaignShape.model_validate(document.data)
    except ValidationError as error:
        raise document.error(problems_of(error, _model_at)) from None
    base, scenario = _base(document, shape)
    vary, problems = _distributions(shape, base)
    problems += _wrong_parts(shape, scenario)
    source = _source(document, shape, recordings, problems)
    campaign = Campaign(
        name=shape.name or path.stem,
        description=shape.description,
        base=base,
        source=source,
        flights=shape.flights * max(len(source.recordings), 1),
        seed=shape.seed,
        variants=_variants(shape, scenario),
        vary=vary,
        float32=shape.precision == "float32",
        map=tuple(shape.report.map),
        metric=shape.report.metric,
        tune=shape.tune,
        document=document,
    )
    if campaign.cells > MAX_CELLS:
        problems.append(Problem(("vary",), f"{campaign.cells} combinations of grids: at most {MAX_CELLS}"))
    problems += _unknown_axes(campaign)
    if problems:
        raise document.error(problems)
    return campaign


def _model_at(path: Keys) -> type[BaseModel]:
    models = {"report": ReportShape, "tune": TuneShape, "source": SourceShape}
    return models.get(str(path[0]) if path else "", CampaignShape)


def _distributions(shape: CampaignShape, base: Document) -> tuple[dict[str, Distribution], list[Problem]]:
    found: dict[str, Distribution] = {}
    problems: list[Problem] = []
    for key, raw in shape.vary.items():
        if key.split(".")[0] in RESERVED:
            problems.append(Problem(("vary", key), f"'{key}' cannot vary: seeds are drawn, schemes crossed"))
            continue
        try:
            found |= dict.fromkeys(_paths(key, base), distribution(raw))
        except ValueError as error:
            problems.append(Problem(("vary", key), str(error)))
    return found, problems


def _paths(key: str, base: Document) -> list[str]:
    """The paths that a key stands for: ``faults.*.value`` is one for each fault of the scenario."""
    first, star, rest = key.partition(".*")
    if not star:
        return [key]
    items = base.data.get(first)
    if not isinstance(items, list):
        raise ValueError(f"'{first}' is no list of the scenario")
    return [f"{first}.{index}{rest}" for index in range(len(items))]  # pyright: ignore[reportUnknownArgumentType]


def _base(document: Document, shape: CampaignShape) -> tuple[Document, Scenario]:
    """The scenario that all flights are made of."""
    beside = Path(document.source).parent / shape.scenario
    is_file = beside.suffix in (".yaml", ".yml") and beside.is_file()
    try:
        path = beside if is_file else find_scenario(shape.scenario)
        base = changed_document(path, shape.set, shape.gains)
        return base, build_scenario(base)
    except ScenarioError as error:
        lines = str(error).splitlines()
        raise document.error([Problem(("scenario",), line) for line in lines]) from None


def _source(
    document: Document, shape: CampaignShape, recordings: Path | None, problems: list[Problem]
) -> Source:
    given, delay = shape.source, None
    if given.delay is not None:
        try:
            delay = distribution(given.delay)
        except ValueError as error:
            problems.append(Problem(("source", "delay"), str(error)))
    if given.kind != "recordings":
        return Source(given.kind, delay=delay)
    directory = recordings or Path(document.source).parent / given.directory
    found = bags_in(directory) if recordings or given.directory else ()
    if not found:
        said = f"{directory}: holds no bag" if recordings or given.directory else "no directory is named"
        problems.append(Problem(("source", "directory"), f"{said}; expected rosbag2 bags (--recordings)"))
    return Source(given.kind, found, delay)


def bags_in(directory: Path) -> tuple[Path, ...]:
    """Return the bags in a directory, or the directory if it is one; empty: there is none."""
    if (directory / "metadata.yaml").is_file():
        return (directory,)
    return tuple(sorted(path.parent for path in directory.glob("*/metadata.yaml")))


def _wrong_parts(shape: CampaignShape, scenario: Scenario) -> Iterator[Problem]:
    if shape.observers == OTHERS and (shape.controllers or shape.levels):
        yield Problem(("observers",), "'others' cannot be crossed with controllers or levels")
    lists = {
        "schemes": (shape.schemes, tuple(scenario.schemes)),
        "observers": (shape.observers, fault_observers.names()),
        "controllers": (shape.controllers, controllers.names()),
        "parameters": (list(shape.parameters), fault_observers.names()),
        "levels": (list(shape.levels), fault_observers.names()),
    }
    for key, (given, known) in lists.items():
        for index, name in enumerate(given if isinstance(given, list) else ()):
            if name not in known:
                place = (key, index) if isinstance(getattr(shape, key), list) else (key, name)
                yield Problem(place, f"no '{name}'; there are: {', '.join(known)}")
            elif name in given[:index]:
                yield Problem((key, index), f"'{name}' is given twice")


def _with_others(schemes: list[str], shape: CampaignShape, scenario: Scenario) -> Iterator[Variant]:
    """Yield the schemes as they are, and the first with every registered observer that none of them has."""
    yield from (Variant(name, name, None, None) for name in schemes)
    flown = {scenario.schemes[name].observer.kind for name in schemes}
    for name in (each for each in _all_observers() if each not in flown):
        yield Variant(name, schemes[0], name, None, tuple(shape.parameters.get(name, {}).items()))


def _variants(shape: CampaignShape, scenario: Scenario) -> tuple[Variant, ...]:
    """Schemes, crossed with observers and controllers where some are named."""
    given = list(scenario.schemes) if shape.schemes == ALL else shape.schemes
    schemes = [name for name in given if name in scenario.schemes] or [next(iter(scenario.schemes))]
    if shape.observers == OTHERS:
        return tuple(_with_others(schemes, shape, scenario))
    named = _all_observers() if shape.observers == ALL else shape.observers
    observers = [(name, name, shape.parameters.get(name, {})) for name in named]
    observers += [
        (f"{name}@{value:g}", name, {**shape.parameters.get(name, {}), parameter: value})
        for name, swept in shape.levels.items()
        for parameter, values in swept.items()
        for value in values
    ]
    own_scheme = len(schemes) > 1 or shape.source.kind == "loop" or not observers
    return tuple(
        Variant(
            "+".join(filter(None, (scheme if own_scheme else None, name, controller))),
            *(scheme, observer, controller),
            tuple(parameters.items()),
        )
        for scheme in schemes
        for name, observer, parameters in observers or [(None, None, {})]
        for controller in shape.controllers or [None]
    )


def _all_observers() -> list[str]:
    return [name for name in fault_observers.names() if name != NO_OBSERVER]


def _unknown_axes(campaign: Campaign) -> Iterator[Problem]:
    for index, key in enumerate(campaign.map):
        if key not in campaign.vary:
            there = ", ".join(campaign.vary) or "nothing varies"
            yield Problem(("report", "map", index), f"'{key}' does not vary; there are: {there}")
