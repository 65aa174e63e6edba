"""The claims of section 4 of B. Wang, P. Huang, W. Zhang, A Robust Fault-Tolerant Control for Quadrotor
Helicopters against Sensor Faults and External Disturbances, Complexity, 2021, and the verdicts on them.

Claims are judged on runs in the paper's conditions alone (`_run_pair`). The paper states hardly a number;
where a claim needs a bound, it is ours, and the claim's criterion says so.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from quadftc_flight.metrics import SETTLED_ERROR_DEG, SETTLING_TIME
from quadftc_flight.run_directory import RecordedRun
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES
from quadftc_report import DATA
from quadftc_report.comparison import Comparison, axis_metric, is_ideal
from quadftc_report.wording import each_axis, short

Floats = NDArray[np.float64]
Among = Sequence[Comparison[RecordedRun]]  # all comparisons of a report: some claims compare scenarios
Verdict = tuple[bool, str]  # whether a claim holds, and the numbers

FAULTS, CONSTANT, VARYING = "paper_faults", "paper_constant_disturbance", "paper_varying_disturbance"
PAPER_SCENARIOS = (FAULTS, CONSTANT, VARYING)
VEHICLE = ("qball_x4", False, {1.0})  # section 2; whether its motors lag, factors of its inertia
PROPOSED = ("sliding_mode", "exosystem", "ismc")  # observer, disturbance observer, controller of the paper
CONVENTIONAL = ("none", "none", "smc")  # and of what it compares with
FAULT_TIMES = ((20.0, 40.0), (50.0, 70.0))  # s; section 4, all three axes
DISTURBANCE_ONSET = 5.0  # s; section 4, scenarios 1 and 2
STEADY = 1e-3  # relative; a torque that varies by less is constant

TRACKING_DEG = 0.1  # deg; our bound for "follows the reference"
ROLL_RESPONSE_DEG = (-1.1, -0.9)  # deg; the paper's -1 deg, within 10 % (ours)
DISTURBED = (7.0, 20.0)  # s; from 2 s (ours) after the onset of a disturbance to the first fault
REMAINDER = 0.1  # ours: share of a disturbance that may be left in the error of its estimate


class NoVerdictError(Exception):
    """The runs give no verdict; one line that says why."""


class RunPair(NamedTuple):
    """The runs that a claim is judged on."""

    proposed: RecordedRun
    conventional: RecordedRun


class Claim(NamedTuple):
    """One statement of the paper, in our words, and the criterion; ``data/claims.yaml`` has them all."""

    key: str
    scenarios: list[str]  # names of those on which it is judged
    place: str  # in the paper
    text: str
    criterion: str


class Judgement(NamedTuple):
    """A claim, whether it holds (None: the runs cannot say), and the reason."""

    claim: Claim
    holds: bool | None
    reason: str


def judge(comparison: Comparison[RecordedRun], among: Among = ()) -> list[Judgement]:
    """Judge the paper's claims on one scenario by its runs; there are none on other scenarios."""

    def judge_claim(claim: Claim) -> Judgement:
        try:
            return Judgement(claim, *JUDGES[claim.key](_run_pair(comparison), among))
        except NoVerdictError as why:
            return Judgement(claim, None, str(why))

    return [judge_claim(each) for each in CLAIMS if comparison.runs[0].scenario.name in each.scenarios]


def _run_pair(comparison: Comparison[RecordedRun]) -> RunPair:
    """The runs to judge on, if they were flown in the paper's conditions."""
    scenario, plant = comparison.runs[0].scenario, comparison.runs[0].scenario.plant
    vehicle = (scenario.vehicle, plant.motor_lag, set(plant.inertia_factor))
    windows = {(window.start, window.stop): window.axes for window in scenario.fault_windows}
    runs = {
        (run.observer, run.disturbance_observer, run.scheme.controller.kind): run
        for run in reversed(comparison.runs)
    }
    needed = {
        "the sensors are not ideal, as they are in the paper": is_ideal(comparison),
        "the vehicle is not the paper's, a Qball-X4 whose motors follow at once": vehicle == VEHICLE,
        "the faults are not where the paper has them: all axes, from 20 to 40 s and from 50 to 70 s": (
            windows == dict.fromkeys(FAULT_TIMES, AXES)
        ),
        "no run with the paper's observers and controller is among these": PROPOSED in runs,
        "no run with the conventional control (sliding mode, no observers) is among these": (
            CONVENTIONAL in runs
        ),
    }
    if problems := [problem for problem, fulfilled in needed.items() if not fulfilled]:
        raise NoVerdictError(problems[0])
    pair = RunPair(runs[PROPOSED], runs[CONVENTIONAL])
    for run in pair:
        if not run.is_whole:
            whole = f"{scenario.duration:g} s"
            raise NoVerdictError(f"{run.name} was recorded for {run.duration:.1f} s of {whole} only")
        _require_disturbance(run)
    return pair


def _require_disturbance(run: RecordedRun) -> None:
    """Refuse a run whose recorded disturbance is not that of the scenario's name."""
    name, flight = run.scenario.name, run.flight
    known = np.isfinite(flight.disturbance).all(axis=1)
    early = np.abs(flight.disturbance[known & (flight.time < DISTURBANCE_ONSET)])
    late = flight.disturbance[known & (flight.time >= DISTURBANCE_ONSET)]
    if not len(early) or not len(late):
        raise NoVerdictError(f"the disturbance of {run.name} was not recorded")
    largest = np.abs(late).max(axis=0)
    if early.max() > 0.0:
        raise NoVerdictError(f"in {run.name} a disturbance acts before 5 s")
    if name == FAULTS and largest.any():
        raise NoVerdictError(f"in {run.name} a disturbance acts, in Figures 6 to 8 none")
    varies = np.ptp(late, axis=0) > STEADY * largest
    if name != FAULTS and not (largest.all() and np.all(varies == (name == VARYING))):
        kind = "varying" if name == VARYING else "constant"
        raise NoVerdictError(f"in {run.name} the disturbance is not {kind} on every axis")


def _metric(run: RecordedRun, path: str) -> Floats:
    """A metric of every axis (3,)."""
    values = list(axis_metric(run, path).values())
    if None in values:
        raise NoVerdictError(f"{run.name}: {path} has no value on one of the axes")
    return np.array(values, np.float64)


def _rms(run: RecordedRun, columns: Floats, start: float, stop: float = math.inf) -> Floats:
    """Root mean square (3,) of columns (n, 3) from ``start`` to ``stop`` [s], to compare with: not zero."""
    rows = columns[(run.flight.time >= start) & (run.flight.time < stop)]
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not rows.any(axis=0).all():
        raise NoVerdictError(f"{run.name}: nothing to compare with was recorded from {start:g} s on")
    return np.sqrt(np.mean(rows**2, axis=0))


def _is_bounded(label: str, path: str, bound: float, pair: RunPair, _: Among) -> Verdict:
    """Compare a metric [deg] of every axis of the proposed run with an upper bound."""
    values = _metric(pair.proposed, path)
    return bool(values.max() < bound), f"{label} {each_axis(values, 'deg')}"


def _is_smaller(label: str, path: str, unit: str, pair: RunPair, _: Among) -> Verdict:
    """Compare a metric of the proposed run with that of the conventional one, axis by axis."""
    ours, theirs = (_metric(run, path) for run in pair[:2])
    return bool(np.all(ours <= theirs)), f"{label} {each_axis(ours, unit)} against {each_axis(theirs, unit)}"


def _follows_its_sensor(pair: RunPair, _: Among) -> Verdict:
    run = pair.conventional
    sizes = np.stack([_metric(run, f"fault_windows.{index}.tracking_rmse_deg") for index in range(2)])
    shares = sizes / [_rms(run, np.degrees(run.flight.fault), *times) for times in FAULT_TIMES]
    return bool(sizes.min() > TRACKING_DEG), (
        f"tracking RMSE {short(sizes.min())} deg or more on every axis in both windows,"
        f" {short(shares.min())} to {short(shares.max())} times the RMS of the fault"
    )


def _roll_reads_wrong(pair: RunPair, _: Among) -> Verdict:
    run, flight = pair.conventional, pair.conventional.flight
    rows = (flight.time >= FAULT_TIMES[0][0]) & (flight.time < FAULT_TIMES[0][1])
    reference, fault = flight.reference[rows, 0], np.degrees(flight.fault[rows, 0])
    if np.any(reference != 0.0) or not np.allclose(fault, 1.0):
        raise NoVerdictError("roll is not to stay at zero under a fault of +1 deg, as it is in Figure 6")
    value = _metric(run, "fault_windows.0.tracking_mean_deg")[0]
    low, high = ROLL_RESPONSE_DEG
    return bool(low < value < high), f"mean roll {short(value)} deg"


def _leans_without_fault(pair: RunPair, _: Among) -> Verdict:
    flight = pair.conventional.flight
    error = np.degrees(np.asarray(wrap(flight.angles - flight.reference)))
    disturbed = (flight.time >= DISTURBED[0]) & (flight.time < DISTURBED[1])
    both = flight.time < DISTURBANCE_ONSET, disturbed
    before, after = (np.sqrt(np.nanmean(error[rows] ** 2, axis=0)) for rows in both)
    reason = f"tracking RMSE {each_axis(after, 'deg')} from 7 to 20 s; before 5 s {each_axis(before, 'deg')}"
    return bool(np.all(after > np.maximum(TRACKING_DEG, before))), reason


def _disturbance_estimated(pair: RunPair, _: Among) -> Verdict:
    run = pair.proposed
    shares = 100.0 * _metric(run, "disturbance_estimate_rmse") / _rms(run, run.flight.disturbance, 0.0)
    reason = f"error of the disturbance estimate {each_axis(shares, '%')} of the disturbance, both RMS"
    return bool(shares.max() < 100.0 * REMAINDER), reason


def _more_affected(pair: RunPair, among: Among) -> Verdict:
    first = [each for each in among if each.runs[0].scenario.name == CONSTANT]
    if not first:
        raise NoVerdictError(f"the runs of scenario 1 ({CONSTANT}) are not among these")
    runs = _run_pair(first[-1]).conventional, pair.conventional
    one, two = (_metric(run, "tracking_rmse_deg") for run in runs)
    sizes = [_rms(run, run.flight.disturbance, DISTURBANCE_ONSET) for run in runs]
    return bool(np.all(two > one)), (
        f"tracking RMSE {each_axis(two, 'deg')}, in scenario 1 {each_axis(one, 'deg')}; RMS of the"
        f" disturbance {each_axis(100.0 * sizes[1] / sizes[0], '%')} of that in scenario 1"
    )


_SETTLED = ("error of the settled estimate", "fault_estimate_max_settled_deg")
_TRACKING = ("tracking RMSE", "tracking_rmse_deg")
_VARIATION = ("total variation of the torque", "torque_total_variation")
_proposed_tracks = functools.partial(_is_bounded, *_TRACKING, TRACKING_DEG)
JUDGES: dict[str, Callable[[RunPair, Among], Verdict]] = {
    "faults_estimated": functools.partial(_is_bounded, *_SETTLED, SETTLED_ERROR_DEG),
    "conventional_follows_its_sensor": _follows_its_sensor,
    "roll_is_minus_one_degree": _roll_reads_wrong,
    "proposed_follows": _proposed_tracks,
    "conventional_leans_without_fault": _leans_without_fault,
    "disturbance_compensated": _disturbance_estimated,
    "tracking_maintained": _proposed_tracks,
    "conventional_more_affected": _more_affected,
    "tracking_still_maintained": _proposed_tracks,
    "proposed_superior": functools.partial(_is_smaller, *_TRACKING, "deg"),
    "no_chattering": functools.partial(_is_smaller, *_VARIATION, "N m/s"),
}
_SHARES = {"tracking": TRACKING_DEG, "remainder": 100.0 * REMAINDER}
_TEXTS = (DATA / "claims.yaml").read_text("utf-8")
_FILLED = _TEXTS.format(settling=SETTLING_TIME, settled=SETTLED_ERROR_DEG, **_SHARES)
CLAIMS = tuple(Claim(key, **texts) for key, texts in yaml.safe_load(_FILLED).items())
