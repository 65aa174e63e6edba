"""The claims of section 4 of Wang, Huang, Zhang (2021), each with how it is judged (see `report.paper`).

The paper states hardly a number; where a claim needs a bound, it is ours, and the claim's criterion says so.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.metrics import SETTLED_ERROR_DEG, SETTLING_TIME
from quadftc_flight.run_directory import RecordedRun
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES
from quadftc_report.comparison import axis_metric
from quadftc_report.wording import listing, quantity, spread, worst_text

Floats = NDArray[np.float64]
Values = Mapping[str, float | None]  # by axis

SCENARIOS = ("paper_faults", "paper_constant_disturbance", "paper_varying_disturbance")
FAULTS, CONSTANT, VARYING = SCENARIOS
FAULT_TIMES = ((20.0, 40.0), (50.0, 70.0))  # s; section 4, all three axes
DISTURBANCE_ONSET = 5.0  # s; section 4, scenarios 1 and 2

TRACKING_DEG = 0.1  # deg; our bound for "follows the reference"
ROLL_RESPONSE_DEG = (-1.1, -0.9)  # deg; the paper's -1 deg, within 10 % (ours)
TRANSIENT = 2.0  # s; ours: after the onset of a disturbance, before its effect is measured
REMAINDER = 0.1  # ours: share of a disturbance that may be left in the error of its estimate

UNDISTURBED = (0.0, DISTURBANCE_ONSET)  # s
DISTURBED = (DISTURBANCE_ONSET + TRANSIENT, FAULT_TIMES[0][0])  # s; and no fault yet


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """The runs that a claim is judged on; ``others``: those of the paper's other scenarios, by name."""

    proposed: RecordedRun
    conventional: RecordedRun
    others: Mapping[str, Evidence] = dataclasses.field(default_factory=dict[str, Any])


class Finding(NamedTuple):
    """What the numbers say; ``holds`` None: they are missing."""

    holds: bool | None
    reason: str


class Claim(NamedTuple):
    """One statement of the paper.

    Parameters
    ----------
    key : str
    scenarios : tuple of str
        Names of the scenarios on which it is judged.
    place, text : str
        Where the paper says so, and what, in our words.
    criterion : str
        How it is judged, and whose the bounds are.
    judge : callable
        From the evidence to the finding.
    """

    key: str
    scenarios: tuple[str, ...]
    place: str
    text: str
    criterion: str
    judge: Callable[[Evidence], Finding]


def _known(values: Values) -> dict[str, float] | None:
    """The values if every axis has one."""
    found = {axis: value for axis, value in values.items() if value is not None}
    return found if len(found) == len(AXES) else None


def _rms(run: RecordedRun, columns: Floats, start: float, stop: float) -> Values:
    """Root mean square of columns (n, 3) from ``start`` to ``stop`` [s], by axis."""
    rows = columns[(run.flight.time >= start) & (run.flight.time < stop)]
    there: list[Floats] = [column[np.isfinite(column)] for column in rows.T]
    sizes = [float(np.sqrt(np.mean(column**2))) if len(column) else None for column in there]
    return dict(zip(AXES, sizes, strict=True))


def _ratios(over: Values, under: Values, scale: float = 1.0) -> dict[str, float] | None:
    """Ratios by axis; None if one is unknown."""
    above, below = _known(over), _known(under)
    if above is None or below is None or not all(below.values()):
        return None
    return {axis: scale * above[axis] / below[axis] for axis in AXES}


def _bounded(label: str, path: str, bound: float, largest: str, evidence: Evidence) -> Finding:
    """Compare a metric [deg] of every axis of the proposed run with an upper bound."""
    run = evidence.proposed
    values = _known(axis_metric(run, path))
    if values is None:
        return Finding(None, f"{label} of {run.name}: no value on one of the axes")
    holds = max(values.values()) < bound
    peak = worst_text(axis_metric(run, largest), "deg")
    against = f"{'below' if holds else 'NOT below'} {bound:g} deg"
    return Finding(
        holds, f"{label} at most {worst_text(values, 'deg')}, {against} (largest error at any moment {peak})"
    )


_faults_estimated = functools.partial(
    _bounded,
    "error of the settled estimate",
    "fault_estimate_max_settled_deg",
    SETTLED_ERROR_DEG,
    "fault_estimate_max_deg",
)
_proposed_tracks = functools.partial(
    _bounded, "tracking RMSE", "tracking_rmse_deg", TRACKING_DEG, "tracking_max_deg"
)


def _smaller(label: str, path: str, unit: str, evidence: Evidence) -> Finding:
    """Compare a metric of the proposed run with that of the conventional one, axis by axis."""
    ours, theirs = (_known(axis_metric(run, path)) for run in (evidence.proposed, evidence.conventional))
    if ours is None or theirs is None:
        return Finding(None, f"{label}: no value on one of the axes")
    reason = f"{label} {spread(ours, unit)} against {spread(theirs, unit)}"
    larger = [axis for axis in AXES if ours[axis] > theirs[axis]]
    return Finding(not larger, f"{reason}, larger on {listing(larger)}" if larger else reason)


_superior = functools.partial(_smaller, "tracking RMSE", "tracking_rmse_deg", "deg")
_no_chattering = functools.partial(
    _smaller, "total variation of the torque", "torque_total_variation", "N m/s"
)


def _follows_its_sensor(evidence: Evidence) -> Finding:
    run = evidence.conventional
    sizes: list[float] = []
    shares: list[float] = []
    for index, times in enumerate(FAULT_TIMES):
        values = axis_metric(run, f"fault_windows.{index}.tracking_rmse_deg")
        known, relative = _known(values), _ratios(values, _rms(run, np.degrees(run.flight.fault), *times))
        if known is None or relative is None:
            return Finding(None, f"{run.name}: no tracking error or no fault in a fault window")
        sizes += known.values()
        shares += relative.values()
    reason = (
        f"tracking RMSE {quantity(min(sizes), 'deg')} or more on every axis in both windows,"
        f" {quantity(min(shares), '')} to {quantity(max(shares), '')} times the RMS of the fault"
    )
    return Finding(min(sizes) > TRACKING_DEG, reason)


def _roll_reads_wrong(evidence: Evidence) -> Finding:
    run, flight = evidence.conventional, evidence.conventional.flight
    rows = (flight.time >= FAULT_TIMES[0][0]) & (flight.time < FAULT_TIMES[0][1])
    reference, fault = flight.reference[rows, 0], np.degrees(flight.fault[rows, 0])
    if np.any(reference != 0.0) or not np.allclose(fault, 1.0):
        return Finding(None, "roll is not to stay at zero under a fault of +1 deg, as it is in Figure 6")
    value = axis_metric(run, "fault_windows.0.tracking_mean_deg")["roll"]
    if value is None:
        return Finding(None, "the mean roll has no value")
    low, high = ROLL_RESPONSE_DEG
    reason = f"mean roll {quantity(value, 'deg')}; the reference is zero and the fault +1 deg"
    return Finding(low < value < high, reason)


def _leans_without_fault(evidence: Evidence) -> Finding:
    run = evidence.conventional
    error = np.degrees(np.asarray(wrap(run.flight.angles - run.flight.reference)))
    before, after = (_known(_rms(run, error, *times)) for times in (UNDISTURBED, DISTURBED))
    if before is None or after is None:
        return Finding(None, f"the tracking error of {run.name} was not recorded")
    holds = all(after[axis] > max(TRACKING_DEG, before[axis]) for axis in AXES)
    return Finding(
        holds, f"tracking RMSE {spread(after, 'deg')} from 7 to 20 s; before 5 s {spread(before, 'deg')}"
    )


def _disturbance_estimated(evidence: Evidence) -> Finding:
    run = evidence.proposed
    sizes = _rms(run, run.flight.disturbance, 0.0, math.inf)
    shares = _ratios(axis_metric(run, "disturbance_estimate_rmse"), sizes, 100.0)
    if shares is None:
        return Finding(None, f"{run.name}: no error of the disturbance estimate")
    reason = f"error of the disturbance estimate {spread(shares, '%')} of the disturbance, both RMS"
    return Finding(max(shares.values()) < 100.0 * REMAINDER, reason)


def _more_affected(evidence: Evidence) -> Finding:
    first = evidence.others.get(CONSTANT)
    if first is None:
        return Finding(None, "the runs of scenario 1 (paper_constant_disturbance) are not among these")
    runs = (first.conventional, evidence.conventional)
    one, two = (_known(axis_metric(run, "tracking_rmse_deg")) for run in runs)
    if one is None or two is None:
        return Finding(None, "a tracking RMSE has no value")
    more = [axis for axis in AXES if two[axis] > one[axis]]
    reason = f"tracking RMSE {spread(two, 'deg')}, in scenario 1 {spread(one, 'deg')}"
    if len(more) == len(AXES):
        return Finding(True, reason)
    sizes = [_rms(run, run.flight.disturbance, DISTURBANCE_ONSET, math.inf) for run in runs]
    share = _ratios(sizes[1], sizes[0], 100.0)
    return Finding(
        False,
        f"{reason}: {f'more on {listing(more)} only' if more else 'less on every axis'}. The paper does not"
        " say how large its disturbances are; the RMS of the varying one is here"
        f" {spread(share or {}, '%')} of that of the constant one",
    )


_OURS = "the bound is ours, as the paper gives none"
_TRACKED = f"Tracking RMSE below {TRACKING_DEG:g} deg on every axis; {_OURS}."

CLAIMS = (
    Claim(
        "faults_estimated",
        SCENARIOS,
        "section 4, Figures 3 to 5",
        "The faults of all three attitude sensors are estimated accurately, whatever the disturbances.",
        f"From {SETTLING_TIME:g} s after each onset and end of a fault on, the estimate is off by less than"
        f" {SETTLED_ERROR_DEG:g} deg; {_OURS}.",
        _faults_estimated,
    ),
    Claim(
        "conventional_follows_its_sensor",
        (FAULTS,),
        "section 4, Figures 6 to 8",
        "Without fault diagnosis the attitude cannot follow the reference while its sensor is faulty.",
        f"The compared control's tracking RMSE in each fault window is above {TRACKING_DEG:g} deg on every"
        f" axis; {_OURS}.",
        _follows_its_sensor,
    ),
    Claim(
        "roll_is_minus_one_degree",
        (FAULTS,),
        "section 4, Figure 6",
        "From 20 to 40 s the compared control holds a roll of -1 deg where the reference is zero.",
        "The mean roll in that window is -1 deg within 10 %; the tolerance is ours.",
        _roll_reads_wrong,
    ),
    Claim(
        "proposed_follows",
        (FAULTS,),
        "section 4, Figures 6 to 8",
        "With the fault estimate the vehicle follows the reference very well in spite of the faults.",
        _TRACKED,
        _proposed_tracks,
    ),
    Claim(
        "conventional_leans_without_fault",
        (CONSTANT,),
        "section 4, Figures 9 to 11",
        "Once the disturbance acts, the compared control has tracking errors even without a fault.",
        f"Its tracking RMSE from 7 to 20 s is above {TRACKING_DEG:g} deg, and above that before 5 s, on every"
        f" axis; {_OURS}.",
        _leans_without_fault,
    ),
    Claim(
        "disturbance_compensated",
        (CONSTANT,),
        "section 4, Figures 9 to 11",
        "The proposed control estimates the disturbance and compensates it.",
        f"The error of its estimate is below {100.0 * REMAINDER:g} % of the disturbance, both RMS, on every"
        f" axis; {_OURS}.",
        _disturbance_estimated,
    ),
    Claim(
        "tracking_maintained",
        (CONSTANT,),
        "section 4, Figures 9 to 11",
        "The proposed control keeps its tracking under faults and a constant disturbance together.",
        _TRACKED,
        _proposed_tracks,
    ),
    Claim(
        "conventional_more_affected",
        (VARYING,),
        "section 4, Figures 12 to 14",
        "The compared control is more affected by the varying disturbance than in scenario 1.",
        "Its tracking RMSE is larger than under the constant disturbance, on every axis; our measure.",
        _more_affected,
    ),
    Claim(
        "tracking_still_maintained",
        (VARYING,),
        "section 4, Figures 12 to 14",
        "Under a varying disturbance, too, the proposed control tracks satisfactorily.",
        _TRACKED,
        _proposed_tracks,
    ),
    Claim(
        "proposed_superior",
        SCENARIOS,
        "sections 4 and 5",
        "The proposed control is superior to the conventional one.",
        "Its tracking RMSE is not larger on any axis; the measure is ours.",
        _superior,
    ),
    Claim(
        "no_chattering",
        SCENARIOS,
        "abstract and section 5",
        "With the disturbance observer the control does without chattering.",
        "The total variation of its torque in a second is not larger than the conventional control's on any"
        " axis; the measure is ours.",
        _no_chattering,
    ),
)
