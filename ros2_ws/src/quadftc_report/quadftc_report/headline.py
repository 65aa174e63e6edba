"""The verdict on a comparison: one sentence, and the picture that shows it best.

The sentence is about the recording with a diagnosis that came out best, beside the same flight without one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_flight.loss import command_up_to_loss, loss_story
from quadftc_flight.run_directory import SCENARIO
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_report.comparison import Comparison, axis_metric, controls, has_observer, metric
from quadftc_report.description import Figure
from quadftc_report.figures import flight_figures, replay_figures
from quadftc_report.wording import SMALLEST, counted, duration, short

KEY = "verdict"  # of the picture


class Headline(NamedTuple):
    """What to say of a comparison first."""

    sentence: str
    is_good: bool  # nothing lost, no check failed
    contrast: float  # error without a diagnosis over that with it; 0: nothing to compare with
    shown: Comparison[Any]  # the recordings that the picture shows
    again: str  # the command that flies it up to its loss; empty if it is not lost

    def picture(self) -> Figure | None:
        """Return the figure of the axis with the largest error, or None if there is none."""
        first = self.shown.runs[0]
        is_replay = isinstance(first, RecordedReplay)
        figures = (replay_figures if is_replay else flight_figures)(self.shown)
        sizes = "fault_max_deg" if is_replay else "tracking_max_deg"
        worst = max(
            AXES, key=lambda axis: max(metric(run, f"{sizes}.{axis}") or 0.0 for run in self.shown.runs)
        )
        wanted = (f"attitude-{worst}", f"tracking-{worst}")
        chosen = [each for each in figures if each.key.endswith(wanted)] or figures[:1]
        return dataclasses.replace(chosen[0], key=KEY) if chosen else None


def headline(comparison: Comparison[Recorded]) -> Headline:
    """Judge the recordings of one scenario or of one IMU."""
    observing = [run for run in comparison.runs if has_observer(run)]
    best = min(
        observing or comparison.runs,
        key=lambda run: (not run.is_whole, bool(metric(run, "lost")), _error(run)),
    )
    plain = _without_diagnosis(best, comparison.runs)
    said = [_found(best), _held(best)] if has_observer(best) else [_held(best), "has no diagnosis"]
    parts = [f"{comparison.label(best)} {' and '.join(each for each in said if each)}"]
    if plain is not None:
        bare = "the vehicle is lost" if metric(plain, "lost") else _degrees(_error(plain))
        parts.append(f"without diagnosis {bare}")
    failed = 0
    for run in comparison.runs:
        checks = run.summary.get("checks") or () if run.is_whole else ()
        if failing := sum(not check["passed"] for check in checks):
            parts.append(f"{comparison.label(run)}: {failing} of {counted(len(checks), 'check')} FAILED")
        failed += failing
    errors = [_error(run) for run in (best, plain) if run is not None]
    contrast = errors[1] / errors[0] if len(errors) == 2 and 0.0 < errors[0] < math.inf else 0.0
    shown = dataclasses.replace(comparison, runs=(best,) if plain is None else (best, plain))
    is_lost = bool(metric(best, "lost"))
    again = _command_for(best) if is_lost else ""
    return Headline(f"{'; '.join(parts)}.", not failed and not is_lost, contrast, shown, again)


def _command_for(run: Recorded) -> str:
    """Return the command that flies a lost run up to its loss; empty if its scenario is not beside it."""
    if isinstance(run, RecordedReplay) or not (run.path / SCENARIO).is_file():
        return ""
    return command_up_to_loss(run.flight, run.path, run.label)


def _without_diagnosis(best: Recorded, runs: Sequence[Recorded]) -> Recorded | None:
    """The run without a fault observer: with the same controller, if there is one."""
    others = (run for run in runs if run is not best and not has_observer(run) and run.is_whole)
    known = [run for run in others if metric(run, "lost") or _error(run) < math.inf]
    return min(known, key=lambda run: controls(run) != controls(best), default=None)


def _error(run: Recorded) -> float:
    """Largest error of the attitude [deg]: of the vehicle, or of what a replay made of the reading."""
    values = axis_metric(run, "fault_estimate_max_deg").values()
    values = list(values) if isinstance(run, RecordedReplay) else [metric(run, "attitude_error_max_deg")]
    return max((each for each in values if each is not None), default=math.inf)


def _found(run: Recorded) -> str:
    """What became of the faults: ``names all 4 faults, 12 ms at the median``."""
    parts: list[Metrics] = [metric(run, name) or {} for name in ("sensors", "rotors", "diagnosis")]
    sensors, rotors, diagnosis = parts
    said: list[str] = []
    if any(event["named_share"] for event in sensors.get("events", ())):
        count, unnamed = sensors["sensor_faults"]["all"], sensors["unnamed"]["all"]
        said.append(_hits("names", "fault", count, unnamed, sensors["naming_delay_median_s"]["all"]))
    elif any(event["declared_share"] for event in diagnosis.get("events", ())):
        missed = (diagnosis["missed"] or 0) + (diagnosis["already_declared"] or 0)
        said.append(
            _hits("detects", "fault", diagnosis["fault_count"], missed, diagnosis["delay_median_s"]["all"])
        )
    elif count := diagnosis.get("fault_count"):
        settled = [each for each in axis_metric(run, "fault_estimate_max_settled_deg").values() if each]
        error = f"within {_degrees(max(settled))}" if settled else "not at all"
        said.append(f"estimates {counted(count, 'fault')} {error} (declares none)")
    if count := rotors.get("rotor_faults"):
        said.append(_hits("names", "weak rotor", count, rotors["unnamed"], rotors["naming_delay_median_s"]))
    if alarms := diagnosis.get("total_false_alarms"):
        said.append(f"gives {counted(alarms, 'false alarm')}")
    return ", ".join(said) or "declares no fault"


def _hits(verb: str, thing: str, count: int, missed: int | None, delay: float | None) -> str:
    hits = count - (missed or 0)
    many = f"{hits} of {counted(count, thing)}" if hits < count else f"all {count} {thing}s"
    many = f"the {thing}" if hits == count == 1 else many
    when = "" if delay is None or not hits else f" after {duration(delay)}"
    return f"{verb} {many}{when}{' (median)' if when and hits > 1 else ''}"


def _degrees(angle: float) -> str:
    return f"{short(max(angle, SMALLEST))} deg"


def _held(run: Recorded) -> str:
    """How well the vehicle flew; of a replay, how well its attitude is known."""
    if metric(run, "lost"):
        return f"LOSES the vehicle ({loss_story(run.flight)})"
    if isinstance(run, RecordedReplay):
        size = max(each or 0.0 for each in axis_metric(run, "fault_max_deg").values())
        return f"is off by {_degrees(_error(run))} at most, under faults of up to {_degrees(size)}"
    place = metric(run, "position_max_m")
    where = f", the position within {short(place)} m" if place is not None else ""
    return f"holds the attitude within {_degrees(_error(run))}{where}" if _error(run) < math.inf else ""
