"""The recordings that stand side by side, the runs of one scenario or the replays of one recording.

What they have in common, what was injected, and one sentence on each.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import re
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from typing import Any, Generic, TypeVar, cast

import numpy as np

from quadftc_flight.fault_schedule import attitude_events
from quadftc_flight.live_run import LiveRun
from quadftc_flight.metrics import look_up
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.summary import NO_OBSERVER
from quadftc_model.parameters import parameters_of
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_report.wording import counted, duration, each_axis, listing, period, plain
from quadftc_sim.injection import CHANNEL_UNITS
from quadftc_sim.sensors import ImuSensor

Run_co = TypeVar("Run_co", bound=Recorded, covariant=True)
Run = TypeVar("Run", bound=Recorded)
Injection = tuple[str, str, str]  # when, where, what


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
        own = [each.own_name for each in self.runs]
        placed = [f"{each.path.parent.name}/{each.own_name}" for each in self.runs]  # where they were written
        for labels in ([each.label for each in self.runs], own, placed):
            label = labels[self.runs.index(run)]
            if labels.count(label) == 1:
                return label
        return f"{run.own_name} ({self.runs.index(run) + 1})"


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
    groups: dict[tuple[str, Hashable], list[Run]] = {}
    for run in runs:
        groups.setdefault(_identity(run), []).append(run)
    comparisons, keys = list[Comparison[Run]](), set(taken)
    for (name, _), group in groups.items():
        names = itertools.chain([name], (f"{name}-{number}" for number in itertools.count(2)))
        key = next(each for each in names if each not in keys)
        ordered = sorted(group, key=lambda run: not has_observer(run))  # stable
        comparisons.append(Comparison(tuple(ordered), key))
        keys.add(key)
    return comparisons


def _identity(run: Recorded) -> tuple[str, Hashable]:
    """A name, and all that the runs have in common; a first stamp tells recordings of one name apart."""
    if isinstance(run, RecordedReplay):
        origin, first_ns = run.origin, int(run.flight.stamp_ns[0])
        size, faults = (origin.samples, origin.duration), tuple(origin.faults)
        name = "replay-" + re.sub(r"[^A-Za-z0-9_-]+", "_", origin.recording)
        return name, (origin.recording, origin.topic, first_ns, *size, faults, origin.seed)
    flown = {**run.scenario.raw, "name": run.scenario.name, "schemes": None, "description": None}
    return run.scenario.name, json.dumps(flown, sort_keys=True)


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
        faults, alarms = counted(found["fault_count"], "fault"), found["total_false_alarms"]
        hits = found["fault_count"] - (found["missed"] or 0) - (found["already_declared"] or 0)
        detects = f"detects {hits} of {faults} with {counted(alarms, 'false alarm')}"
        declares = alarms or any(event["declared_share"] for event in found["events"])
        if not found["fault_count"]:
            detects = f"raises {counted(alarms, 'false alarm')} of the attitude"
        said.append(detects if declares or not found["fault_count"] else f"declares none of {faults}")
    if metric(run, "lost"):
        said.append("LOSES the vehicle")
    if ratio := _error_ratio(comparison, run):
        said.append(f"is off by at most {plain(ratio)} times as much as without a diagnosis")
    checks = run.summary.get("checks")
    if checks and run.is_whole:
        passed = sum(check["passed"] for check in checks)
        said.append(f"passes {passed} of {counted(len(checks), 'check')}")
    label = comparison.label(run)
    parts = "" if isinstance(run, RecordedReplay) and label == run.observer else f" ({parts_of(run)})"
    return f"'{label}'{parts} {'; '.join(said)}."


def _error_ratio(comparison: Comparison[Recorded], run: Recorded) -> float | None:
    """Largest attitude error over that of the run without a fault observer, if all else is the same."""
    if not has_observer(run):
        return None
    runs = [run, *(each for each in comparison.runs if not has_observer(each))]
    alike = [each for each in runs if each.is_whole and controls(each) == controls(run)]
    errors = [metric(each, "attitude_error_max_deg") for each in alike[:2]]
    return errors[0] / errors[1] if len(errors) == 2 and all(errors) else None


def controls(run: Recorded) -> tuple[str | None, ...]:
    """Name the disturbance observer and the controller of a run."""
    return run.summary.get("disturbance_observer"), run.summary.get("controller")


def list_injections(run: Recorded) -> list[Injection]:
    """Return the faults and disturbances that begin before the recording ends: when, where, what.

    Faults of the attitude outside the schedule come last: those of a recording, those injected by hand.
    """
    end, lines = run.duration, list[Injection]()
    faults = sorted(run.faults, key=lambda fault: fault.injection.start)
    for fault in (fault for fault in faults if fault.injection.start < end):
        injection = fault.injection
        whole = not fault.rotors and (injection.law.whole_channel or len(fault.axes) == len(AXES))
        elements = "all axes" if whole else listing(fault.rotors or fault.axes)
        where = f"{injection.channel}: {elements}"
        units = CHANNEL_UNITS[injection.channel]
        what = _describe(injection.kind, injection.law, fault.given, fault.axes, units)
        lines.append((_when(injection, end), where, what))
    for part in (part for part in run.disturbances if part.law.start < end):
        lines.append((_when(part.law, end), "torque", _describe(part.kind, part.law, part.given, AXES, {})))
    scheduled = {(fault.injection.start, axis) for fault in faults for axis in fault.axes}
    stray = np.ones(len(run.flight), np.bool_)
    for event in attitude_events(run.fault_events):
        stray &= (run.flight.time < event.start) | (run.flight.time >= event.stop)
        if event.start < end and (event.start, event.axis) not in scheduled:
            lines.append((_when(event, end), f"attitude: {event.axis}", f"{event.kind}, in the recording"))
    sizes = np.abs(run.flight.fault[stray])
    largest = math.degrees(np.max(sizes, initial=0.0, where=np.isfinite(sizes)))
    if largest > 1e-6:
        lines.append(("outside the schedule", "attitude", f"up to {plain(largest)} deg"))
    if isinstance(run, LiveRun):
        other = [event for event in run.fault_events if event.component != "attitude"]
        lines += [
            (_when(event, end), f"{event.component}: {event.axis}", f"{event.kind}, in the recording")
            for event in (*other, *run.rotor_events)
        ]
        lines += [(f"at {each.time:.2f} s", "setpoint", each.text) for each in run.setpoints]
    return lines


def _when(part: Any, end: float) -> str:
    return period(part.start, math.inf if part.stop >= end else part.stop)


def _describe(
    kind: str, law: object, given: Sequence[str], axes: Sequence[str], units: Mapping[str, str]
) -> str:
    """``bias: value 1 deg``; ``sine: amplitude 2 deg, frequency 0.6 rad/s``."""
    texts: list[str] = []
    for spec in parameters_of(law.__class__):
        if spec.name in given and spec.name not in ("start", "stop"):
            unit = spec.unit.format(**units) if units else spec.unit
            angle = "{" in spec.unit and unit.startswith("rad")  # frequencies stay in rad/s
            scale = math.degrees(1.0) if angle else 1.0
            unit = unit.replace("rad", "deg", 1) if angle else unit.removesuffix("1")
            value = _value(getattr(law, spec.name), scale, axes)
            texts.append(f"{spec.name.replace('_', ' ')} {value} {unit}".rstrip())
    return ": ".join(filter(None, [kind, ", ".join(texts)]))


def _value(value: object, scale: float, axes: Sequence[str]) -> str:
    if isinstance(value, tuple):
        given = zip(AXES, cast("tuple[float, ...]", value), strict=True)
        numbers = [plain(scale * number) for axis, number in given if axis in axes]
        return numbers[0] if len(set(numbers)) == 1 else f"({', '.join(numbers)})"
    return plain(scale * value) if isinstance(value, (int, float)) else str(value)
