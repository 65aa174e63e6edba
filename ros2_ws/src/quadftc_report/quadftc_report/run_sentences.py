"""One sentence for each recording: who flew, and how it came out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from quadftc_flight.run_directory import RecordedRun
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import Comparison, axis_metric, has_observer, metric
from quadftc_report.wording import counted, duration, each_axis, listing, plain, sentence, worst_text

ALL = "all"  # beside the kinds of faults: all of them


def tell_run(comparison: Comparison[Recorded], run: Recorded) -> str:
    """Tell in one sentence what flew or observed, and how it came out, from the numbers of the summary."""
    parts = (_length(run), _tracking(run), _detection(run), _estimate(run), _checks(run))
    return sentence(f"{comparison.title(run)} ({_parts(run)})", "; ".join(part for part in parts if part))


class SensorVerdict(NamedTuple):
    """Whether fault tolerance pays off on real sensors: None where it does on some axes only."""

    better: bool | None
    text: str


def judge_on_real_sensors(comparison: Comparison[RecordedRun]) -> list[SensorVerdict]:
    """Compare the tracking of each run that has a fault observer with the first run that has none."""
    without = next((run for run in comparison.runs if not has_observer(run)), None)
    return [
        verdict
        for run in comparison.runs
        if without is not None and has_observer(run) and run.duration == without.duration
        for verdict in _against(comparison, run, without)
    ]


def _against(
    comparison: Comparison[RecordedRun], run: RecordedRun, without: RecordedRun
) -> Iterator[SensorVerdict]:
    path = "tracking_rmse_deg"
    found, other = axis_metric(run, path), axis_metric(without, path)
    pairs = {axis: (found[axis], other[axis]) for axis in AXES}
    worse = [axis for axis, (own, its) in pairs.items() if own is not None and its is not None and own > its]
    if None in found.values() or None in other.values():
        return
    better = None if 0 < len(worse) < len(AXES) else not worse
    how = {True: "better", False: "WORSE", None: f"worse on {listing(worse)}, better elsewhere,"}[better]
    yield SensorVerdict(
        better,
        f"{comparison.title(run)} tracks {how} than {comparison.title(without)}, which trusts its sensor.",
    )


def _parts(run: Recorded) -> str:
    if isinstance(run, RecordedRun):
        return f"{run.observer}, {run.disturbance_observer}, {run.scheme.controller.kind}"
    return f"fault observer {run.observer}"


def _length(run: Recorded) -> str:
    return "" if run.is_whole else f"was recorded for {duration(run.duration)} only"


def _tracking(run: Recorded) -> str:
    values = axis_metric(run, "tracking_rmse_deg")
    return f"tracks with an RMSE of {each_axis(values, 'deg')}" if any(values.values()) else ""


def _detection(run: Recorded) -> str:
    """Faults found, the slowest delay, false alarms; empty without fault states."""
    found: Any = metric(run, "diagnosis")
    if not has_observer(run) or not found or found["total_false_alarm_share"] is None:
        return "" if has_observer(run) else "has no fault observer"
    count, missed = found["fault_count"], found["missed"] or 0
    alarms = found["total_false_alarms"]
    raised = counted(alarms, "false alarm") if alarms else "no false alarm"
    if not count:
        return f"has no fault to detect and raises {raised}"
    slowest = found["delay_max_s"].get(ALL)
    if not any(event["declared_share"] for event in found["events"]) and not alarms:
        return f"declares none of {counted(count, 'fault')}"
    after = f", the slowest after {duration(slowest)}," if slowest is not None else ""
    hits = count - missed - (found["already_declared"] or 0)
    rate = f" ({plain(found['total_false_alarms_per_hour'])} an hour)" if alarms else ""
    return f"detects {hits} of {counted(count, 'fault')}{after} with {raised}{rate}"


def _estimate(run: Recorded) -> str:
    settled = axis_metric(run, "fault_estimate_max_settled_deg")
    if not has_observer(run) or all(value is None for value in settled.values()):
        return ""
    return f"estimates faults with a settled error of at most {worst_text(settled, 'deg')}"


def _checks(run: Recorded) -> str:
    checks = run.summary.get("checks")
    if not checks or not run.is_whole:
        return ""
    passed = sum(check["passed"] for check in checks)
    return f"passes {passed} of {counted(len(checks), 'check')}"
