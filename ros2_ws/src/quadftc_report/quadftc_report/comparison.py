"""What is put side by side: the runs of one scenario, the replays of one recording."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Collection, Iterable
from typing import Generic, TypeVar

from quadftc_flight.run_directory import NO_OBSERVER, RecordedRun
from quadftc_flight.scenario import Scenario
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_sim.sensors import ImuSensor

Item_co = TypeVar("Item_co", bound=Recorded, covariant=True)
Run = TypeVar("Run", bound=Recorded)


class SideBySide(Generic[Item_co]):
    """Recordings of one course of events, which go into the same figures and tables."""

    runs: tuple[Item_co, ...]  # those with a fault observer first, else in the order given
    key: str  # unique in a report, fit for a file's name

    @property
    def proposed(self) -> Item_co | None:
        """The first with a fault observer."""
        return next((run for run in self.runs if has_observer(run)), None)

    @property
    def compared(self) -> tuple[Item_co, ...]:
        """All but the proposed one."""
        return tuple(run for run in self.runs if run is not self.proposed)

    def label(self, run: Recorded) -> str:
        """What to call a recording here: its scheme or observer; its own name, if another has the same."""
        labels = [each.label for each in self.runs]
        if labels.count(run.label) == 1:
            return run.label
        names = [each.own_name for each in self.runs]
        if names.count(run.own_name) == 1:
            return run.own_name
        place = next(index for index, each in enumerate(self.runs) if each is run)
        return f"{run.own_name} ({place + 1})"

    def title(self, run: Recorded) -> str:
        """What to call a recording in a sentence: its label in quotation marks."""
        return f"'{self.label(run)}'"

    def full_title(self, run: Recorded) -> str:
        """What to call a recording where its observer matters: with the observer, if the label is another."""
        title = self.title(run)
        return title if self.label(run) == run.observer else f"{title} ({run.observer})"


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison(SideBySide[RecordedRun]):
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
    def ideal(self) -> bool:
        """Whether the sensors are without noise, bias and delay, as in the paper."""
        return dataclasses.asdict(self.scenario.sensor) == dataclasses.asdict(ImuSensor())


@dataclasses.dataclass(frozen=True, eq=False)
class ReplayComparison(SideBySide[RecordedReplay]):
    """Replays of the same samples with the same faults, which differ in nothing but their observers.

    Parameters
    ----------
    runs : tuple of RecordedReplay
        Those with a fault observer first, else in the order given.
    key : str
        Unique in a report, fit for a file's name.
    """

    runs: tuple[RecordedReplay, ...]
    key: str

    @property
    def recording(self) -> str:
        """Name of the recording."""
        return self.runs[0].origin.recording

    @property
    def longest(self) -> RecordedReplay:
        """The replay of which most was recorded."""
        return max(self.runs, key=lambda run: len(run.flight))


def has_observer(run: Recorded) -> bool:
    """Whether sensor faults are estimated at all."""
    return run.observer != NO_OBSERVER


def compare(runs: Iterable[RecordedRun]) -> list[Comparison]:
    """Put runs together that have the scenario in common; schemes and description may differ."""
    comparisons: list[Comparison] = []
    keys: set[str] = set()
    for group in _grouped(runs, lambda run: _identity(run.scenario)):
        key = _unique(group[0].scenario.name, keys)
        comparisons.append(Comparison(group[0].scenario, group, key))
        keys.add(key)
    return comparisons


def compare_replays(replays: Iterable[RecordedReplay], taken: Collection[str] = ()) -> list[ReplayComparison]:
    """Put replays together that have the recording and the overlaid faults in common.

    Parameters
    ----------
    replays : iterable of RecordedReplay
    taken : collection of str
        Keys that are taken in this report.
    """
    comparisons: list[ReplayComparison] = []
    keys = set(taken)
    for group in _grouped(replays, _samples):
        name = re.sub(r"[^A-Za-z0-9_-]+", "_", group[0].origin.recording)
        key = _unique(f"replay-{name}", keys)
        comparisons.append(ReplayComparison(group, key))
        keys.add(key)
    return comparisons


def _grouped(runs: Iterable[Run], identity: Callable[[Run], str]) -> list[tuple[Run, ...]]:
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(identity(run), []).append(run)
    ordered = (sorted(group, key=lambda run: not has_observer(run)) for group in groups.values())  # stable
    return [tuple(group) for group in ordered]


def _unique(name: str, taken: Collection[str]) -> str:
    number = 1
    key = name
    while key in taken:
        number += 1
        key = f"{name}-{number}"
    return key


def _identity(scenario: Scenario) -> str:
    data = {key: value for key, value in scenario.raw.items() if key not in ("schemes", "description")}
    return json.dumps({**data, "name": scenario.name}, sort_keys=True)


def _samples(replay: RecordedReplay) -> str:
    """What was replayed, but for the observer; the first stamp tells recordings of one name apart."""
    origin = replay.origin
    faults = [fault.spec for fault in origin.faults]
    first_ns = int(replay.flight.stamp_ns[0])
    return json.dumps(
        [origin.recording, origin.topic, first_ns, origin.samples, origin.duration, faults, origin.seed]
    )
