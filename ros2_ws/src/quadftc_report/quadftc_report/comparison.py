"""The recordings that stand side by side: the runs of one scenario, the replays of one recording."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Collection, Hashable, Iterable
from typing import Any, Generic, TypeVar

from quadftc_flight.metrics import look_up
from quadftc_flight.run_directory import NO_OBSERVER, RecordedRun
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_report.wording import counted, duration, each_axis
from quadftc_sim.sensors import ImuSensor

Run_co = TypeVar("Run_co", bound=Recorded, covariant=True)
Run = TypeVar("Run", bound=Recorded)


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison(Generic[Run_co]):
    """Recordings that differ only in their schemes or observers; they share figures and tables."""

    runs: tuple[Run_co, ...]  # those with a fault observer first, else in the order given
    key: str  # unique in a report, fit for a file's name

    @property
    def proposed(self) -> Run_co | None:
        """The first with a fault observer."""
        return next((run for run in self.runs if has_observer(run)), None)

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


def has_observer(run: Recorded) -> bool:
    """Whether the run estimates sensor faults."""
    return run.observer != NO_OBSERVER


def parts_of(run: Recorded) -> str:
    """Name the observers and the controller of a run; of a replay, its fault observer."""
    if isinstance(run, RecordedReplay):
        return f"fault observer {run.observer}"
    return f"{run.observer}, {run.disturbance_observer}, {run.scheme.controller.kind}"


def is_ideal(comparison: Comparison[RecordedRun]) -> bool:
    """Whether the sensors are without noise, bias and delay, as in the paper."""
    return dataclasses.asdict(comparison.runs[0].scenario.sensor) == dataclasses.asdict(ImuSensor())


def compare(runs: Iterable[Run], taken: Collection[str] = ()) -> list[Comparison[Run]]:
    """Group runs by scenario, and replays by recording and overlaid faults; ``taken``: keys in use."""
    groups: dict[Hashable, list[Run]] = {}
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


def _name(run: Recorded) -> str:
    if isinstance(run, RecordedReplay):
        return "replay-" + re.sub(r"[^A-Za-z0-9_-]+", "_", run.origin.recording)
    return run.scenario.name


def _identity(run: Recorded) -> Hashable:
    """All that the runs of a comparison have in common; a first stamp tells recordings of one name apart."""
    if isinstance(run, RecordedReplay):
        origin, first_ns = run.origin, int(run.flight.stamp_ns[0])
        faults = tuple(origin.faults)
        size = origin.samples, origin.duration
        return origin.recording, origin.topic, first_ns, *size, faults, origin.seed
    scenario = run.scenario
    data = {key: value for key, value in scenario.raw.items() if key not in ("schemes", "description")}
    return json.dumps({**data, "name": scenario.name}, sort_keys=True)


def metric(run: Recorded, path: str) -> Any:
    """Return the metric at a dotted path of ``summary["metrics"]``, or None."""
    try:
        return look_up(run.summary["metrics"], path)
    except KeyError:
        return None


def axis_metric(run: Recorded, path: str) -> dict[str, float | None]:
    """Return the metric of each axis at a dotted path."""
    return {axis: metric(run, f"{path}.{axis}") for axis in AXES}


def tell_run(comparison: Comparison[Recorded], run: Recorded) -> str:
    """Tell in one sentence who flew or observed, and how it came out, from the numbers of the summary."""
    said = [] if run.is_whole else [f"was recorded for {duration(run.duration)} only"]
    tracking = axis_metric(run, "tracking_rmse_deg").values()
    if any(tracking):
        said.append(f"tracks with an RMSE of {each_axis(tracking, 'deg')}")
    found = metric(run, "diagnosis")
    if not has_observer(run):
        said.append("has no fault observer")
    elif found and found["total_false_alarms"] is not None:
        hits = found["fault_count"] - (found["missed"] or 0) - (found["already_declared"] or 0)
        alarms = counted(found["total_false_alarms"], "false alarm")
        said.append(f"detects {hits} of {counted(found['fault_count'], 'fault')} with {alarms}")
    checks = run.summary.get("checks")
    if checks and run.is_whole:
        passed = sum(check["passed"] for check in checks)
        said.append(f"passes {passed} of {counted(len(checks), 'check')}")
    return f"'{comparison.label(run)}' ({parts_of(run)}) {'; '.join(said)}."
