"""The diagnosis of one flight judged: each fault, and the healthy time.

A row stands for the median time between two. Rows without a state do not count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from quadftc_flight.diagnosis_metrics.columns import (
    Columns,
    Floats,
    Mask,
    Metrics,
    Record,
    consistency_band,
    finite,
    independent_samples,
    largest,
    mean,
    number,
    rms,
)
from quadftc_flight.diagnosis_metrics.fault_statistics import ALARMS, fault_metrics, with_shares
from quadftc_flight.diagnosis_metrics.which_sensor import GRACE_TIME
from quadftc_flight.fault_schedule import FaultEvent, attitude_events
from quadftc_flight.flight import Flight
from quadftc_model.samples import AXES, STARTING

if TYPE_CHECKING:
    from jaxtyping import Bool

COVERAGE_SIGMAS = 2.0  # standard deviations; 95.4 % of the errors of a consistent estimate are within

T = TypeVar("T")


class Detection(NamedTuple):
    """When a detector says fault; all None where it cannot be judged."""

    detected: bool | None = None  # in some sample of the fault
    already: bool | None = None  # in the last sample before it: this is no detection of this fault
    row: int | None = None  # of the first sample that says so; None: missed, or said already


def diagnosis_metrics(flight: Flight, events: Sequence[FaultEvent]) -> Metrics:
    """Judge the diagnosis of the attitude, ready for JSON; of one axis, no event overlaps another.

    The metrics of all faults have a value for each kind of fault and for ``all``; those of healthy time have
    one for each axis.
    """
    columns, events = Columns(flight), attitude_events(events)
    records = [_judge_fault(columns, event, events) for event in events]
    healthy = _healthy(columns, events)
    alarms = [_alarms(columns, healthy, axis) for axis in range(len(AXES))]
    counts = np.sum(flight.fault_state == STARTING, axis=0), np.sum(columns.known, axis=0)
    shares = [int(part) / int(whole) if whole else None for part, whole in zip(*counts, strict=True)]
    return {
        **fault_metrics(records),
        **with_shares(_by_axis(ALARMS, alarms)),
        "longest_false_alarm_s": {
            name: _longest_alarm(columns, healthy, axis) for axis, name in enumerate(AXES)
        },
        "starting_share": dict(zip(AXES, shares, strict=True)),
        "events": records,
    }


def _has_size(columns: Columns, event: FaultEvent) -> bool:
    """Return whether a fault changes the reading; where the truth was not recorded, the schedule counts."""
    fault = columns.fault[:, AXES.index(event.axis)]
    inside = finite(fault[columns.rows(event.start, event.stop)])
    return bool(np.any(inside != 0.0)) if len(inside) else not np.isfinite(fault).any()


def _healthy(columns: Columns, events: Sequence[FaultEvent]) -> Bool[Mask, "n 3"]:
    """Which axes are healthy: neither faulty nor in the grace after a fault."""
    doubtful = np.zeros((len(columns.time), len(AXES)), np.bool_)
    for event in events:
        doubtful[columns.rows(event.start, event.stop + GRACE_TIME), AXES.index(event.axis)] = True
    return ~doubtful


def _judge_fault(columns: Columns, event: FaultEvent, events: Sequence[FaultEvent]) -> Record:
    """Judge one fault; ``detected`` is None where there is nothing to detect.

    That is: the flight ends before, the state is not known, or the fault leaves the reading as it is.
    """
    axis, rows = AXES.index(event.axis), columns.rows(event.start, event.stop)
    sized = _has_size(columns, event)
    known, declared = columns.known[:, axis], columns.declared[:, axis]
    by_state = _detect(known, declared, rows, sized)
    said = declared[rows][known[rows]]
    begins = int(said[0]) + int(np.sum(said[1:] & ~said[:-1])) if len(said) else None
    onset = None if by_state.row is None else number(columns.onset[by_state.row, axis] - event.start)
    # the sensor may be trusted again until the next fault of its axis begins
    starts = [other.start for other in events if other.axis == event.axis and other.start >= event.stop]
    after = columns.rows(event.stop, min(starts, default=math.inf))
    grace = columns.rows(event.stop, min([*starts, event.stop + GRACE_TIME]))
    still = np.flatnonzero(declared[grace])
    trusted = _first(columns.trusted[:, axis] & known, after)
    can_recover = by_state.detected and known[after].any()
    return {
        **event._asdict(),
        "fault_max_deg": largest(columns.fault[rows, axis]),
        "detected": by_state.detected,
        "already_declared": by_state.already,
        "detection_delay_s": _delay(columns, by_state.row, event.start),
        "onset_error_s": onset,
        "declared_share": mean(said),
        "declarations": begins,
        "recovered": trusted is not None if can_recover else None,
        "recovery_delay_s": _delay(columns, trusted, event.stop) if can_recover else None,
        "declared_after_s": number((still[-1] + 1) * columns.period) if len(still) else 0.0,
        **_estimate_errors(columns, axis, rows),
        "tracking_rmse_deg": rms(columns.tracking[rows, axis]),
    }


def _detect(known: Mask, says: Mask, rows: slice, sized: bool) -> Detection:
    """Find the first known sample of a fault in which a detector says fault (n,)."""
    if not sized or not known[rows].any():
        return Detection()
    before, row = np.flatnonzero(known[: rows.start]), _first(known & says, rows)
    already = bool(len(before) and says[before[-1]])
    return Detection(row is not None, already, None if already else row)


def _first(mask: Mask, rows: slice) -> int | None:
    hits = np.flatnonzero(mask[rows])
    return rows.start + int(hits[0]) if len(hits) else None


def _delay(columns: Columns, row: int | None, start: float) -> float | None:
    return None if row is None else number(columns.time[row] - start)


def _estimate_errors(columns: Columns, axis: int, rows: slice) -> Record:
    """Errors of the estimate during the whole fault, and (*detected*) while the axis is declared faulty."""
    error, declared = columns.error[rows, axis], columns.declared[rows, axis]
    return {
        "estimate_rmse_deg": rms(error),
        "estimate_bias_deg": mean(error),
        "estimate_max_deg": largest(error),
        "estimate_rmse_detected_deg": rms(error[declared]),
        "estimate_max_detected_deg": largest(error[declared]),
        **_consistency(finite(columns.normalised[rows, axis][declared])),
    }


def _consistency(normalised: Floats) -> Record:
    """NEES with its band, and how often the error is within two standard deviations."""
    names = ("nees", "nees_samples", "nees_low", "nees_high", "coverage_2_sigma")
    if not len(normalised):
        return dict.fromkeys(names)
    samples = independent_samples(normalised)
    share = np.mean(np.abs(normalised) <= COVERAGE_SIGMAS)
    values = (np.mean(normalised**2), samples, *consistency_band(samples), share)
    return dict(zip(names, map(number, values), strict=True))


def _alarms(columns: Columns, is_healthy: Mask, axis: int) -> tuple[float | None, ...]:
    """What the states say of an axis that is healthy: ``ALARMS``, with what is left over from faults."""
    known = columns.known[:, axis]
    if not known.any():
        return (None,) * len(ALARMS)
    declared, healthy = columns.declared[known, axis], is_healthy[known, axis]
    begins = declared & ~np.concatenate([[False], declared[:-1]])
    # whether the last declaration before or at a row began in healthy time
    last_begin = np.maximum.accumulate(np.where(begins, np.arange(len(begins)), 0))
    wrong = declared & healthy
    left_over = wrong & ~healthy[last_begin]
    false_alarms = int(np.sum(begins & healthy))
    return _seconds(columns, healthy), false_alarms, _seconds(columns, wrong), _seconds(columns, left_over)


def _longest_alarm(columns: Columns, is_healthy: Mask, axis: int) -> float | None:
    """Return for how long an axis that is healthy is declared without a break, at most [s]."""
    known = columns.known[:, axis]
    wrong = (columns.declared & is_healthy)[known, axis]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wrong, [False]])))
    lengths = np.diff(edges)[::2]  # from each begin to its end
    return number(np.max(lengths, initial=0) * columns.period) if known.any() else None


def _by_axis(names: Sequence[str], values: Sequence[Sequence[T]]) -> dict[str, dict[str, T]]:
    """Turn the metrics of each axis into the axes of each metric."""
    columns = zip(*values, strict=True)
    return {name: dict(zip(AXES, column, strict=True)) for name, column in zip(names, columns, strict=True)}


def _seconds(columns: Columns, mask: Mask) -> float | None:
    """Time of the rows of a mask [s]."""
    return number(np.sum(mask) * columns.period)
