"""The claims of section 4 of Wang, Huang, Zhang (2021), each with how it is judged (see `report.paper`)."""

from __future__ import annotations

import math

import numpy as np

from quadftc_flight.metrics import SETTLED_ERROR_DEG, SETTLING_TIME
from quadftc_flight.run_directory import RecordedRun
from quadftc_model.samples import AXES
from quadftc_report.evidence import (
    CONSTANT,
    DISTURBANCE_ONSET,
    FAULT_TIMES,
    FAULTS,
    SCENARIOS,
    VARYING,
    Claim,
    Evidence,
    Finding,
    Number,
)
from quadftc_report.measures import (
    Values,
    axis_metric,
    complete,
    deviation_between,
    percent,
    ratios,
    rms_between,
    tracking_error_deg,
)
from quadftc_report.wording import listing, quantity, spread, worst_text

TRACKING_DEG = 0.1  # deg; our bound for "follows the reference"
ROLL_RESPONSE_DEG = (-1.1, -0.9)  # deg; the paper's -1 deg, within 10 % (ours)
TRANSIENT = 2.0  # s; ours: after the onset of a disturbance, before its effect is measured
REMAINDER = 0.1  # ours: share of a disturbance that may be left in the error of its estimate

UNDISTURBED = (0.0, DISTURBANCE_ONSET)  # s
DISTURBED = (DISTURBANCE_ONSET + TRANSIENT, FAULT_TIMES[0][0])  # s; and no fault yet


def _numbers(run: RecordedRun, label: str, values: Values, unit: str, path: str = "") -> tuple[Number, ...]:
    return tuple(
        Number(f"{label}, {axis}", value, unit, run.name, f"{path}.{axis}" if path else "")
        for axis, value in values.items()
    )


def _bounded(run: RecordedRun, label: str, path: str, bound: float, also: tuple[str, str]) -> Finding:
    """Hold a metric [deg] of every axis against an upper bound; a second one is told with it."""
    values, others = axis_metric(run, path), axis_metric(run, also[1])
    numbers = _numbers(run, label, values, "deg", path) + _numbers(run, also[0], others, "deg", also[1])
    known = complete(values)
    if known is None:
        return Finding(None, f"{label} of {run.name}: no value on one of the axes", numbers)
    holds = max(known.values()) < bound
    reason = (
        f"{label} at most {worst_text(known, 'deg')}, {'below' if holds else 'NOT below'} {bound:g} deg"
        f" ({also[0]} {worst_text(others, 'deg')})"
    )
    return Finding(holds, reason, numbers)


def _faults_estimated(evidence: Evidence) -> Finding:
    also = "largest error at any moment", "fault_estimate_max_deg"
    path = "fault_estimate_max_settled_deg"
    return _bounded(evidence.proposed, "error of the settled estimate", path, SETTLED_ERROR_DEG, also)


def _proposed_tracks(evidence: Evidence) -> Finding:
    also = "largest error at any moment", "tracking_max_deg"
    return _bounded(evidence.proposed, "tracking RMSE", "tracking_rmse_deg", TRACKING_DEG, also)


def _follows_its_sensor(evidence: Evidence) -> Finding:
    run = evidence.conventional
    numbers: tuple[Number, ...] = ()
    sizes: list[float] = []
    shares: list[float] = []
    for index, (start, stop) in enumerate(FAULT_TIMES):
        path = f"fault_windows.{index}.tracking_rmse_deg"
        values = axis_metric(run, path)
        numbers += _numbers(run, f"tracking RMSE in fault window {index + 1}", values, "deg", path)
        fault = rms_between(run.flight, np.degrees(run.flight.fault), start, stop)
        known, relative = complete(values), complete(ratios(values, fault))
        if known is None or relative is None:
            return Finding(None, f"{run.name}: no tracking error or no fault in a fault window", numbers)
        sizes += known.values()
        shares += relative.values()
    reason = (
        f"tracking RMSE {quantity(min(sizes), 'deg')} or more on every axis in both windows,"
        f" {quantity(min(shares), '')} to {quantity(max(shares), '')} times the RMS of the fault"
    )
    return Finding(min(sizes) > TRACKING_DEG, reason, numbers)


def _roll_reads_wrong(evidence: Evidence) -> Finding:
    run, path = evidence.conventional, "fault_windows.0.tracking_mean_deg"
    flight = run.flight
    rows = (flight.time >= FAULT_TIMES[0][0]) & (flight.time < FAULT_TIMES[0][1])
    reference, fault = flight.reference[rows, 0], np.degrees(flight.fault[rows, 0])
    if np.any(reference != 0.0) or not np.allclose(fault, 1.0):
        return Finding(None, "roll is not to stay at zero under a fault of +1 deg, as it is in Figure 6")
    value = axis_metric(run, path)["roll"]
    numbers = (Number("mean roll, its reference being zero", value, "deg", run.name, f"{path}.roll"),)
    if value is None:
        return Finding(None, "the mean roll has no value", numbers)
    low, high = ROLL_RESPONSE_DEG
    reason = f"mean roll {quantity(value, 'deg')}; the reference is zero and the fault +1 deg"
    return Finding(low < value < high, reason, numbers)


def _leans_without_fault(evidence: Evidence) -> Finding:
    run = evidence.conventional
    error = tracking_error_deg(run.flight)
    before, after = (rms_between(run.flight, error, *times) for times in (UNDISTURBED, DISTURBED))
    numbers = (
        *_numbers(run, "tracking RMSE before 5 s", before, "deg"),
        *_numbers(run, "tracking RMSE from 7 to 20 s", after, "deg"),
    )
    early, late = complete(before), complete(after)
    if early is None or late is None:
        return Finding(None, f"the tracking error of {run.name} was not recorded", numbers)
    holds = all(late[axis] > max(TRACKING_DEG, early[axis]) for axis in AXES)
    reason = f"tracking RMSE {spread(late, 'deg')} from 7 to 20 s; before 5 s {spread(early, 'deg')}"
    return Finding(holds, reason, numbers)


def _disturbance_estimated(evidence: Evidence) -> Finding:
    run, path = evidence.proposed, "disturbance_estimate_rmse"
    errors = axis_metric(run, path)
    sizes = rms_between(run.flight, run.flight.disturbance, 0.0, math.inf)
    numbers = (
        *_numbers(run, "error of the disturbance estimate, RMS", errors, "rad/s²", path),
        *_numbers(run, "disturbance, RMS", sizes, "rad/s²"),
    )
    shares = complete(ratios(errors, sizes))
    if shares is None:
        return Finding(None, f"{run.name}: no error of the disturbance estimate", numbers)
    reason = f"error of the disturbance estimate {_percent(shares)} of the disturbance, both RMS"
    return Finding(max(shares.values()) < REMAINDER, reason, numbers)


def _more_affected(evidence: Evidence) -> Finding:
    first = evidence.others.get(CONSTANT)
    if first is None:
        return Finding(None, "the runs of scenario 1 (paper_constant_disturbance) are not among these")
    path = "tracking_rmse_deg"
    runs = (first.conventional, evidence.conventional)
    found = [axis_metric(run, path) for run in runs]
    numbers = (
        *_numbers(runs[0], "tracking RMSE in scenario 1", found[0], "deg", path),
        *_numbers(runs[1], "tracking RMSE in scenario 2", found[1], "deg", path),
    )
    one, two = complete(found[0]), complete(found[1])
    if one is None or two is None:
        return Finding(None, "a tracking RMSE has no value", numbers)
    more = [axis for axis in AXES if two[axis] > one[axis]]
    reason = f"tracking RMSE {spread(two, 'deg')}, in scenario 1 {spread(one, 'deg')}"
    if len(more) == len(AXES):
        return Finding(True, reason, numbers)
    where = f"more on {listing(more)} only" if more else "less on every axis"
    return Finding(False, f"{reason}: {where}. {_why_less(*runs)}", numbers)


def _why_less(first: RecordedRun, second: RecordedRun) -> str:
    """Compare the two disturbances, whose sizes the paper does not give, and what they do without a fault."""
    flights = (first.flight, second.flight)
    sizes = [rms_between(flight, flight.disturbance, DISTURBANCE_ONSET, math.inf) for flight in flights]
    share = complete(ratios(sizes[1], sizes[0]))
    moving = [deviation_between(flight, tracking_error_deg(flight), *DISTURBED) for flight in flights]
    return (
        "The paper does not say how large its disturbances are; in these runs the RMS of the varying one is"
        f" {_percent(share or {})} of the constant one's. What it does more is move the vehicle: from 7 to"
        f" 20 s, without a fault, the standard deviation of the error is {spread(moving[1], 'deg')}, in"
        f" scenario 1 {spread(moving[0], 'deg')}"
    )


def _percent(shares: dict[str, float]) -> str:
    return spread(percent({**shares}), "%")


def _smaller(evidence: Evidence, label: str, path: str, unit: str) -> Finding:
    """Hold a metric of the proposed run against the conventional one's, axis by axis."""
    runs = (evidence.proposed, evidence.conventional)
    found = [axis_metric(run, path) for run in runs]
    numbers = tuple(
        number
        for run, values in zip(runs, found, strict=True)
        for number in _numbers(run, label, values, unit, path)
    )
    ours, theirs = complete(found[0]), complete(found[1])
    if ours is None or theirs is None:
        return Finding(None, f"{label}: no value on one of the axes", numbers)
    reason = f"{label} {spread(ours, unit)} against {spread(theirs, unit)}"
    larger = [axis for axis in AXES if ours[axis] > theirs[axis]]
    return Finding(not larger, f"{reason}, larger on {listing(larger)}" if larger else reason, numbers)


def _superior(evidence: Evidence) -> Finding:
    return _smaller(evidence, "tracking RMSE", "tracking_rmse_deg", "deg")


def _no_chattering(evidence: Evidence) -> Finding:
    return _smaller(evidence, "total variation of the torque", "torque_total_variation", "N m/s")


_OURS = "the bound is ours, as the paper gives none"
_TRACKED = f"Tracking RMSE below {TRACKING_DEG:g} deg on every axis; {_OURS}."

CLAIMS = (
    Claim(
        key="faults_estimated",
        scenarios=SCENARIOS,
        place="section 4, Figures 3 to 5",
        text="The faults of all three attitude sensors are estimated accurately, whatever the disturbances.",
        criterion=f"From {SETTLING_TIME:g} s after each onset and end of a fault on, the estimate is off by"
        f" less than {SETTLED_ERROR_DEG:g} deg; {_OURS}.",
        judge=_faults_estimated,
    ),
    Claim(
        key="conventional_follows_its_sensor",
        scenarios=(FAULTS,),
        place="section 4, Figures 6 to 8",
        text="Without fault diagnosis the attitude cannot follow the reference while its sensor is faulty.",
        criterion=f"The compared control's tracking RMSE in each fault window is above {TRACKING_DEG:g} deg"
        f" on every axis; {_OURS}.",
        judge=_follows_its_sensor,
    ),
    Claim(
        key="roll_is_minus_one_degree",
        scenarios=(FAULTS,),
        place="section 4, Figure 6",
        text="From 20 to 40 s the compared control holds a roll of -1 deg where the reference is zero.",
        criterion="The mean roll in that window is -1 deg within 10 %; the tolerance is ours.",
        judge=_roll_reads_wrong,
    ),
    Claim(
        key="proposed_follows",
        scenarios=(FAULTS,),
        place="section 4, Figures 6 to 8",
        text="With the fault estimate the vehicle follows the reference very well in spite of the faults.",
        criterion=_TRACKED,
        judge=_proposed_tracks,
    ),
    Claim(
        key="conventional_leans_without_fault",
        scenarios=(CONSTANT,),
        place="section 4, Figures 9 to 11",
        text="Once the disturbance acts, the compared control has tracking errors even without a fault.",
        criterion=f"Its tracking RMSE from 7 to 20 s is above {TRACKING_DEG:g} deg, and above that before"
        f" 5 s, on every axis; {_OURS}.",
        judge=_leans_without_fault,
    ),
    Claim(
        key="disturbance_compensated",
        scenarios=(CONSTANT,),
        place="section 4, Figures 9 to 11",
        text="The proposed control estimates the disturbance and compensates it.",
        criterion=f"The error of its estimate is below {100.0 * REMAINDER:g} % of the disturbance, both RMS,"
        f" on every axis; {_OURS}.",
        judge=_disturbance_estimated,
    ),
    Claim(
        key="tracking_maintained",
        scenarios=(CONSTANT,),
        place="section 4, Figures 9 to 11",
        text="The proposed control keeps its tracking under faults and a constant disturbance together.",
        criterion=_TRACKED,
        judge=_proposed_tracks,
    ),
    Claim(
        key="conventional_more_affected",
        scenarios=(VARYING,),
        place="section 4, Figures 12 to 14",
        text="The compared control is more affected by the varying disturbance than in scenario 1.",
        criterion="Its tracking RMSE is larger than under the constant disturbance, on every axis; the"
        " measure is ours.",
        judge=_more_affected,
    ),
    Claim(
        key="tracking_still_maintained",
        scenarios=(VARYING,),
        place="section 4, Figures 12 to 14",
        text="Under a varying disturbance, too, the proposed control tracks satisfactorily.",
        criterion=_TRACKED,
        judge=_proposed_tracks,
    ),
    Claim(
        key="proposed_superior",
        scenarios=SCENARIOS,
        place="sections 4 and 5",
        text="The proposed control is superior to the conventional one.",
        criterion="Its tracking RMSE is not larger on any axis; the measure is ours.",
        judge=_superior,
    ),
    Claim(
        key="no_chattering",
        scenarios=SCENARIOS,
        place="abstract and section 5",
        text="With the disturbance observer the control does without chattering.",
        criterion="The total variation of its torque in a second is not larger than the conventional"
        " control's on any axis; the measure is ours.",
        judge=_no_chattering,
    ),
)
