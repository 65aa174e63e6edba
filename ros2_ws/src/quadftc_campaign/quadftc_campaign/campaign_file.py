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
                                   # Or `source: sitl`: an autopilot's firmware, by `quadftc sitl FILE`;
                                   # with name, set, flights, seed, vary and one of the schemes alone
flights: 1000
seed: 1
schemes: [supervised]              # of the scenario, or all; each with every observer that is named:
observers: [sliding_mode, supervised]    # or all: every registered fault observer; or others: not crossed,
                                         # but the first scheme also with every one that no scheme has
vary:
  faults.0.value: {uniform: [0.5 deg, 5 deg], sign: random}
  faults.*.start: {uniform: [10 s, 20 s]}            # of each fault
  rate: {grid: [125 Hz, 250 Hz]}
precision: float32                 # of JAX; C and NumPy compute in double
checks:                            # bounds on what comes out, see quadftc_campaign.campaign_checks
  - {metric: tracking_rmse_deg.q95, below: 0.1}                      # of each variant, on every axis
  - {metric: faults.all.missed_share, below: 0.01, variants: [supervised]}
tune:                                    # for quadftc tune
  gains: [controller.k_c1, controller.phi, disturbance_observer.bandwidth]
  cost: {tracking_rmse_deg: 1, torque_total_variation: 0.1}  # weights, of metrics over their first values
  flights: 32                            # of each step, in turn out of those of the campaign
  steps: 30
  rate: 0.05                             # of Adam, in the logarithm of a gain
  held_out: 256                          # flights beyond those of the campaign, to judge by
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
)

from quadftc_campaign.batch.engine import ENGINES, JAX
from quadftc_campaign.batch.records import ROOTS, VARIATION
from quadftc_campaign.campaign_checks import CampaignCheck, wrong_checks
from quadftc_campaign.distributions import GRID, Distribution, distribution
from quadftc_campaign.workers import has_accelerator
from quadftc_fdi.fault_observer import fault_observers
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
    refuse_kind,
)
from quadftc_flight.summary import NO_OBSERVER

MAX_FLIGHTS = 10_000_000
MAX_CELLS = 10_000
RESERVED = ("seed", "schemes")  # each flight draws its seed; the schemes are compared, not drawn
COSTS = (*ROOTS, VARIATION)  # metrics that tuning can lower
ALL = "all"
OTHERS = "others"
SITL = "sitl"
NOT_IN_SITL = ("observers", "precision", "checks", "tune")


class _Keys(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, arbitrary_types_allowed=True)


def _check_path(path: str) -> str:
    if path.partition(".")[0] in RESERVED:
        raise ValueError(f"'{path}' cannot vary: seeds are drawn, schemes crossed")
    return path


def _check_cost(cost: dict[str, float]) -> dict[str, float]:
    for name, weight in cost.items():
        if name not in COSTS:
            raise ValueError(f"no '{name}'; there are: {', '.join(COSTS)}")
        if not 0.0 < weight < math.inf:
            raise ValueError(f"{name} = {weight}: must be positive and finite")
    return cost


Drawn = Annotated[Distribution, PlainValidator(distribution)]
VaryingPath = Annotated[str, AfterValidator(_check_path)]
KindAlone = BeforeValidator(lambda raw: {"kind": raw} if isinstance(raw, str) else raw)


class SourceKeys(_Keys):
    """Where the flights come from: the closed loop, samples along a motion, recordings, or a firmware."""

    kind: Literal["loop", "motion", "recordings", "sitl"] = "loop"
    directory: str = ""
    delay: Drawn | None = None


class TuneKeys(_Keys):
    """What ``quadftc tune`` does with the campaign."""

    gains: list[str] = Field(min_length=1)
    cost: Annotated[dict[str, float], AfterValidator(_check_cost)] = Field(min_length=1)
    flights: int = Field(default=32, ge=1, le=MAX_FLIGHTS)
    steps: int = Field(default=30, ge=1, le=10_000)
    rate: float = Field(default=0.05, gt=0.0, le=1.0)
    held_out: int = Field(default=256, ge=1, le=MAX_FLIGHTS)


class CampaignKeys(_Keys):
    """The keys of a campaign file."""

    name: Name | Literal[""] = ""
    description: str = ""
    scenario: str
    gains: str = ""
    set: list[str] = []
    source: Annotated[SourceKeys, KindAlone] = SourceKeys()
    flights: int = Field(ge=1, le=MAX_FLIGHTS)
    seed: int = Field(default=1, ge=0, le=MAX_SEED)
    schemes: list[str] | Literal["all"] = []
    observers: list[str] | Literal["all", "others"] = []
    vary: dict[VaryingPath, Drawn] = {}
    precision: Literal["float64", "float32"] = "float64"
    checks: list[CampaignCheck] = []
    tune: TuneKeys | None = None


class Variant(NamedTuple):
    """What a flight is flown with: a scheme of the scenario, or one with another observer."""

    name: str
    scheme: str
    observer: str | None = None  # None: the scheme's


class Campaign(CampaignKeys):
    """A campaign, checked: the keys of its file, with the number of all flights and each path that varies."""

    document: Document  # the file
    base: Document  # the scenario, with the values that all flights share
    variants: tuple[Variant, ...]
    recordings: tuple[Path, ...]  # flight k is on recording k modulo their number
    engine: str  # that flies it, of `ENGINES`

    @property
    def flown_precision(self) -> str:
        """Precision in which it is flown: only JAX has another than double."""
        return self.precision if self.engine == JAX else "float64"

    @property
    def cells(self) -> int:
        """How many combinations the grids have."""
        return math.prod(len(each.values) for each in self.vary.values() if each.kind == GRID)


def load_campaign(
    path: Path,
    flights: int | None = None,
    recordings: Path | None = None,
    seed: int | None = None,
    engine: str | None = None,
    assignments: Sequence[str] = (),
    build: Callable[[Document], Scenario] | None = None,
) -> Campaign:
    """Load a campaign file; a `ScenarioError` has one line for each problem.

    ``flights`` and ``seed`` count in place of the file's, ``recordings`` in place of its source's directory.
    ``engine`` flies it; None: JAX flies a closed loop where it has an accelerator, and C all else.
    ``assignments`` come after those of ``set``. Who flies firmware gives ``build``, which knows its keys.
    """
    document = read_document(path)
    refuse_kind(document, "scenario")
    for key, value in {"flights": flights, "seed": seed}.items():
        if value is not None:
            document = document.replaced({(key,): value}, f"{key} {value}")
    try:
        keys = CampaignKeys.model_validate(document.data)
    except ValidationError as error:
        raise document.error(problems_of(error, _model_at)) from None
    if found := [*_find_not_flown(keys, build is not None)]:
        raise document.error(found)
    base, scenario = _read_scenario(document, keys, assignments, build or build_scenario)
    problems = [*_find_unknown_parts(keys, scenario), *_find_unsuited(keys, scenario, engine)]
    bags, missing = _find_bags(path, keys, recordings)
    problems += missing
    # paths with a star become one for each fault; schemes and observers are crossed
    given: dict[str, Any] = dict(keys)
    given |= {"name": keys.name or path.stem, "flights": keys.flights * max(len(bags), 1)}
    given |= {"vary": _expand_paths(keys, base, problems), "variants": _variants(keys, scenario)}
    flies_in_jax = keys.source.kind == "loop" and has_accelerator()
    given["engine"] = engine or (JAX if flies_in_jax else ENGINES[0])
    campaign = Campaign.model_construct(None, **given, document=document, base=base, recordings=bags)
    if campaign.cells > MAX_CELLS:
        problems.append(Problem(("vary",), f"{campaign.cells} combinations of grids: at most {MAX_CELLS}"))
    problems += wrong_checks(campaign.checks, [variant.name for variant in campaign.variants])
    if problems:
        raise document.error(problems)
    return campaign


def _find_unsuited(keys: CampaignKeys, scenario: Scenario, engine: str | None) -> Iterator[Problem]:
    """Yield what contradicts the source of the samples."""
    kind = keys.source.kind
    if engine == JAX and kind != "loop":
        yield Problem(("source", "kind"), f"{kind}: expected 'loop', which alone flies in JAX")
    if scenario.plant.flies and kind not in ("loop", SITL):
        said = f"{kind}: expected 'loop', as a free flight has no motion without its loop"
        yield Problem(("source", "kind"), said)


def _find_bags(
    path: Path, keys: CampaignKeys, recordings: Path | None
) -> tuple[tuple[Path, ...], list[Problem]]:
    """Return the bags of a campaign on recordings, and what is wrong if there are none."""
    if keys.source.kind != "recordings":
        told = f"{keys.source.kind!r}; expected 'recordings' for --recordings"
        return (), [Problem(("source", "kind"), told)] if recordings else []
    directory = recordings or path.parent / keys.source.directory
    is_named = bool(recordings or keys.source.directory)
    bags = bags_in(directory) if is_named else ()
    said = f"{directory}: holds no bag" if is_named else "no directory is named"
    wrong = Problem(("source", "directory"), f"{said}; expected rosbag2 bags (--recordings)")
    return bags, [] if bags else [wrong]


def _model_at(path: Keys) -> type[BaseModel]:
    models = {"checks": CampaignCheck, "tune": TuneKeys, "source": SourceKeys}
    return models.get(str(path[0]) if path else "", CampaignKeys)


def _expand_paths(keys: CampaignKeys, base: Document, problems: list[Problem]) -> dict[str, Distribution]:
    """Write out each path that varies: ``faults.*.value`` is one for each fault of the scenario."""
    expanded: dict[str, Distribution] = {}
    for key, drawn in keys.vary.items():
        first, star, rest = key.partition(".*")
        items = base.data.get(first)
        if not star:
            expanded[key] = drawn
        elif isinstance(items, list):
            count = len(cast("list[object]", items))
            expanded |= {f"{first}.{index}{rest}": drawn for index in range(count)}
        else:
            problems.append(Problem(("vary", key), f"'{first}' is no list of the scenario"))
    return expanded


def _read_scenario(
    document: Document, keys: CampaignKeys, assignments: Sequence[str], build: Callable[[Document], Scenario]
) -> tuple[Document, Scenario]:
    """Read the scenario that all flights are made of."""
    beside = Path(document.source).parent / keys.scenario
    is_file = beside.suffix in (".yaml", ".yml") and beside.is_file()
    try:
        path = beside if is_file else find_scenario(keys.scenario)
        base = changed_document(path, [*keys.set, *assignments], keys.gains)
        return base, build(base)
    except ScenarioError as error:
        raise document.error(Problem(("scenario",), each) for each in str(error).splitlines()) from None


def bags_in(directory: Path) -> tuple[Path, ...]:
    """Return the bags in a directory, or the directory if it is one; empty: there is none."""
    if (directory / "metadata.yaml").is_file():
        return (directory,)
    return tuple(sorted(path.parent for path in directory.glob("*/metadata.yaml")))


def _find_not_flown(keys: CampaignKeys, by_firmware: bool) -> Iterator[Problem]:
    """Yield what a firmware does not fly, or, unless ``by_firmware``, what nothing else does."""
    kind = keys.source.kind
    if (kind == SITL) != by_firmware:
        said = f"expected {SITL}, to fly a firmware" if by_firmware else "a firmware flies it: quadftc sitl"
        yield Problem(("source",), f"{kind}: {said}")
    elif by_firmware:
        for key in NOT_IN_SITL:
            if key in keys.model_fields_set:
                yield Problem((key,), f"does not go with 'source: {SITL}'")
        if keys.schemes == ALL or len(keys.schemes) > 1:
            yield Problem(("schemes",), "expected one, whose observer runs beside the firmware")


def _find_unknown_parts(keys: CampaignKeys, scenario: Scenario) -> Iterator[Problem]:
    for key, there in (("schemes", tuple(scenario.schemes)), ("observers", fault_observers.names())):
        given = getattr(keys, key)
        names = [] if given in (ALL, OTHERS) else list(given)
        for index, name in enumerate(names):
            if name not in there:
                yield Problem((key, index), f"no '{name}'; there are: {', '.join(there)}")
            elif name in names[:index]:
                yield Problem((key, index), f"'{name}' is given twice")


def _variants(keys: CampaignKeys, scenario: Scenario) -> tuple[Variant, ...]:
    """Schemes, crossed with observers where some are named."""
    given = list(scenario.schemes) if keys.schemes == ALL else keys.schemes
    schemes = [name for name in given if name in scenario.schemes] or [next(iter(scenario.schemes))]
    every = [name for name in fault_observers.names() if name != NO_OBSERVER]
    if keys.observers == OTHERS:  # the schemes as they are, and the first with what none of them has
        flown = {scenario.schemes[name].observer.kind for name in schemes}
        others = (Variant(name, schemes[0], name) for name in every if name not in flown)
        return (*(Variant(name, name) for name in schemes), *others)
    observers = every if keys.observers == ALL else keys.observers
    own_scheme = len(schemes) > 1 or keys.source.kind == "loop" or not observers
    return tuple(
        Variant("+".join(filter(None, (scheme if own_scheme else None, observer))), scheme, observer)
        for scheme in schemes
        for observer in observers or [None]
    )
