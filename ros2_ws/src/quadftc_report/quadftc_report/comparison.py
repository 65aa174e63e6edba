"""The recordings that stand side by side: the runs of one scenario, the replays of one recording."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Collection, Iterable
from typing import Any, Generic, TypeVar, cast

from quadftc_flight.metrics import look_up
from quadftc_flight.run_directory import NO_OBSERVER, RecordedRun
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_sim.sensors import ImuSensor

Run_co = TypeVar("Run_co", bound=Recorded, covariant=True)
Run = TypeVar("Run", bound=Recorded)


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison(Generic[Run_co]):
    """Recordings that differ only in their schemes or observers; they share figures and tables.

    Parameters
    ----------
    runs : tuple of Recorded
        Those with a fault observer first, else in the order given.
    key : str
        Unique in a report, fit for a file's name.
    """

    runs: tuple[Run_co, ...]
    key: str

    @property
    def proposed(self) -> Run_co | None:
        """The first with a fault observer."""
        return next((run for run in self.runs if has_observer(run)), None)

    @property
    def compared(self) -> tuple[Run_co, ...]:
        """All but the proposed one."""
        return tuple(run for run in self.runs if run is not self.proposed)

    @property
    def longest(self) -> Run_co:
        """The recording with the most samples."""
        return max(self.runs, key=lambda run: len(run.flight))

    def label(self, run: Recorded) -> str:
        """Name a recording by its scheme or observer, or by its own name if another has the same."""
        if [each.label for each in self.runs].count(run.label) == 1:
            return run.label
        if [each.own_name for each in self.runs].count(run.own_name) == 1:
            return run.own_name
        place = next(index for index, each in enumerate(self.runs) if each is run)
        return f"{run.own_name} ({place + 1})"

    def title(self, run: Recorded) -> str:
        """Name a recording in a sentence: its label in quotation marks."""
        return f"'{self.label(run)}'"


def has_observer(run: Recorded) -> bool:
    """Whether the run estimates sensor faults."""
    return run.observer != NO_OBSERVER


def is_ideal(comparison: Comparison[RecordedRun]) -> bool:
    """Whether the sensors are without noise, bias and delay, as in the paper."""
    return dataclasses.asdict(comparison.runs[0].scenario.sensor) == dataclasses.asdict(ImuSensor())


def compare(runs: Iterable[Run], taken: Collection[str] = ()) -> list[Comparison[Run]]:
    """Group runs by scenario, and replays by recording and overlaid faults; ``taken``: keys in use."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(_identity(run), []).append(run)
    comparisons: list[Comparison[Run]] = []
    keys = set(taken)
    for group in groups.values():
        key = name = _name(group[0])
        number = 1
        while key in keys:
            number += 1
            key = f"{name}-{number}"
        ordered = sorted(group, key=lambda run: not has_observer(run))  # stable
        comparisons.append(Comparison(tuple(ordered), key))
        keys.add(key)
    return comparisons


def metric(run: Recorded, path: str) -> Any:
    """Return the metric at a dotted path of ``summary["metrics"]``, or None."""
    try:
        return look_up(run.summary["metrics"], path)
    except KeyError:
        return None


def axis_metric(run: Recorded, path: str) -> dict[str, float | None]:
    """Return the metric of each axis at a dotted path."""
    found = metric(run, path)
    values = cast("dict[str, Any]", found) if isinstance(found, dict) else {}
    return {axis: values.get(axis) for axis in AXES}


def _name(run: Recorded) -> str:
    if isinstance(run, RecordedReplay):
        return "replay-" + re.sub(r"[^A-Za-z0-9_-]+", "_", run.origin.recording)
    return run.scenario.name


def _identity(run: Recorded) -> str:
    """All that the runs of a comparison have in common; a first stamp tells recordings of one name apart."""
    if isinstance(run, RecordedReplay):
        origin = run.origin
        first_ns, faults = int(run.flight.stamp_ns[0]), [fault.spec for fault in origin.faults]
        same = [
            origin.recording,
            origin.topic,
            first_ns,
            origin.samples,
            origin.duration,
            faults,
            origin.seed,
        ]
        return json.dumps(same)
    scenario = run.scenario
    data = {key: value for key, value in scenario.raw.items() if key not in ("schemes", "description")}
    return json.dumps({**data, "name": scenario.name}, sort_keys=True)
