"""One fault of a flight: was it found, how soon, how well estimated, and was the sensor trusted again."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from quadftc_flight.diagnosis_metrics.columns import Columns, Floats, Mask
from quadftc_flight.diagnosis_metrics.statistics import (
    consistency_band,
    finite,
    independent_samples,
    largest,
    mean,
    number,
    rms,
)
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_model.samples import AXES

ESTIMATE_THRESHOLD_DEG = 0.3  # deg; an estimate of this size says fault: 3 sigma of the attitude of mems
COVERAGE_SIGMAS = 2.0  # standard deviations; 95.4 % of the errors of a consistent estimate are within


class Found(NamedTuple):
    """When a detector says fault; all None where it cannot be judged."""

    detected: bool | None  # in some sample of the fault
    already: bool | None  # in the last sample before it: this is no detection of this fault
    time: float | None  # of the first sample that says so [s]; None: missed, or said already


def fault_record(columns: Columns, event: FaultEvent, following: float) -> dict[str, Any]:
    """Judge the diagnosis of one fault, ready for JSON.

    Parameters
    ----------
    columns : Columns
    event : FaultEvent
    following : float
        When the next fault of the axis begins [s]; infinite: there is none.

    Returns
    -------
    dict
        ``detected`` is None where there is nothing to detect: the flight ends before, the state is not known,
        or the fault leaves the reading as it is (a channel that is absent, a scale factor of zero).
    """
    axis = AXES.index(event.axis)
    rows = columns.rows(event.start, event.stop)
    sized = has_size(columns, event)
    known, estimate = columns.known[:, axis], columns.estimate[:, axis]
    by_state = find(columns.time, known, columns.declared[:, axis], event, sized)
    above = np.abs(estimate) >= ESTIMATE_THRESHOLD_DEG  # false for NaN
    by_estimate = find(columns.time, np.isfinite(estimate), above, event, sized)
    return {
        **event._asdict(),
        "fault_max_deg": largest(columns.fault[rows, axis]),
        "detected": by_state.detected,
        "already_declared": by_state.already,
        "detection_delay_s": _since(by_state.time, event.start),
        "onset_error_s": _onset_error(columns, axis, by_state.time, event.start),
        **_while_faulty(columns, axis, rows),
        **_recovery(columns, axis, event, following, by_state),
        "above_threshold": by_estimate.detected,
        "above_threshold_already": by_estimate.already,
        "above_threshold_delay_s": _since(by_estimate.time, event.start),
        **_accuracy(columns, axis, rows),
        "tracking_rmse_deg": rms(columns.tracking[rows, axis]),
    }


def find(time: Floats, known: Mask, says: Mask, event: FaultEvent, sized: bool) -> Found:
    """Find the first known sample of an event in which a detector says fault (n,)."""
    inside = known & (event.start <= time) & (time < event.stop)
    if not sized or not inside.any():
        return Found(None, None, None)
    before = np.flatnonzero(known & (time < event.start))
    already = bool(len(before) and says[before[-1]])
    hits = np.flatnonzero(inside & says)
    return Found(bool(len(hits)), already, float(time[hits[0]]) if len(hits) and not already else None)


def has_size(columns: Columns, event: FaultEvent) -> bool:
    """Whether a fault changes the reading; where the truth was not recorded at all, the schedule counts."""
    fault = columns.fault[:, AXES.index(event.axis)]
    inside = finite(fault[columns.rows(event.start, event.stop)])
    return bool(np.any(inside != 0.0)) if len(inside) else not np.isfinite(fault).any()


def _since(moment: float | None, start: float) -> float | None:
    return None if moment is None else number(moment - start)


def _onset_error(columns: Columns, axis: int, detection: float | None, start: float) -> float | None:
    """Onset as it is said at the detection, less the true one [s]."""
    if detection is None:
        return None
    row = int(np.searchsorted(columns.time, detection))
    return number(columns.onset[row, axis] - start)


def _while_faulty(columns: Columns, axis: int, rows: slice) -> dict[str, Any]:
    """Whether the declaration stands while the fault does, and whether healthy axes are blamed."""
    said = columns.declared[rows, axis][columns.known[rows, axis]]
    if not len(said):
        return {"declared_share": None, "declarations": None}
    begins = int(said[0]) + int(np.sum(said[1:] & ~said[:-1]))
    return {"declared_share": number(np.mean(said)), "declarations": begins}


def _recovery(
    columns: Columns, axis: int, event: FaultEvent, following: float, found: Found
) -> dict[str, Any]:
    """When the sensor is trusted again, after a fault that was found."""
    rows = columns.rows(event.stop, following)
    known = columns.known[rows, axis]
    if not found.detected or not known.any():
        return {"recovered": None, "recovery_delay_s": None}
    hits = np.flatnonzero(columns.trusted[rows, axis] & known)
    moment = float(columns.time[rows][hits[0]]) if len(hits) else None
    return {"recovered": moment is not None, "recovery_delay_s": _since(moment, event.stop)}


def _accuracy(columns: Columns, axis: int, rows: slice) -> dict[str, Any]:
    """Errors of the estimate during the whole fault, and (*detected*) while the axis is declared faulty."""
    error = columns.error[rows, axis]
    declared = columns.declared[rows, axis]
    normalised = finite(columns.normalised[rows, axis][declared])
    return {
        "estimate_rmse_deg": rms(error),
        "estimate_bias_deg": mean(error),
        "estimate_max_deg": largest(error),
        "estimate_rmse_detected_deg": rms(error[declared]),
        "estimate_max_detected_deg": largest(error[declared]),
        **_consistency(normalised),
    }


def _consistency(normalised: Floats) -> dict[str, Any]:
    """NEES with its band, and how often the error is within two standard deviations."""
    if not len(normalised):
        return dict.fromkeys(("nees", "nees_samples", "nees_low", "nees_high", "coverage_2_sigma"))
    samples = independent_samples(normalised)
    low, high = consistency_band(samples)
    return {
        "nees": number(np.mean(normalised**2)),
        "nees_samples": number(samples),
        "nees_low": number(low),
        "nees_high": number(high),
        "coverage_2_sigma": number(np.mean(np.abs(normalised) <= COVERAGE_SIGMAS)),
    }
