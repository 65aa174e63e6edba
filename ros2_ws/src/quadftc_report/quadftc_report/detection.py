"""What the runs of a comparison make of faults: found or missed, how soon, false alarms, who is blamed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, cast

from quadftc_flight.diagnosis_metrics import ESTIMATE_THRESHOLD_DEG, GRACE_TIME
from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import SideBySide, has_observer
from quadftc_report.measures import metric
from quadftc_report.wording import duration, listing, period, plain, sentence

ALL = "all"  # beside the kinds of faults: all of them
SHOWN = 6  # missed faults that are named


def detection_sentences(comparison: SideBySide[Recorded]) -> Iterator[str]:
    """How each run that has a fault observer detects, isolates and lets go."""
    for run in comparison.runs:
        found = metric(run, "diagnosis")
        if not has_observer(run) or not isinstance(found, dict):
            continue
        diagnosis = cast("dict[str, Any]", found)
        name = comparison.full_title(run)
        if diagnosis["total_false_alarm_share"] is None and not diagnosis["fault_count"]:
            yield f"Of {name} no fault state is known."
        elif not _declares(run):
            yield from _silent(diagnosis, name)
        else:
            yield from _faults(diagnosis, name)
            yield from _healthy(diagnosis)
            yield from _isolation(diagnosis)
            yield from _consistency(diagnosis)


def _declares(run: Recorded) -> bool:
    """Whether the run declares any axis faulty at any time."""
    shares = [event["declared_share"] for event in metric(run, "diagnosis")["events"]]
    return any(shares) or bool(metric(run, "diagnosis.total_false_alarms"))


def _silent(diagnosis: Mapping[str, Any], name: str) -> Iterator[str]:
    count = diagnosis["fault_count"]
    if not count:
        yield f"{name} declares no fault, and there is none."
        return
    yield f"{name} declares no fault at any time: by its fault states it misses {_all_of(count)}."
    by_estimate = diagnosis["by_estimate"]
    seen = count - (by_estimate["missed"] or 0) - (by_estimate["already_above"] or 0)
    delay = by_estimate["delay_max_s"].get(ALL)
    size = f"an estimate above {ESTIMATE_THRESHOLD_DEG:g} deg"
    told = f"it would show {seen} of {count} faults" + (
        f", within {duration(delay)} of the onset" if seen else ""
    )
    share = by_estimate["total_false_alarm_share"]
    price = "" if share is None else f", and call healthy axes faulty for {_percent(share)} of the time"
    yield f"Were {size} taken for a fault, {told}{price}."


def _faults(diagnosis: Mapping[str, Any], name: str) -> Iterator[str]:
    count, already = diagnosis["fault_count"], diagnosis["already_declared"]
    if count:
        missed = [_event(event) for event in diagnosis["events"] if event["detected"] is False]
        found = count - len(missed) - already
        yield f"{name} detects {_all_of(count) if found == count else f'{found} of {count} faults'}."
        if missed:
            yield f"It MISSES {_some(missed)}."
        if already:
            yield f"{_axes(already)} declared faulty before the onset already: no detection of that fault."
        delays = {
            kind: delay
            for kind, delay in diagnosis["delay_max_s"].items()
            if kind != ALL and delay is not None
        }
        if delays:
            told = [f"{duration(delay)} ({kind})" for kind, delay in delays.items()]
            yield sentence("the detection delay is at most", listing(told))
    else:
        yield f"{name} has no fault to detect."
    slowest = diagnosis["recovery_delay_max_s"].get(ALL)
    if slowest is not None:
        yield f"It trusts a sensor again at most {duration(slowest)} after the end of its fault."
    lost = [_event(event) for event in diagnosis["events"] if event["recovered"] is False]
    if lost:
        yield f"It does NOT trust the sensor again after {_some(lost)}."


def _healthy(diagnosis: Mapping[str, Any]) -> Iterator[str]:
    alarms, share = diagnosis["total_false_alarms"], diagnosis["total_false_alarm_share"]
    if share is None:
        return
    healthy = f"from {GRACE_TIME:g} s after a fault on" if diagnosis["fault_count"] else "at any time"
    if not alarms and not share:
        yield f"No healthy axis is declared faulty ({healthy})."
        return
    late = diagnosis["total_late_recovery_share"]
    raised = "no false alarm"
    if alarms:
        rate = plain(diagnosis["total_false_alarms_per_hour"])
        raised = f"{alarms} false alarm{'' if alarms == 1 else 's'}, {rate} an hour of healthy axis time"
    part = "all" if late == share else _percent(late / share) if share else ""
    remains = f", {part} of it left over from a fault" if late else ""
    yield f"It raises {raised}; healthy axes are declared faulty for {_percent(share)} of the time{remains}."


def _isolation(diagnosis: Mapping[str, Any]) -> Iterator[str]:
    share = diagnosis["isolation_accuracy"]
    if share is None:
        return
    if share == 1.0:
        yield "No healthy axis is blamed for the fault of another."
    else:
        yield f"A healthy axis is blamed for {_percent(1.0 - share)} of the time in which others are faulty."


def _consistency(diagnosis: Mapping[str, Any]) -> Iterator[str]:
    value, low, high = (diagnosis[name].get(ALL) for name in ("nees", "nees_low", "nees_high"))
    if value is None or low is None or high is None:
        return
    verdict = "as a consistent estimate has it"
    if value > high:
        verdict = "the standard deviations are too SMALL"
    elif value < low:
        verdict = "the standard deviations are too large"
    yield (
        f"The squared error over the variance that the observer gives (NEES) is {plain(value)} on the mean of"
        f" the faults, where {plain(low)} to {plain(high)} is to be expected: {verdict}."
    )


def _event(event: Mapping[str, Any]) -> str:
    return f"the {event['kind']} on {event['axis']} {period(event['start'], event['stop'])}"


def _some(names: list[str]) -> str:
    return listing(names if len(names) <= SHOWN else [*names[:SHOWN], f"{len(names) - SHOWN} more"])


def _all_of(count: int) -> str:
    return {1: "the only fault", 2: "both faults"}.get(count, f"all {count} faults")


def _axes(count: int) -> str:
    return "One axis was" if count == 1 else f"{count} times an axis was"


def _percent(share: float) -> str:
    return f"{plain(100.0 * share)} %"
