"""The runs of one scenario, side by side."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable

from quadftc_bench.recorded_run import RecordedRun
from quadftc_bench.scenario import Scenario
from quadftc_sim.sensors import ImuSensor

NO_OBSERVER = "none"  # kind of the fault observer that trusts its sensor


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """Runs that differ in nothing but their schemes.

    Parameters
    ----------
    scenario : Scenario
    runs : tuple of RecordedRun
        Those with a fault observer first, else in the order given.
    key : str
        Unique among the comparisons of a report, fit for a file's name; default: the scenario's name.
    """

    scenario: Scenario
    runs: tuple[RecordedRun, ...]
    key: str = ""

    def __post_init__(self) -> None:
        """Name it by its scenario, unless it has a name."""
        if not self.key:
            object.__setattr__(self, "key", self.scenario.name)

    @property
    def proposed(self) -> RecordedRun | None:
        """The first run with a fault observer."""
        return next((run for run in self.runs if has_observer(run)), None)

    @property
    def compared(self) -> tuple[RecordedRun, ...]:
        """All runs but the proposed one."""
        return tuple(run for run in self.runs if run is not self.proposed)

    @property
    def ideal(self) -> bool:
        """Whether the sensors are without noise, bias and delay, as in the paper."""
        return dataclasses.asdict(self.scenario.sensor) == dataclasses.asdict(ImuSensor())

    def label(self, run: RecordedRun) -> str:
        """What to call a run here: its scheme; its own name, if another run has the same scheme."""
        schemes = [each.scheme.name for each in self.runs]
        if schemes.count(run.scheme.name) == 1:
            return run.scheme.name
        names = [each.name for each in self.runs]
        if names.count(run.name) == 1:
            return run.name
        return f"{run.name} ({self.runs.index(run) + 1})"

    def title(self, run: RecordedRun) -> str:
        """What to call a run in a sentence: its label in quotation marks."""
        return f"'{self.label(run)}'"


def has_observer(run: RecordedRun) -> bool:
    """Whether a run's scheme estimates sensor faults."""
    return run.scheme.observer.kind != NO_OBSERVER


def compare(runs: Iterable[RecordedRun]) -> list[Comparison]:
    """Put runs together that have the scenario in common; schemes and description may differ."""
    groups: dict[str, list[RecordedRun]] = {}
    for run in runs:
        groups.setdefault(_identity(run.scenario), []).append(run)
    comparisons: list[Comparison] = []
    taken: dict[str, int] = {}
    for group in groups.values():
        scenario = group[0].scenario
        number = taken[scenario.name] = taken.get(scenario.name, 0) + 1
        key = scenario.name if number == 1 else f"{scenario.name}-{number}"
        ordered = sorted(group, key=lambda run: not has_observer(run))  # stable
        comparisons.append(Comparison(scenario, tuple(ordered), key))
    return comparisons


def _identity(scenario: Scenario) -> str:
    data = {key: value for key, value in scenario.raw.items() if key not in ("schemes", "description")}
    return json.dumps({**data, "name": scenario.name}, sort_keys=True)
