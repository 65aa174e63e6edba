"""Which runs the paper's claims are judged on, and the verdicts.

Source: B. Wang, P. Huang, W. Zhang, A Robust Fault-Tolerant Control for Quadrotor Helicopters against Sensor
Faults and External Disturbances, Complexity, 2021, section 4; the claims are in `quadftc_report.claims`.

A claim is judged on runs in the paper's conditions: the scenario of its figures, the vehicle, ideal sensors,
faults on all three axes from 20 to 40 s and from 50 to 70 s, the paper's observers and controller, and the
conventional control that it compares with. Other runs get no verdict.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadftc_flight.run_directory import RecordedRun
from quadftc_model.samples import AXES
from quadftc_report.claims import CLAIMS, DISTURBANCE_ONSET, FAULT_TIMES, FAULTS, VARYING, Claim, Evidence
from quadftc_report.comparison import Comparison, is_ideal

VEHICLE = "qball_x4"  # section 2
PROPOSED = ("sliding_mode", "exosystem", "ismc")  # observer, disturbance observer, controller of the paper
CONVENTIONAL = ("none", "none", "smc")  # and of what it compares with
STEADY = 1e-3  # relative; a torque that varies by less is constant


class Verdict(str, enum.Enum):
    """What the numbers say of a claim."""

    AGREES = "agrees"
    DISAGREES = "disagrees"
    CANNOT_SAY = "cannot say"


class Judgement(NamedTuple):
    """A claim, its verdict, and the reason with the numbers that it rests on."""

    claim: Claim
    verdict: Verdict
    reason: str


def judge(
    comparison: Comparison[RecordedRun], among: Sequence[Comparison[RecordedRun]] = ()
) -> list[Judgement]:
    """Judge the paper's claims on one scenario by its runs; there are none on other scenarios.

    Parameters
    ----------
    comparison : Comparison
    among : sequence of Comparison
        All comparisons of the report: some claims compare scenarios.
    """
    claims = [claim for claim in CLAIMS if comparison.runs[0].scenario.name in claim.scenarios]
    if not claims:
        return []
    evidence = _evidence(comparison)
    if isinstance(evidence, str):
        return [Judgement(claim, Verdict.CANNOT_SAY, evidence) for claim in claims]
    others = [_evidence(other) for other in among if other is not comparison]
    named = {each.proposed.scenario.name: each for each in others if isinstance(each, Evidence)}
    complete = dataclasses.replace(evidence, others=named)
    verdicts = {True: Verdict.AGREES, False: Verdict.DISAGREES, None: Verdict.CANNOT_SAY}
    findings = [(claim, claim.judge(complete)) for claim in claims]
    return [Judgement(claim, verdicts[found.holds], found.reason) for claim, found in findings]


def _evidence(comparison: Comparison[RecordedRun]) -> Evidence | str:
    """The runs to judge on, or why there can be no verdict."""
    reason = _wrong_conditions(comparison)
    if reason:
        return reason
    proposed, conventional = (_find_run(comparison, kinds) for kinds in (PROPOSED, CONVENTIONAL))
    if proposed is None:
        return "no run with the paper's observers and controller is among these"
    if conventional is None:
        return "no run with the conventional control (sliding mode, no observers) is among these"
    for run in (proposed, conventional):
        if not run.is_whole:
            return f"{run.name} was recorded for {run.duration:.1f} s of {run.scenario.duration:g} s only"
        wrong = _wrong_disturbance(run)
        if wrong:
            return wrong
    return Evidence(proposed, conventional)


def _wrong_conditions(comparison: Comparison[RecordedRun]) -> str:
    """How the scenario differs from the paper's; empty: it does not."""
    scenario = comparison.runs[0].scenario
    if not is_ideal(comparison):
        return "the sensors are not ideal, as they are in the paper"
    if scenario.vehicle != VEHICLE or scenario.plant.motor_lag or set(scenario.plant.inertia_factor) != {1.0}:
        return "the vehicle is not the paper's, a Qball-X4 whose motors follow at once"
    windows = {(window.start, window.stop): window.axes for window in scenario.fault_windows}
    if windows != dict.fromkeys(FAULT_TIMES, AXES):
        return "the faults are not where the paper has them: all axes, from 20 to 40 s and from 50 to 70 s"
    return ""


def _find_run(comparison: Comparison[RecordedRun], kinds: tuple[str, str, str]) -> RecordedRun | None:
    return next(
        (
            run
            for run in comparison.runs
            if (run.observer, run.disturbance_observer, run.scheme.controller.kind) == kinds
        ),
        None,
    )


def _wrong_disturbance(run: RecordedRun) -> str:
    """How the recorded disturbance differs from that of the scenario's name; empty: it does not."""
    name, flight = run.scenario.name, run.flight
    known = np.isfinite(flight.disturbance).all(axis=1)
    early = np.abs(flight.disturbance[known & (flight.time < DISTURBANCE_ONSET)])
    late = flight.disturbance[known & (flight.time >= DISTURBANCE_ONSET)]
    if not len(early) or not len(late):
        return f"the disturbance of {run.name} was not recorded"
    if early.max() > 0.0:
        return f"in {run.name} a disturbance acts before 5 s"
    largest = np.abs(late).max(axis=0)
    if name == FAULTS:
        return f"in {run.name} a disturbance acts, in Figures 6 to 8 none" if largest.any() else ""
    if not largest.all():
        return f"in {run.name} no disturbance acts on one of the axes"
    varies = np.ptp(late, axis=0) > STEADY * largest
    if varies.any() != varies.all() or varies.any() != (name == VARYING):
        return f"in {run.name} the disturbance is not {'constant' if varies.any() else 'varying'}"
    return ""
