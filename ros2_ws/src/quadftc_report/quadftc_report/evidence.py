"""What a claim of the paper is judged on: the two runs it is about, if they are as the paper has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from quadftc_flight.run_directory import RecordedRun
from quadftc_model.samples import AXES
from quadftc_report.comparison import Comparison

SCENARIOS = ("paper_faults", "paper_constant_disturbance", "paper_varying_disturbance")
FAULTS, CONSTANT, VARYING = SCENARIOS

VEHICLE = "qball_x4"  # section 2
PROPOSED = ("sliding_mode", "exosystem", "ismc")  # observer, disturbance observer, controller of the paper
CONVENTIONAL = ("none", "none", "smc")  # and of what it compares with
FAULT_TIMES = ((20.0, 40.0), (50.0, 70.0))  # s; section 4, all three axes
DISTURBANCE_ONSET = 5.0  # s; section 4, scenarios 1 and 2
STEADY = 1e-3  # relative; a torque that varies by less is constant


@dataclasses.dataclass(frozen=True)
class Number:
    """A number that a verdict rests on.

    Parameters
    ----------
    label : str
        What it is, and about which axis.
    value : float, optional
    unit : str
    run : str
        Name of the run it is of.
    path : str
        Dotted path in that run's ``summary["metrics"]``; empty: computed from the flight.
    """

    label: str
    value: float | None
    unit: str
    run: str
    path: str = ""


@dataclasses.dataclass(frozen=True)
class Finding:
    """What looking at the numbers gave; ``holds`` None: they do not tell."""

    holds: bool | None
    reason: str
    numbers: tuple[Number, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """The runs a claim is judged on."""

    comparison: Comparison
    proposed: RecordedRun
    conventional: RecordedRun
    others: Mapping[str, Evidence]  # scenario name -> the evidence of the paper's other scenarios


@dataclasses.dataclass(frozen=True, eq=False)
class Claim:
    """One statement of the paper.

    Parameters
    ----------
    key : str
    scenarios : tuple of str
        Names of the scenarios on which it is judged.
    place : str
        Where the paper says so.
    text : str
        What it says, in our words.
    criterion : str
        How it is judged, and whose the bounds are.
    judge : callable
        From the evidence to what it shows.
    """

    key: str
    scenarios: tuple[str, ...]
    place: str
    text: str
    criterion: str
    judge: Callable[[Evidence], Finding]


def evidence_of(comparison: Comparison) -> Evidence | str:
    """The runs to judge on, or why there can be no verdict."""
    scenario = comparison.scenario
    reason = _wrong_conditions(comparison)
    if reason:
        return reason
    proposed, conventional = _run_of(comparison, PROPOSED), _run_of(comparison, CONVENTIONAL)
    if proposed is None:
        return "no run with the paper's observers and controller is among these"
    if conventional is None:
        return "no run with the conventional control (sliding mode, no observers) is among these"
    for run in (proposed, conventional):
        if not run.is_whole:
            return f"{run.name} was recorded for {run.duration:.1f} s of {scenario.duration:g} s only"
        wrong = _wrong_disturbance(run)
        if wrong:
            return wrong
    return Evidence(comparison, proposed, conventional, {})


def _wrong_conditions(comparison: Comparison) -> str:
    """Say in what the scenario is not the paper's; empty: in nothing."""
    scenario = comparison.scenario
    if not comparison.ideal:
        return "the sensors are not ideal, as they are in the paper"
    if scenario.vehicle != VEHICLE or scenario.plant.motor_lag or set(scenario.plant.inertia_factor) != {1.0}:
        return "the vehicle is not the paper's, a Qball-X4 whose motors follow at once"
    windows = {(window.start, window.stop): window.axes for window in scenario.fault_windows}
    if windows != dict.fromkeys(FAULT_TIMES, AXES):
        return "the faults are not where the paper has them: all axes, from 20 to 40 s and from 50 to 70 s"
    return ""


def _run_of(comparison: Comparison, kinds: tuple[str, str, str]) -> RecordedRun | None:
    return next((run for run in comparison.runs if _kinds(run) == kinds), None)


def _kinds(run: RecordedRun) -> tuple[str, str, str]:
    scheme = run.scheme
    return scheme.observer.kind, scheme.disturbance_observer.kind, scheme.controller.kind


def _wrong_disturbance(run: RecordedRun) -> str:
    """Say what is wrong with the recorded disturbance, by the scenario's name; empty: nothing."""
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
