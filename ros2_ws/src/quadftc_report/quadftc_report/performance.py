"""How well the runs of a comparison estimate and track, and with what effort, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadftc_flight.fault_schedule import FaultWindow
from quadftc_flight.metrics import SETTLED_ERROR_DEG, SETTLING_TIME
from quadftc_flight.run_directory import RecordedRun
from quadftc_report.comparison import Comparison, has_observer
from quadftc_report.measures import axis_metric, complete, mean_between, percent, ratios
from quadftc_report.wording import (
    axes_text,
    duration,
    each_axis,
    listing,
    period,
    plain,
    quantity,
    sentence,
    spread,
    worst_text,
)

ALIKE = 0.1  # relative; two sizes that differ by less are the same
SMALL_FAULT_DEG = 0.1  # deg; a mean fault below is not looked for in the tracking error


def estimate_sentences(comparison: Comparison) -> Iterator[str]:
    """How well each run estimates the fault of the attitude, and how soon after its onset."""
    for run in comparison.runs:
        name = comparison.title(run)
        largest = axis_metric(run, "fault_estimate_max_deg")
        if not has_observer(run):
            yield f"{name} has no fault observer: its controller takes the reading as it comes."
        elif not any(value is not None for value in largest.values()):
            yield f"Of {name} no error of the fault estimate is known."
        elif not any(window.start < run.duration for window in run.scenario.fault_windows):
            words = "takes the healthy attitude for faulty by at most"
            yield sentence(f"{name} ({run.scheme.observer.kind})", words, spread(largest, "deg"))
        else:
            yield from _estimate(run, name)
            yield sentence("at any moment its error is at most", worst_text(largest, "deg"))
            yield from _settling(run)


def tracking_sentences(comparison: Comparison) -> Iterator[str]:
    """How well each run follows the reference: all told, against the first, and under faults."""
    for run in comparison.runs:
        rmse, largest = axis_metric(run, "tracking_rmse_deg"), axis_metric(run, "tracking_max_deg")
        yield (
            f"{comparison.title(run)} follows the reference with an RMSE of {each_axis(rmse, 'deg')};"
            f" its largest error is {worst_text(largest, 'deg')}."
        )
    first = comparison.runs[0]
    for other in comparison.runs[1:]:
        if first.duration == other.duration:
            yield compared_text(comparison, first, other)
    for index, window in enumerate(comparison.scenario.fault_windows):
        yield from _in_window(comparison, index, window)


def effort_sentences(comparison: Comparison) -> Iterator[str]:
    """How much torque each run commands, how it chatters, and whether the actuators' limits cut it."""
    told: dict[str, list[str]] = {"torque_total_variation": [], "torque_rms": [], "saturation_share": []}
    units = {"torque_total_variation": "N m/s", "torque_rms": "N m", "saturation_share": "%"}
    for run in comparison.runs:
        for path, unit in units.items():
            values = axis_metric(run, path)
            values = percent(values) if unit == "%" else values
            if complete(values) is not None and (unit != "%" or any(values.values())):
                told[path].append(f"{each_axis(values, unit)} with {comparison.title(run)}")
    if not told["torque_rms"]:
        yield "No torque was recorded."
        return
    if told["torque_total_variation"]:
        total = listing(told["torque_total_variation"])
        yield f"The torque command varies by {total} (total variation, a measure of chattering)."
    yield f"The RMS of the command is {listing(told['torque_rms'])}."
    cut = listing(told["saturation_share"])
    yield (
        f"The actuators' limits cut {cut} of the samples." if cut else "The actuators' limits cut no sample."
    )


def compared_text(comparison: Comparison, first: RecordedRun, other: RecordedRun) -> str:
    """Say which of two runs has the smaller tracking RMSE on which axis, and by what factor."""
    path = "tracking_rmse_deg"
    factors = complete(ratios(axis_metric(other, path), axis_metric(first, path)))
    if factors is None or not all(factors.values()):
        return ""
    names = comparison.title(first), comparison.title(other)
    larger = {axis: factor for axis, factor in factors.items() if factor > 1.0 + ALIKE}
    smaller = {axis: 1.0 / factor for axis, factor in factors.items() if factor < 1.0 / (1.0 + ALIKE)}
    alike = [axis for axis in factors if axis not in larger and axis not in smaller]
    parts = [
        f"the RMSE of {big} is {_times(some)} that of {small}{_on(some, factors)}"
        for big, small, some in ((names[1], names[0], larger), (names[0], names[1], smaller))
        if some
    ]
    if alike:
        parts.append(
            f"{axes_text(alike)} those of {' and '.join(names)} differ by less than {100 * ALIKE:g} %"
        )
    return sentence("; ".join(parts))


def _estimate(run: RecordedRun, name: str) -> Iterator[str]:
    settled = axis_metric(run, "fault_estimate_max_settled_deg")
    known = complete(settled)
    verdict = ""
    if known is not None:
        factor = max(known.values()) / SETTLED_ERROR_DEG
        limit = f"the {SETTLED_ERROR_DEG:g} deg that count as settled"
        verdict = f", within {limit}" if factor < 1.0 else f": it FAILS, being {plain(factor)} times {limit}"
    yield (
        f"{name} ({run.scheme.observer.kind}) is wrong about the fault by at most {spread(settled, 'deg')}"
        f" from {SETTLING_TIME:g} s after each onset and each end of a fault on{verdict}."
    )


def _settling(run: RecordedRun) -> Iterator[str]:
    """How long after each onset the estimate needs, on the axes that are faulty."""
    slowest = (-1.0, "")
    never: list[str] = []
    for index, window in enumerate(run.scenario.fault_windows):
        path, when = f"fault_windows.{index}", period(window.start, window.stop)
        times = axis_metric(run, f"{path}.fault_estimate_settling_s")
        errors = axis_metric(run, f"{path}.fault_estimate_max_deg")
        axes = [axis for axis in window.axes if errors[axis] is not None]
        reached = {axis: time for axis in axes if (time := times[axis]) is not None}
        slowest = max([slowest, *((time, f"{axis}, {when}") for axis, time in reached.items())])
        if len(reached) < len(axes):
            never.append(f"on {listing([axis for axis in axes if axis not in reached])} {when}")
    if slowest[1]:
        where = "where it settles at all, this takes at most" if never else "it settles within"
        yield sentence(where, f"{duration(slowest[0])} of the onset ({slowest[1]})")
    if never:
        yield f"It does not settle within {SETTLED_ERROR_DEG:g} deg {listing(never)}."


def _in_window(comparison: Comparison, index: int, window: FaultWindow) -> Iterator[str]:
    when = period(window.start, window.stop)
    told: list[str] = []
    for run in comparison.runs:
        rmse = axis_metric(run, f"fault_windows.{index}.tracking_rmse_deg")
        if run.duration >= window.stop and complete(rmse) is not None:
            told.append(f"{spread(rmse, 'deg')} with {comparison.title(run)}")
    if told:
        yield sentence(f"under the faults {when} the RMSE is", listing(told))
    for run in comparison.runs:
        same = [] if has_observer(run) else _fault_in_motion(run, index, window)
        if same:
            yield (
                f"There {comparison.title(run)} follows its sensor: its mean error is the mean fault with the"
                f" sign turned, {listing(same)}."
            )


def _fault_in_motion(run: RecordedRun, index: int, window: FaultWindow) -> list[str]:
    """The axes on which the mean tracking error is the mean fault with its sign turned."""
    errors = axis_metric(run, f"fault_windows.{index}.tracking_mean_deg")
    faults = mean_between(run.flight, np.degrees(run.flight.fault), window.start, window.stop)
    return [
        f"{quantity(error, 'deg')} ({axis}) for {quantity(mean, 'deg')}"
        for axis, error in errors.items()
        if error is not None
        and (mean := faults[axis]) is not None
        and abs(mean) > SMALL_FAULT_DEG
        and abs(error + mean) < ALIKE * abs(mean)
    ]


def _times(factors: dict[str, float]) -> str:
    low, high = plain(min(factors.values())), plain(max(factors.values()))
    return f"{high} times" if low == high else f"{low} to {high} times"


def _on(some: dict[str, float], every: dict[str, float]) -> str:
    return "" if len(some) == len(every) else f" {axes_text(list(some))}"
