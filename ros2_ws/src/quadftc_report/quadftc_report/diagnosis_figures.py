"""Figures of a diagnosis, of flights and of replays: the fault and its estimates, the states over time."""

from __future__ import annotations

import dataclasses
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.diagnosis_metrics.columns import Columns
from quadftc_flight.flight import NO_STATE
from quadftc_model.samples import AXES, FAULT_STATE_NAMES, FAULTY, RECOVERING, SUSPECT
from quadftc_replay.replay_directory import Recorded
from quadftc_report import captions
from quadftc_report.comparison import has_observer
from quadftc_report.description import Figure
from quadftc_report.scene import UPPER, Scene, column_of, difference, known, spread, worth

Floats = NDArray[np.float64]
Item = TypeVar("Item", bound=Recorded)


def fault_figure(scene: Scene[Item], axis: int) -> Figure | None:
    """Describe the fault of an axis, its estimates, and their errors."""
    name = AXES[axis]
    runs = [run for run in scene.runs if has_observer(run) and known(run.flight.fault_estimate)]
    truth = scene.truth(runs or scene.runs, "fault", axis, "true fault")
    estimates = scene.estimates(runs, "fault_estimate", axis, "estimate")
    if not worth(*(trace.y for trace in (*truth, *estimates))):
        return None
    errors = [difference(run, "fault_estimate", "fault", axis) for run in runs]
    lines = [dataclasses.replace(line, y=error) for line, error in zip(estimates, errors, strict=True)]
    deviations = [column_of(run, "fault_std_dev", axis) for run in runs]
    spreads = [pair for pair in zip(estimates, deviations, strict=True) if np.any(pair[1] >= 0.0)]
    around = tuple(spread(line, line.y, deviation) for line, deviation in spreads)
    around_zero = tuple(spread(line, 0.0, deviation) for line, deviation in spreads)
    upper = {"title": "fault", "envelopes": around, "height": UPPER}
    lower = {"title": "error", "envelopes": around_zero}
    panels = [scene.panel(axis, [*truth, *estimates], f"{name} fault", "deg", **upper)]
    if known(*errors):
        panels.append(scene.panel(axis, lines, "error", "deg", **lower))
    found = [(scene.label(run), error) for run, error in zip(runs, errors, strict=True)]
    caption = captions.fault(name, panels[0].shades, panels[0].marks, found)
    return scene.figure("fault", f"{name.capitalize()} fault and its estimate", caption, panels, axis)


def state_figure(scene: Scene[Item]) -> Figure | None:
    """Describe the state of each axis over time, where an observer ever doubts its sensor."""
    runs = [run for run in scene.runs if has_observer(run)]
    if not any(np.isin(run.flight.fault_state, (SUSPECT, FAULTY, RECOVERING)).any() for run in runs):
        return None
    panels = [
        scene.panel(
            axis,
            [scene.trace(run, _state(run, axis)) for run in runs],
            name,
            "",
            ticks=tuple((float(state), word) for state, word in enumerate(FAULT_STATE_NAMES)),
        )
        for axis, name in enumerate(AXES)
    ]
    declared = [(scene.label(run), _declared(run)) for run in runs]
    return scene.figure("state", "State of the diagnosis", captions.states(declared), panels)


def _state(run: Recorded, axis: int) -> Floats:
    """The state of an axis as a number; NaN: there is none."""
    state = run.flight.fault_state[:, axis]
    return np.where(state == NO_STATE, np.nan, state.astype(np.float64))


def _declared(run: Recorded) -> Floats:
    """How long each axis is declared faulty [s] (3,)."""
    columns = Columns(run.flight)
    return columns.period * np.sum(columns.declared, axis=0)
